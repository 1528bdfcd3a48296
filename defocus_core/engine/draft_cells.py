"""Drafts: a picture at half size, in cells of two by two px.

Colours of a cell are means, as those of a pixel are. Where a depth edge runs through it, the
surface that holds more of it gives its radius; the nearer one, if two hold half each. But the light
of a pixel much brighter than the others belongs where that pixel is.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from defocus_core.images.derived import Derived, held
from defocus_core.images.neighbourhoods import halfway
from defocus_core.images.pyramid import halved
from defocus_core.images.source import Pixels
from defocus_core.images.sparse_masks import exceeding, places_of
from defocus_core.inpainting.known_layer import Behind

# Px of radius by which the pixels of a cell may differ and still show one surface.
_STEEP = 1.013
# How many times as bright as the others together a pixel of a cell is that gives its radius.
_BRIGHTER = 4.0
_EVEN = (False, False)


class HalfSize(Derived):
    """Cells [..., ceil(H / 2), ceil(W / 2)]."""

    def __init__(self, merge: Callable[..., Tensor], *pictures: Pixels) -> None:
        """Nothing is looked at yet.

        Args:
            merge: Makes cells [..., h, w] of the px [..., 2 h, 2 w] of each picture.
            pictures: [..., H, W], computed with in float32 at least.
        """
        self._merge, self._pictures = merge, pictures
        H, W = pictures[0].shape[-2:]
        first = self.made((0, 1), (0, 1))
        self.shape = (*first.shape[:-2], (H + 1) // 2, (W + 1) // 2)
        self.dtype, self.device = first.dtype, first.device

    def made(self, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        """Cells from the first to before the end."""
        down, across = (slice(2 * first, 2 * max(end, first)) for first, end in (rows, columns))
        return self._merge(*(_evened(x[..., down, across]) for x in self._pictures))


def half_size(merge: Callable[..., Tensor], *pictures: Pixels, threads: int, hold: bool) -> Pixels:
    """Cells of pictures, `held` or made whenever they are asked for.

    Args:
        merge: As for `HalfSize`.
        pictures: The same.
        threads: Bands that are made at once.
        hold: Whether there is room for them.
    """
    return held(HalfSize(merge, *pictures), *pictures, threads=threads, hold=hold)


def behind_at_half_size(behind: Behind, threads: int, *, hold: bool) -> Behind:
    """What is known behind a frame, in cells, with a channel more that is 0."""
    color, radius, mask = behind
    made = partial(half_size, threads=threads, hold=hold)
    return Behind(
        made(_known_means, color, mask),
        made(_known_radii_in_cells, radius, mask),
        made(_any_known, mask),
    )


def radii_in_cells(signed_radius: Tensor, pixels: Tensor) -> Tensor:
    """Radii in cells of what cells [h, w] show, of px [2 h, 2 w] and [C, 2 h, 2 w]."""
    return surface_radii(signed_radius, pixels) / 2


def means(values: Tensor) -> Tensor:
    """Of px [..., 2 h, 2 w] in cells [..., h, w]."""
    return halved(values, _EVEN) / 4


def surface_radii(signed_radius: Tensor, pixels: Tensor) -> Tensor:
    """Radii in px of the surfaces of cells [h, w], of px [2 h, 2 w] and [C, 2 h, 2 w]."""
    least, most = (_picked(signed_radius.detach(), pick) for pick in (torch.minimum, torch.maximum))
    y, x = places_of(exceeding(most.sub_(least), _STEEP)).unbind(1)
    some = torch.stack([corner[y, x] for corner in _corners(signed_radius)])
    light = torch.stack([corner[:, y, x].amax(0) for corner in _corners(pixels.detach())])
    brightest = light.amax(0)
    lone = brightest > _BRIGHTER * (light.sum(0) - brightest)
    counts = torch.where(lone, (light == brightest).to(some), 1.0)
    return means(signed_radius).index_put((y, x), _of_most(some, counts))


def _known_means(color: Tensor, known: Tensor) -> Tensor:
    """Means of the px that are known, 0 where none is, and a channel more that is 0."""
    count = halved(known.to(color.dtype), _EVEN)
    cells = halved(torch.where(known.bool(), color, 0.0), _EVEN) / count.clamp(min=1)
    return torch.cat([cells, torch.zeros_like(cells[:1])])


def _known_radii_in_cells(signed_radius: Tensor, known: Tensor) -> Tensor:
    """The same of the px that are known, 0 where none is."""
    radii, share = (torch.stack(_corners(x)) for x in (signed_radius, known.to(signed_radius)))
    return _of_most(torch.where(share > 0, radii, 0.0), share) / 2


def _any_known(known: Tensor) -> Tensor:
    return halved(known.float(), _EVEN) > 0


def _of_most(radii: Tensor, share: Tensor) -> Tensor:
    """Of radii [4, ...] px the mean [...] of those on one surface: that of most of them.

    Args:
        radii: Px.
        share: [4, ...], 1 for those that count, 0 for the others.
    """
    least = torch.where(share > 0, radii, torch.inf).amin(0).detach()
    most = torch.where(share > 0, radii, -torch.inf).amax(0).detach()
    near = share * (radii <= halfway(least, most))
    larger = torch.where(2 * near.sum(0) >= share.sum(0), near, share - near)
    chosen = torch.where(most - least > _STEEP, larger, share)
    return (radii * chosen).sum(0) / chosen.sum(0).clamp(min=1)


def _picked(px: Tensor, pick: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    """What is picked of the four px [2 h, 2 w] of each cell: rows first, for they lie together."""
    rows = pick(px[::2], px[1::2])
    return pick(rows[:, ::2], rows[:, 1::2])


def _corners(px: Tensor) -> list[Tensor]:
    """The four px [..., h, w] of each cell."""
    return [px[..., y::2, x::2] for y in (0, 1) for x in (0, 1)]


def _evened(px: Tensor) -> Tensor:
    """Px [..., H, W] to compute with, the last ones repeated where their number is odd."""
    if px.dtype != torch.bool:
        px = px.to(torch.promote_types(px.dtype, torch.float32))
    if px.shape[-2] % 2:
        px = torch.cat([px, px[..., -1:, :]], -2)
    if px.shape[-1] % 2:
        px = torch.cat([px, px[..., -1:]], -1)
    return px

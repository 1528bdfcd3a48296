"""Drafts: a picture at half size, in coarse pixels of two by two px.

The colour of a coarse pixel is the mean of its pixels. Where a depth edge runs through a coarse
pixel, its radius is that of the surface that has more of its pixels, and of the nearer one if both
have two. But if a pixel is much brighter than the others, the coarse pixel has the radius of this
pixel, for most of its light comes from there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from defocus_core.renderer.inpainting.known_layer import KnownLayer
from defocus_core.tensors.derived import Derived, held
from defocus_core.tensors.neighbourhoods import halfway
from defocus_core.tensors.pyramid import halved
from defocus_core.tensors.source import Pixels
from defocus_core.tensors.sparse_masks import exceeding, positions_of

# Greatest difference of radii in px within one surface in a coarse pixel.
_STEEP = 1.013
# A pixel this many times as bright as the other three together gives the coarse pixel its radius.
_BRIGHTER = 4.0
_EVEN = (False, False)


class HalfSize(Derived):
    """Coarse pixels [..., ceil(H / 2), ceil(W / 2)] of pictures, merged when they are cut."""

    def __init__(self, merge: Callable[..., Tensor], *pictures: Pixels) -> None:
        """Keep the pictures.

        `merge`: makes coarse pixels [..., h, w] of the px [..., 2 h, 2 w] of each picture;
        `pictures`: [..., H, W]; `merge` gets them in float32 at least.
        """
        self._merge, self._pictures = merge, pictures
        H, W = pictures[0].shape[-2:]
        first = self.computed((0, 1), (0, 1))
        self.shape = (*first.shape[:-2], (H + 1) // 2, (W + 1) // 2)
        self.dtype, self.device = first.dtype, first.device

    def computed(self, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        """The window [rows, columns] of coarse pixels, each from the first to before the end."""
        down, across = (slice(2 * first, 2 * max(end, first)) for first, end in (rows, columns))
        return self._merge(*(_evened(x[..., down, across]) for x in self._pictures))


def half_size(merge: Callable[..., Tensor], *pictures: Pixels, threads: int, hold: bool) -> Pixels:
    """Coarse pixels of pictures, `held` or merged whenever they are cut."""
    return held(HalfSize(merge, *pictures), *pictures, threads=threads, hold=hold)


def hidden_at_half_size(hidden: KnownLayer, threads: int, *, hold: bool) -> KnownLayer:
    """A known layer in coarse pixels, with one more channel of 0."""
    color, radius, mask = hidden
    coarse = partial(half_size, threads=threads, hold=hold)
    return (
        coarse(_known_means, color, mask),
        coarse(_known_coarse_radii, radius, mask),
        coarse(_any_known, mask),
    )


def coarse_radii(signed_radius: Tensor, pixels: Tensor) -> Tensor:
    """`surface_radii` in coarse pixels."""
    return surface_radii(signed_radius, pixels) / 2


def means(values: Tensor) -> Tensor:
    """The mean [..., h, w] of each coarse pixel, of px [..., 2 h, 2 w]."""
    return halved(values, _EVEN) / 4


def surface_radii(signed_radius: Tensor, pixels: Tensor) -> Tensor:
    """Radii [h, w] in px of the surfaces that coarse pixels show.

    `signed_radius`: [2 h, 2 w] px; `pixels`: [C, 2 h, 2 w].
    """
    radii = torch.stack(_corners(signed_radius))
    steps = radii.detach().amax(0).sub_(radii.detach().amin(0))
    y, x = positions_of(exceeding(steps, _STEEP)).unbind(1)
    radii = radii[:, y, x]
    light = torch.stack([corner[:, y, x].amax(0) for corner in _corners(pixels.detach())])
    brightest = light.amax(0)
    lone = brightest > _BRIGHTER * (light.sum(0) - brightest)
    counts = torch.where(lone, (light == brightest).to(radii), 1.0)
    return means(signed_radius).index_put((y, x), _majority_radius(radii, counts))


def _known_means(color: Tensor, known: Tensor) -> Tensor:
    """Means of the known px of each coarse px, 0 where none is known; and one more channel of 0."""
    count = halved(known.to(color.dtype), _EVEN)
    coarse = halved(torch.where(known.bool(), color, 0.0), _EVEN) / count.clamp(min=1)
    return torch.cat([coarse, torch.zeros_like(coarse[:1])])


def _known_coarse_radii(signed_radius: Tensor, known: Tensor) -> Tensor:
    """Radii in coarse pixels of the known surfaces of coarse pixels; 0 where no pixel is known."""
    radii, fraction = (torch.stack(_corners(x)) for x in (signed_radius, known.to(signed_radius)))
    return _majority_radius(torch.where(fraction > 0, radii, 0.0), fraction) / 2


def _any_known(known: Tensor) -> Tensor:
    """Whether a pixel of each coarse pixel is known."""
    return halved(known.float(), _EVEN) > 0


def _majority_radius(radii: Tensor, fraction: Tensor) -> Tensor:
    """The mean radius [...] in px of the surface that has most of the pixels of a coarse pixel.

    `radii`: [4, ...] px of the pixels; `fraction`: [4, ...], 1 for the pixels that count, 0 for the
    others.
    """
    minimum = torch.where(fraction > 0, radii, torch.inf).amin(0).detach()
    maximum = torch.where(fraction > 0, radii, -torch.inf).amax(0).detach()
    near = fraction * (radii <= halfway(minimum, maximum))
    larger = torch.where(2 * near.sum(0) >= fraction.sum(0), near, fraction - near)
    chosen = torch.where(maximum - minimum > _STEEP, larger, fraction)
    return (radii * chosen).sum(0) / chosen.sum(0).clamp(min=1)


def _corners(px: Tensor) -> list[Tensor]:
    """The upper left, upper right, lower left and lower right px [..., h, w] of each coarse px."""
    return [px[..., y::2, x::2] for y in (0, 1) for x in (0, 1)]


def _evened(px: Tensor) -> Tensor:
    """Px [..., H, W] in float32 at least, the last row or column repeated if its number is odd."""
    if px.dtype != torch.bool:
        px = px.to(torch.promote_types(px.dtype, torch.float32))
    if px.shape[-2] % 2:
        px = torch.cat([px, px[..., -1:, :]], -2)
    if px.shape[-1] % 2:
        px = torch.cat([px, px[..., -1:]], -1)
    return px

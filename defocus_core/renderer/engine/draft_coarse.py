"""Drafts: a picture at half size, in coarse pixels of two by two px.

Coarse pixels are symmetric about the middle of the frame, as in `tensors.pyramid`: of an odd number
of rows or columns every second is one, with half of those beside it.

The colour of a coarse pixel is the mean of its pixels. Where a depth edge runs through a coarse
pixel, its radius is that of the surface that has more of its pixels, and of the nearer one if both
have the same. But if a pixel is much brighter than the others, the coarse pixel has the radius of
this pixel, for most of its light comes from there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from defocus_core.renderer.inpainting.known_layer import KnownLayer
from defocus_core.tensors.box import Span
from defocus_core.tensors.derived import Derived, held
from defocus_core.tensors.neighbourhoods import halfway
from defocus_core.tensors.source import Pixels
from defocus_core.tensors.sparse_masks import exceeding, positions_of

# Greatest difference of radii in px within one surface in a coarse pixel.
_STEEP = 1.013
# A pixel this many times as bright as the other three together gives the coarse pixel its radius.
_BRIGHTER = 4.0


class HalfSize(Derived):
    """Coarse pixels [..., ceil(H / 2), ceil(W / 2)] of pictures, merged when they are cut."""

    def __init__(self, merge: Callable[..., Tensor], *pictures: Pixels) -> None:
        """Keep the pictures.

        `merge`: makes coarse pixels [..., h, w] of the px of each picture, [..., 2 h, 2 w], or of
        one row or column more if it has an odd number of them; `pictures`: [..., H, W]; `merge`
        gets them in float32 at least.
        """
        self._merge, self._pictures = merge, pictures
        H, W = pictures[0].shape[-2:]
        first = self.computed((0, 1), (0, 1))
        self.shape = (*first.shape[:-2], (H + 1) // 2, (W + 1) // 2)
        self.dtype, self.device = first.dtype, first.device

    def computed(self, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        """The window [rows, columns] of coarse pixels, each from the first to before the end."""
        return self._merge(*(_px_of(x, rows, columns) for x in self._pictures))


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
    """The mean [..., h, w] of each coarse pixel, of px as for `HalfSize`."""
    for dim in (-2, -1):
        first, *others = _along(values, dim)
        if len(others) == 1:
            values = (first + others[0]) / 2
        else:
            values = (first + others[1]) / 4 + others[0] / 2
    return values


def surface_radii(signed_radius: Tensor, pixels: Tensor) -> Tensor:
    """Radii [h, w] in px of the surfaces that coarse pixels show.

    `signed_radius`: [2 h, 2 w] px; `pixels`: [C, 2 h, 2 w]; or as for `HalfSize`.
    """
    radii, counts = _parts(signed_radius)
    steps = radii.detach().amax(0).sub_(radii.detach().amin(0))
    y, x = positions_of(exceeding(steps, _STEEP)).unbind(1)
    radii = radii[:, y, x]
    counts = counts[:, :, 0].expand(-1, len(y))
    light = counts * _parts(pixels.detach().amax(0))[0][:, y, x]
    brightest = light.amax(0)
    lone = brightest > _BRIGHTER * (_total(light) - brightest)
    counts = torch.where(lone, (light == brightest).to(counts), counts)
    return means(signed_radius).index_put((y, x), _majority_radius(radii, counts))


def _known_means(color: Tensor, known: Tensor) -> Tensor:
    """Means of the known px of each coarse px, 0 where none is known; and one more channel of 0."""
    fraction = means(known.to(color.dtype))
    coarse = means(torch.where(known.bool(), color, 0.0)) / torch.where(fraction > 0, fraction, 1.0)
    return torch.cat([coarse, torch.zeros_like(coarse[:1])])


def _known_coarse_radii(signed_radius: Tensor, known: Tensor) -> Tensor:
    """Radii in coarse pixels of the known surfaces of coarse pixels; 0 where no pixel is known."""
    (radii, counts), (shown, _) = map(_parts, (signed_radius, known.to(signed_radius)))
    return _majority_radius(torch.where(shown > 0, radii, 0.0), counts * shown) / 2


def _any_known(known: Tensor) -> Tensor:
    """Whether a pixel of each coarse pixel is known."""
    return means(known.float()) > 0


def _majority_radius(radii: Tensor, fraction: Tensor) -> Tensor:
    """The mean radius [...] in px of the surface that has most of the pixels of a coarse pixel.

    `radii`: [n, ...] px of the pixels; `fraction`: [n, ...], how often each counts.
    """
    minimum = torch.where(fraction > 0, radii, torch.inf).amin(0).detach()
    maximum = torch.where(fraction > 0, radii, -torch.inf).amax(0).detach()
    near = fraction * (radii <= halfway(minimum, maximum))
    larger = torch.where(2 * _total(near) >= _total(fraction), near, fraction - near)
    chosen = torch.where(maximum - minimum > _STEEP, larger, fraction)
    return _total(radii * chosen) / _total(chosen).clamp(min=1)


def _total(values: Tensor) -> Tensor:
    """The sum [...] of values [n, ...], in one order whatever their place in memory."""
    first, *others = values.unbind()
    for value in others:
        first = first + value
    return first


def _parts(px: Tensor) -> tuple[Tensor, Tensor]:
    """The n px of each coarse pixel, [n, ..., h, w], and how often each counts, [n, 1, 1]."""
    rows = _along(px, -2)
    parts = [part for row in rows for part in _along(row, -1)]
    down, across = ([1, 1] if n == 2 else [1, 2, 1] for n in (len(rows), len(parts) // len(rows)))
    counts = px.new_tensor([y * x for y in down for x in across])
    return torch.stack(parts), counts[:, None, None]


def _along(px: Tensor, dim: int) -> list[Tensor]:
    """The two px of each coarse pixel along an axis, or all three of an odd number of px."""
    every = px.movedim(dim, -1)
    n = every.shape[-1] // 2
    parts = [every[..., k : k + 2 * n : 2] for k in range(2 + px.shape[dim] % 2)]
    return [part[..., :n].movedim(-1, dim) for part in parts]


def _px_of(picture: Pixels, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
    """The px of a window of coarse pixels; beyond the frame those on its edge are repeated.

    They are in float32 at least, but for masks.
    """
    spans, missing = [], []
    for (first, end), count in zip((rows, columns), picture.shape[-2:], strict=True):
        wanted = Span(2 * first - count % 2, 2 * max(end, first))
        inside = wanted.within(Span(0, count))
        spans.append(inside)
        missing.append((inside.first - wanted.first, wanted.end - inside.end))
    px = picture[..., slice(*spans[0]), slice(*spans[1])]
    if px.dtype != torch.bool:
        px = px.to(torch.promote_types(px.dtype, torch.float32))
    for dim, (before, after) in zip((-2, -1), missing, strict=True):
        n = px.shape[dim]
        if n and (before or after):
            ends = [px.narrow(dim, 0, 1)] * before, [px.narrow(dim, n - 1, 1)] * after
            px = torch.cat([*ends[0], px, *ends[1]], dim)
    return px

"""Drafts: a picture at half size, in coarse pixels of two by two px.

The middle row or column of an odd number of them counts twice, so that flips change nothing. The
colour of a coarse pixel is the mean of its pixels. Where a depth edge runs through a coarse
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
from defocus_core.tensors.box import Box, Span
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


class Evened(Derived):
    """Px [..., 2 h, 2 w] of a picture, the middle row or column of an odd number twice."""

    def __init__(self, picture: Pixels) -> None:
        """Keep the picture [..., H, W]; its windows are in float32 at least, but for masks."""
        self._picture, self.device = picture, picture.device
        is_mask = picture.dtype == torch.bool
        self.dtype = torch.bool if is_mask else torch.promote_types(picture.dtype, torch.float32)
        *others, height, width = picture.shape
        self.shape = (*others, height + height % 2, width + width % 2)

    def computed(self, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        """The window [rows, columns], each a pair of first and end."""
        spans = [_of_odd(Span(*x), n) for x, n in self._sides(rows, columns)]
        window = self._picture[..., slice(*spans[0]), slice(*spans[1])].to(self.dtype)
        for dim, (asked, count) in zip((-2, -1), self._sides(rows, columns), strict=True):
            middle = _middle(Span(*asked), count)
            if middle is not None:
                first, second = window.tensor_split([middle + 1], dim)
                window = torch.cat([first, first.narrow(dim, middle, 1), second], dim)
        return window

    def _sides(
        self, rows: tuple[int, int], columns: tuple[int, int]
    ) -> list[tuple[tuple[int, int], int]]:
        """A window's rows and columns, each with their number in the picture."""
        return [*zip((rows, columns), self._picture.shape[-2:], strict=True)]


class HalfSize(Derived):
    """Coarse pixels [..., ceil(H / 2), ceil(W / 2)] of pictures, merged when they are cut."""

    def __init__(self, merge: Callable[..., Tensor], *pictures: Pixels) -> None:
        """Keep the pictures.

        `merge`: makes coarse pixels [..., h, w] of the px [..., 2 h, 2 w] of each picture;
        `pictures`: [..., H, W]; `merge` gets them in float32 at least.
        """
        self._merge, self._pictures = merge, [Evened(each) for each in pictures]
        H, W = pictures[0].shape[-2:]
        first = self.computed((0, 1), (0, 1))
        self.shape = (*first.shape[:-2], (H + 1) // 2, (W + 1) // 2)
        self.dtype, self.device = first.dtype, first.device

    def computed(self, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        """The window [rows, columns] of coarse pixels, each from the first to before the end."""
        down, across = (slice(2 * first, 2 * max(end, first)) for first, end in (rows, columns))
        return self._merge(*(x[..., down, across] for x in self._pictures))


def px_of(coarse: Box, size: tuple[int, int]) -> Box:
    """The px that a rectangle of coarse pixels of a picture of a (height, width) gives.

    A middle row or column that two coarse pixels hold is given by the second.
    """
    spans = zip(coarse.sides, size, strict=True)
    down, across = (Span(*(_in_odd(2 * end, count) for end in side)) for side, count in spans)
    return Box.over(down, across)


def not_evened(px: Tensor, coarse: Box, size: tuple[int, int]) -> Tensor:
    """Px of a picture from evened ones [..., 2 h, 2 w], both middles averaged."""
    for dim, side, count in zip((-2, -1), coarse.sides, size, strict=True):
        middle = _middle(Span(2 * side.first, 2 * side.end), count)
        if middle is not None:
            first, both, second = px.tensor_split([middle, middle + 2], dim)
            px = torch.cat([first, both.mean(dim, keepdim=True), second], dim)
    return px


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


def _in_odd(px: int, count: int) -> int:
    """The number of a pixel among `count`, from the number when they are evened."""
    return px - (count % 2 and px > count // 2)


def _of_odd(evened: Span, count: int) -> Span:
    """The pixels among `count` that a span of evened ones shows."""
    first = _in_odd(evened.first, count)
    return Span(first, max(_in_odd(evened.end - 1, count) + 1, first))


def _middle(evened: Span, count: int) -> int | None:
    """The place in a span of the first of both middle pixels, None if it has not both."""
    middle = count // 2
    has_both = count % 2 and evened.first <= middle and evened.end > middle + 1
    return middle - evened.first if has_both else None

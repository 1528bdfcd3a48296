"""Pictures derived from others, window by window or all at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import EllipsisType

import torch
from torch import Tensor

from defocus_core.tensors.box import Box, Span
from defocus_core.tensors.source import Pixels, Scalar, bands
from defocus_core.tensors.threads import threaded

# A derived picture of at most this many pixels is kept in memory, even if its source is not.
HELD = 1 << 22

# Side in px of a window whose changes are counted; of how many windows one is, in a large picture;
# and how many windows the sample moves on from one column of windows to the next.
_SIDE, _SAMPLED, _SHIFT = 256, 16, 5

# Least height of a band, as a multiple of the margin.
_BAND_OF_MARGIN = 6

Cut = slice | EllipsisType


class Mapped:
    """A `Source` [..., H, W] whose windows a function of their rows and columns makes."""

    def __init__(
        self,
        read: Callable[[tuple[int, int], tuple[int, int]], Tensor],
        shape: Sequence[int],
        like: Pixels,  # its dtype and device are those of the picture
        margin: int = 0,  # distance in px within which pixels of the sources decide a pixel
    ) -> None:
        self._read, self.shape, self.margin = read, tuple(shape), margin
        self.dtype, self.device = like.dtype, like.device

    def __getitem__(self, window: Cut | tuple[Cut, ...]) -> Tensor:
        """The window of slices of rows, or of rows and columns; with steps, read band by band."""
        whole = window if isinstance(window, tuple) else (window,)
        cuts = [cut for cut in whole if isinstance(cut, slice)]
        cuts += [slice(None)] * (2 - len(cuts))
        size = self.shape[-2:]
        (top, below, step), (left, beside, stride) = map(slice.indices, cuts, size)
        if step == stride == 1:
            return self._read((top, below), (left, beside))
        rows = bands(self)[0][1] // step * step or step
        read = (
            self._read((y, min(y + rows, below)), (left, beside)) for y in range(top, below, rows)
        )
        return torch.cat([pixels[..., ::step, ::stride] for pixels in read], -2)

    def at_once(self, threads: int) -> Tensor:
        """The whole picture, computed in bands much higher than what they need around them."""
        rows = bands(self, _BAND_OF_MARGIN * self.margin)
        return torch.cat(
            list(threaded(lambda band: self[..., band[0] : band[1], :], rows, threads)), -2
        )


def held(picture: Mapped, *of: Pixels, threads: int, hold: bool) -> Pixels:
    """The picture as a tensor in memory, or the picture itself, computed at each read.

    A picture is held in memory if there is room, if its sources are in memory, or if it is small.
    """
    in_memory = all(isinstance(each, Tensor) for each in of)
    if hold or in_memory or picture.shape[-2] * picture.shape[-1] <= HELD:
        return picture.at_once(threads)
    return picture


def fraction_changed(before: Pixels, after: Pixels) -> float:
    """The share of the pixels [H, W] that differ.

    Of a large picture in a sample of windows, so that one that is computed at each read costs
    little, and has the same share as one in memory.
    """
    if after is before:
        return 0.0
    (H, W), differ, count = before.shape, 0, 0
    every = 1 if H * W <= HELD else _SAMPLED
    for row in range(0, H, _SIDE):
        for column in range(0, W, _SIDE):
            if (row // _SIDE + column // _SIDE * _SHIFT) % every == 0:
                window = slice(row, row + _SIDE), slice(column, column + _SIDE)
                differ += int((before[window] != after[window]).sum())
                count += before[window].numel()
    return differ / count


class Repaired(Mapped):
    """Radii [H, W] px, each repaired by the pixels around it; others are of the same frame."""

    def __init__(
        self, signed_radius: Pixels, repair: Callable[..., Tensor], around: int, *others: Pixels
    ) -> None:
        def read(rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
            box = Box.over(Span(*rows), Span(*columns))
            window = box.grown(around, Box(0, 0, *self.shape[-2:]))
            pictures = map(window.of, (signed_radius, *others))
            return box.seen_from(window).of(repair(*pictures))

        super().__init__(read, signed_radius.shape, signed_radius, around)


def _mapped(picture: Pixels, function: Callable[[Tensor], Tensor], *shape: int) -> Pixels:
    """A function of a picture: of a tensor at once, else where it is read."""
    if isinstance(picture, Tensor):
        return function(picture)

    def read(rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        return function(picture[..., slice(*rows), slice(*columns)])

    return Mapped(read, shape, picture)


def stacked(*pictures: Pixels) -> Pixels:
    """Pictures of one shape [..., H, W] one after another: [n, ..., H, W], as the first is kept."""
    first = pictures[0]

    def read(rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        parts = (picture[..., slice(*rows), slice(*columns)] for picture in pictures)
        return torch.stack([part.to(first.device, first.dtype) for part in parts])

    if all(isinstance(picture, Tensor) for picture in pictures):
        return read((0, first.shape[-2]), (0, first.shape[-1]))
    return Mapped(read, (len(pictures), *first.shape), first)


def chosen(picture: Pixels, channels: Sequence[int]) -> Pixels:
    """Some channels of a picture [..., C, H, W]; itself of all of them."""
    *before, count, height, width = picture.shape
    if len(channels) == count:
        return picture
    some = list(channels)
    return _mapped(picture, lambda x: x[..., some, :, :], *before, len(some), height, width)


def plus(radii: Pixels, px: Scalar) -> Pixels:
    """Radii and some px; themselves without any."""
    if not isinstance(px, Tensor) and px == 0:
        return radii
    return _mapped(radii, lambda x: x + px, *radii.shape)

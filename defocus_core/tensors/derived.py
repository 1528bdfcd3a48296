"""Pictures derived from others, in bands of rows: what they need beside them stays small."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from defocus_core.tensors.bands import Scalar, bands_of
from defocus_core.tensors.box import Box, Span
from defocus_core.tensors.threads import threaded

# Least height of a band, as a multiple of the margin.
_BAND_OF_MARGIN = 6


def in_bands(
    function: Callable[[Box], Tensor],
    size: tuple[int, int],
    device: torch.device,
    *,
    margin: int = 0,
    threads: int = 1,
) -> Tensor:
    """A picture [..., H, W] of a function of boxes, computed in bands of rows.

    `margin`: px around a box that decide it; bands are much higher.
    """
    rows = bands_of(size, device, _BAND_OF_MARGIN * margin)
    boxes = [Box.over(Span(*band), Span(0, size[1])) for band in rows]
    return torch.cat(list(threaded(function, boxes, threads)), -2)


def repaired(
    signed_radius: Tensor,
    repair: Callable[..., Tensor],
    around: int,
    *others: Tensor,
    threads: int = 1,
) -> Tensor:
    """Radii [H, W] px, each repaired by the pixels around it; others are of the same frame."""
    height, width = signed_radius.shape[-2:]

    def of_box(box: Box) -> Tensor:
        window = box.grown(around, Box(0, 0, height, width))
        pictures = map(window.of, (signed_radius, *others))
        return box.seen_from(window).of(repair(*pictures))

    return in_bands(of_box, (height, width), signed_radius.device, margin=around, threads=threads)


def fraction_changed(before: Tensor, after: Tensor) -> float:
    """The share of the pixels [H, W] that differ."""
    return 0.0 if after is before else int((before != after).sum()) / before.numel()


def chosen(picture: Tensor, channels: Sequence[int]) -> Tensor:
    """Some channels of a picture [..., C, H, W]; itself of all of them."""
    some = list(channels)
    return picture if len(some) == picture.shape[-3] else picture[..., some, :, :]


def plus(radii: Tensor, px: Scalar) -> Tensor:
    """Radii and some px; themselves without any."""
    return radii if not isinstance(px, Tensor) and px == 0 else radii + px

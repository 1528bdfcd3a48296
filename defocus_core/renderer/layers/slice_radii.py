"""Slice radii: the signed CoC radii of slices, the shares of pixels in slices, and layer order.

Slice radii, in px, depend only on the quality. A pixel between two slice radii belongs to both
slices, by weights that sum to one and keep the second moment of its blur: they are linear in r².

Visible layers are composited first, as they are known. But the light of a far more blurred surface
would spread over hidden surfaces in front of it: a sign behind a fence would be tinted by the sky.
So a hidden octave is composited before visible layers that are far more blurred.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

from defocus_core.renderer.engine.settings import Quality
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.ties import tied, with_gradient

# Up to a radius of SHARP px a pixel counts as in focus: its disc is much narrower than the pixel.
# From there to SOFT its blur rises to what its radius says, so that shares have no step.
SHARP, SOFT = 0.15, 0.25
# Radius in px below which each slice is a layer of its own.
ALONE = 2.0
# Px by which radii exceed the first and the last slice at most: less may be rounding.
_ROUNDING = 1e-6
# Range in px of the radii of a plane: more than rounding, less than shows.
_FLAT = 1 / 64
_PX = "radii are in px, negative nearer than focus"


def plane_of(minimum: float, maximum: float) -> float | None:
    """The radius in px of a frame that is visibly a single plane out of focus; else None.

    `minimum`, `maximum`: least and greatest signed radius of the frame in px. One kernel then blurs
    the whole frame, with its highlights. The radius is rounded, so that invisible changes of the
    radii do not change it.
    """
    middle = round((minimum + maximum) / 2 / _FLAT) * _FLAT
    is_plane = maximum - minimum <= _FLAT and abs(middle) > 2 * SOFT
    return middle if is_plane else None


def slice_radii(minimum: float, maximum: float, quality: Quality) -> tuple[float, ...]:
    """The slice radii in px, ascending, for radii from `minimum` to `maximum` px.

    The first and the last slice are an even number of slices away from focus, and there are at
    least three, so that every other slice is a set of slices, too. For a plane there are three: its
    radius, as in `plane_of`, and one on each side.
    """
    if (plane := plane_of(minimum, maximum)) is not None:
        step = max(quality.near_spacing, quality.far_spacing * abs(plane))
        return (plane - step, plane, plane + step)
    minimum, maximum = minimum + _ROUNDING, maximum - _ROUNDING
    reach = max(abs(minimum), abs(maximum))
    side = [0.0]
    while side[-1] < reach or len(side) % 2 == 0 or len(side) < 3:
        side.append(side[-1] + max(quality.near_spacing, quality.far_spacing * side[-1]))
    spaced = [-r for r in reversed(side[1:])] + side
    even = range(0, len(spaced), 2)
    first = max(i for i in even if spaced[i] <= minimum and i < len(spaced) - 1)
    last = min(i for i in even if spaced[i] >= maximum and i > first)
    return tuple(spaced[first : last + 1])


def even_radii(minimum: float, maximum: float, count: int) -> tuple[float, ...]:
    """`count` evenly spaced radii from `minimum` to `maximum`; a single radius is in the middle."""
    if count == 1:
        return ((minimum + maximum) / 2,)
    return tuple(minimum + (maximum - minimum) * k / (count - 1) for k in range(count))


@lru_cache(maxsize=64)
def layer_numbers(radii: tuple[float, ...], quality: Quality) -> list[int]:
    """For each slice the number of its layer, ascending: slices of a layer add, layers occlude.

    Below 2 px each slice is a layer. From there on, a layer holds radii on one side of focus whose
    ratio is at most `quality.layer_ratio`; the ranges are fixed, as the slice radii are. The
    visible parts of two surfaces of such similar radii are nearly complementary after the blur,
    whichever is in front.
    """
    names: list[tuple[int, float]] = []
    for r in radii:
        steps = math.log(max(abs(r), ALONE) / ALONE) / math.log(quality.layer_ratio)
        names.append((0, r) if abs(r) < ALONE else (1 if r > 0 else -1, math.floor(steps)))
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    return [number[name] for name in names]


def slice_position(signed_radius: Tensor, radii: tuple[float, ...]) -> Tensor:
    """Positions of radii [...] px among the slice radii, as fractional slice indices.

    The fraction is the share in the next slice. A radius beyond the first or the last slice has the
    position of that slice. Differentiable in the radius.
    """
    if len(radii) == 1:
        return torch.zeros_like(signed_radius)
    r = signed_radius.flatten()
    if _has_sharp(radii):
        soft = torch.nn.functional.softshrink(r, SHARP) * (SOFT / (SOFT - SHARP))
        r = torch.where(r.detach().abs() < SOFT, soft, r)
    ends, a, b, c = _shares(radii, r.dtype, r.device)
    first = torch.bucketize(r.detach(), ends[:-1], right=True, out_int32=True)
    learn = torch.is_grad_enabled() and r.requires_grad
    if learn:  # on a slice, the interval before it
        before = (first - 1).clamp(min=0)
        first = torch.where(tied(r, ends.index_select(0, before)), before, first)
    square = r * r.abs()
    fraction = torch.addcmul(c.index_select(0, first), a.index_select(0, first), square)
    if any(low < 0 < high for low, high in pairwise(radii)):
        fraction = fraction.addcmul(b.index_select(0, first), r)
    share = fraction.clamp(0, 1)
    if learn:  # positions round more than their fractions
        rounding = tied(first + fraction, first + share)
        share = torch.where(rounding, with_gradient(share, fraction), share)
    return (first + share).reshape(signed_radius.shape)


def _has_sharp(radii: tuple[float, ...]) -> bool:
    """Whether radii up to SHARP px count as in focus: other slices are at least 2 SOFT away."""
    return 0.0 in radii and all(abs(r) >= 2 * SOFT for r in radii if r)


@lru_cache(maxsize=32)
def _shares(
    radii: tuple[float, ...], dtype: torch.dtype, device: torch.device
) -> tuple[Tensor, ...]:
    """The ends of the intervals between slice radii, and three coefficients a, b, c of each.

    A radius r in an interval has the share a r |r| + b r + c in the slice at the interval's end.
    """
    rows = []
    for low, high in pairwise(radii):
        square, width = high * abs(high) - low * abs(low), high - low
        if low < 0 < high:  # no slice is in focus
            rows.append((high, 0.0, 1 / width, -low / width))
        else:
            a = 1 / square if square else 0.0
            rows.append((high, a, 0.0, -a * low * abs(low)))
    like = torch.empty(0, dtype=dtype, device=device)
    with torch.inference_mode(False):  # they are cached for calls that need gradients, too
        return tuple(sent(column, like) for column in zip(*rows, strict=True))


def membership(positions: Tensor, slices: Tensor) -> Tensor:
    """Shares [k, ..., H, W] of pixels at positions [..., H, W] in slices [k].

    The shares of a pixel in all slices sum to 1. A pixel exactly on a slice has the gradient of the
    interval before that slice, as in `slice_before`.
    """
    numbers = slices.view(-1, *[1] * positions.dim())
    if not (torch.is_grad_enabled() and positions.requires_grad):
        return (1 - (positions - numbers).abs_()).clamp_(min=0)
    lower = slice_before(positions.detach())
    fraction = positions - lower
    after = torch.where(numbers == lower + 1, fraction, 0.0)
    return torch.where(numbers == lower, 1 - fraction, after)


def slice_before(positions: Tensor) -> Tensor:
    """The slice before each position [...]; for a position on a slice, the slice before that.

    For positions on the first slice it is the first slice.
    """
    nearest = positions.round()
    return torch.where(tied(positions, nearest), nearest - 1, positions.floor()).clamp(min=0)


# A hidden octave comes before visible layers whose radius is this many times its greatest one.
# Surfaces of like radii cover each other by chance; for them the order stays.
MORE = 1.263


class CompositeOrder(NamedTuple):
    """Where hidden octaves come in the order of visible layers."""

    around: int  # number of the first visible layer that is not blurred nearer than focus
    # Number of the first visible layer beyond focus; greater than all numbers if there is none
    beyond: int
    # Hidden octaves, nearest first, with the number of the first visible layer that comes after
    # each. Octaves that come before no visible layer are absent
    ahead: list[tuple[int, int]]


def octaves(radii: tuple[float, ...]) -> list[int]:
    """For each slice its octave: 0 if |r| < 2 px, 1 up to 4 px, ...; negative nearer than focus."""
    sizes = (math.floor(math.log2(max(abs(r), ALONE / 2) / ALONE)) + 1 for r in radii)
    return [size if r > 0 else -size for size, r in zip(sizes, radii, strict=True)]


def composite_order(radii: tuple[float, ...], layer_indices: list[int]) -> CompositeOrder:
    """Where hidden octaves come in the order of visible layers.

    `radii`: signed radii of the slices in px; `layer_indices`: for each slice the number of its
    layer.
    """
    minimum: dict[int, float] = {}
    for layer_index, r in zip(layer_indices, radii, strict=True):
        if r >= ALONE:
            minimum.setdefault(layer_index, r)
    ahead = []
    for octave in sorted({octave for octave in octaves(radii) if octave}):
        maximum = ALONE * 2.0 ** abs(octave)
        later = [layer_index for layer_index, r in minimum.items() if r >= MORE * maximum]
        if later:
            ahead.append((octave, min(later)))
    numbers = [*layer_indices, len(radii)]
    around, beyond = (sum(r <= -ALONE for r in radii), sum(r < ALONE for r in radii))
    return CompositeOrder(numbers[around], numbers[beyond], ahead)

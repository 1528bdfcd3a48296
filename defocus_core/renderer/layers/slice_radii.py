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
    least three, so that every other slice is a set of slices, too. The radius of a plane is a slice
    radius.
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
    r, linear = signed_radius.flatten(), any(piece.b for piece in _pieces(radii))
    lower, ends, a, b, c = _columns(radii, r.dtype, r.device)
    piece = torch.bucketize(r.detach(), ends[:-1], right=True, out_int32=True)
    if torch.is_grad_enabled() and r.requires_grad:  # on a limit, the piece before it
        before = (piece - 1).clamp(min=0)
        piece = torch.where(tied(r, ends.index_select(0, before)), before, piece)
    fraction = torch.addcmul(c.index_select(0, piece), a.index_select(0, piece), r * r)
    if linear:
        fraction = fraction.addcmul(b.index_select(0, piece), r)
    lower, share = lower.index_select(0, piece), fraction.clamp(0, 1)
    if torch.is_grad_enabled() and r.requires_grad:  # positions round more than their fractions
        rounding = tied(lower + fraction, lower + share)
        share = torch.where(rounding, with_gradient(share, fraction), share)
    positions = lower + share
    return positions.reshape(signed_radius.shape)


class _QuadraticPiece(NamedTuple):
    """The share a r² + b r + c in the slice after `slice_index`, for radii r up to `end` px."""

    slice_index: int
    end: float
    a: float
    b: float
    c: float


@lru_cache(maxsize=32)
def _pieces(radii: tuple[float, ...]) -> list[_QuadraticPiece]:
    """The pieces of the function from radii to shares, in ascending order of radii."""
    pieces = []
    for slice_index, (low, high) in enumerate(pairwise(radii)):
        square, width = high * high - low * low, high - low
        if low * high < 0:  # no slice is in focus
            pieces.append(_QuadraticPiece(slice_index, high, 0.0, 1 / width, -low / width))
            continue
        a = 1 / square if square else 0.0
        whole = _QuadraticPiece(slice_index, high, a, 0.0, -a * low * low)
        sharp = [] if min(abs(low), abs(high)) or max(-low, high) < 2 * SOFT else _sharp(whole)
        pieces += [*sharp, whole] if high > 0 else [whole, *sharp]
        if sharp and high == 0:
            pieces[-3] = whole._replace(end=-SOFT)
    return pieces


@lru_cache(maxsize=32)
def _columns(
    radii: tuple[float, ...], dtype: torch.dtype, device: torch.device
) -> tuple[Tensor, ...]:
    """The fields of `_pieces` as tensors, one tensor for each field."""
    with torch.inference_mode(False):  # they are cached for calls that need gradients, too
        return tuple(
            sent(column, torch.empty(0, dtype=dtype, device=device))
            for column in zip(*_pieces(radii), strict=True)
        )


def _sharp(whole: _QuadraticPiece) -> list[_QuadraticPiece]:
    """The pieces for |r| from 0 to SHARP and from SHARP to SOFT, on the side of `whole`.

    `whole`: the piece next to focus, which holds for the radii beyond.
    """
    k = whole.a * (SOFT / (SOFT - SHARP)) ** 2  # times (|r| - SHARP)²
    if whole.end > 0:
        between = _QuadraticPiece(whole.slice_index, SOFT, k, -2 * k * SHARP, k * SHARP**2)
        return [_QuadraticPiece(whole.slice_index, SHARP, 0.0, 0.0, 0.0), between]
    between = _QuadraticPiece(whole.slice_index, -SHARP, k, 2 * k * SHARP, 1 + k * SHARP**2)
    return [between, _QuadraticPiece(whole.slice_index, 0.0, 0.0, 0.0, 1.0)]


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

    def octaves_before(self, number: int) -> list[int]:
        """The hidden octaves that come directly before visible layer `number`."""
        return [octave for octave, first in self.ahead if first == number]


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

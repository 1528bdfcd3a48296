"""The slice ladder: slices by signed CoC radius, and the share of each pixel in them.

Slice radii stand on a ladder in px that depends on the quality alone. A pixel between two rungs
belongs to both, by weights that sum to one and keep the second moment of its blur: linear in r².
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.layers.quality import QUALITIES, Quality, find
from defocus_core.runtime.validation import number

# Radii in px up to which a pixel is in focus, its disc being much narrower than the pixel; and up
# to which it is less blurred than it should be, so that shares have no step.
SHARP, SOFT = 0.15, 0.25
# Radii in px below which each slice occludes for itself.
ALONE = 2.0
_PX = "radii are in px, negative nearer than focus"
# Cells of a table that is looked into, at most; and by how much of one rounding may be off.
_CELLS, _BESIDE = 1 << 14, 0.004


class UnreachableTolerance(ValueError):  # noqa: N818 - named for the argument at fault
    """No quality has slices as close to the pixels as the tolerance wants.

    Attributes:
        tolerance: The tolerance that was asked for, in px of radius.
        finest: The least tolerance that can be had, in px of radius, rounded up to 0.01 px.
        least: Signed radius in px of the nearest pixel.
        most: That of the farthest one.
        quality: The quality that has the finest slices.
    """

    def __init__(
        self, tolerance: float, finest: float, least: float, most: float, quality: str
    ) -> None:
        # All of the data are arguments of the exception, so that it can be pickled.
        super().__init__(tolerance, finest, least, most, quality)
        self.tolerance, self.finest, self.quality = tolerance, finest, quality
        self.least, self.most = least, most

    def __str__(self) -> str:
        """The name of the argument, wanted, got and remedy."""
        return (
            f"tolerance must be at least {self.finest:g} px where radii go from {self.least:.1f} "
            f"to {self.most:.1f} px, got {self.tolerance:g}; that is what {self.quality} has"
        )


def rungs(least: float, most: float, quality: Quality) -> tuple[float, ...]:
    """The part of the ladder that holds radii from least to most.

    It begins and ends on rungs that are an even number from focus, and has three at least: every
    other rung is a ladder over the same range.
    """
    reach = max(abs(least), abs(most))
    side = [0.0]
    while side[-1] < reach or len(side) % 2 == 0 or len(side) < 3:
        side.append(side[-1] + max(quality.near_spacing, quality.far_spacing * side[-1]))
    ladder = [-r for r in reversed(side[1:])] + side
    even = range(0, len(ladder), 2)
    first = max(i for i in even if ladder[i] <= least and i < len(ladder) - 1)
    last = min(i for i in even if ladder[i] >= most and i > first)
    return tuple(ladder[first : last + 1])


def quantisation(least: float, most: float, quality: str) -> float:
    """By how many px of radius a slice is off a pixel at most: half a step of the ladder.

    A pixel belongs to the slices on both sides, so that its blur is of the right width in any case.
    Where pictures are rendered at half of their size, cells add half a px.

    Args:
        least: Signed radius in px of the nearest pixel.
        most: That of the farthest one.
        quality: Whose ladder it is.

    Raises:
        ValueError: If there is no such quality, or radii are not finite and in order.
    """
    settings = find(quality)
    if not -math.inf < number("least", least, _PX) <= number("most", most, _PX) < math.inf:
        raise ValueError(f"least and most must be finite and in order, got {least}, {most}; {_PX}")
    ladder = rungs(least, most, settings)
    steps = [b - a for a, b in pairwise(ladder) if b > least and a < most]
    return max(steps, default=0.0) / 2 + (0.5 if settings.half_size else 0.0)


def cheapest_within(tolerance: float, least: float, most: float) -> str:
    """The cheapest quality whose slices are off by no more than a tolerance in px.

    Args:
        tolerance: In px of radius.
        least: Signed radius in px of the nearest pixel.
        most: That of the farthest one.

    Raises:
        UnreachableTolerance: If even the best is off by more.
        ValueError: If radii are not finite and in order.
    """
    tolerance = number("tolerance", tolerance, _PX)
    for quality in QUALITIES:
        if quantisation(least, most, quality) <= tolerance:
            return quality
    best = math.ceil(100 * quantisation(least, most, QUALITIES[-1])) / 100
    raise UnreachableTolerance(tolerance, best, least, most, QUALITIES[-1])


def evenly(least: float, most: float, count: int) -> tuple[float, ...]:
    """Exactly `count` radii from least to most; one stands in the middle."""
    if count == 1:
        return ((least + most) / 2,)
    return tuple(least + (most - least) * k / (count - 1) for k in range(count))


def layers(radii: tuple[float, ...], quality: Quality) -> list[int]:
    """For each slice the number of its layer, ascending: slices of a layer add, layers occlude.

    Where |r| < 2 px each slice is a layer. Beyond, a layer holds the radii of one side of focus
    that differ by the quality's ratio at most, in ranges that are fixed as the ladder is. What is
    visible of two surfaces as close as that is nearly complementary after the blur, whichever is
    in front.
    """
    names: list[tuple[int, float]] = []
    for r in radii:
        steps = math.log(max(abs(r), ALONE) / ALONE) / math.log(quality.layer_ratio)
        names.append((0, r) if abs(r) < ALONE else (1 if r > 0 else -1, math.floor(steps)))
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    return [number[name] for name in names]


def position(signed_radius: Tensor, radii: tuple[float, ...]) -> Tensor:
    """Where radii [...] px stand on the ladder: k on rung k, between k and k + 1 by shares.

    What lies beyond an end of the ladder belongs to this end. Differentiable in the radius.
    """
    if len(radii) == 1:
        return torch.zeros_like(signed_radius)
    pieces = _pieces(radii)
    lower, a, b, c = (
        torch.tensor(column, dtype=torch.float64).to(signed_radius.device, signed_radius.dtype)
        for column in zip(*((p.rung, p.a, p.b, p.c) for p in pieces), strict=True)
    )
    r = signed_radius.flatten()
    piece = _between(r.detach(), [p.end for p in pieces[:-1]])
    share = torch.addcmul(c.index_select(0, piece), a.index_select(0, piece), r * r)
    if any(p.b for p in pieces):
        share = share.addcmul(b.index_select(0, piece), r)
    places = lower.index_select(0, piece) + share.clamp(0, 1)
    return places.reshape(signed_radius.shape)


def _between(values: Tensor, ends: list[float]) -> Tensor:
    """Between which of some ascending ends values [n] are: how many of these do not exceed them.

    Cells narrower than the space between two ends hold one at most, so that a look into a table and
    a comparison will do: faster than a search, and as fast where neighbours are not alike.
    """
    limits = torch.tensor(ends, dtype=torch.float64, device="cpu").to(values.dtype)
    exact = limits.double()
    width = 0.99 * min((b - a for a, b in pairwise(exact.tolist())), default=0.0)
    if not (width and ends[-1] - ends[0] < _CELLS * width):
        return torch.bucketize(values, limits.to(values.device), right=True, out_int32=True)
    first, count = float(exact[0]) - width, 2 + int((ends[-1] - ends[0] + width) / width)
    # by rounding a value may be in the cell beside its own
    starts = first + width * (torch.arange(count, dtype=exact.dtype, device="cpu") - _BESIDE)
    before = torch.bucketize(starts, exact, right=True)
    following = torch.cat([limits, limits.new_full((1,), math.inf)])[before]
    passed, following = before.to(values), following.to(values.device)
    cell = (values - first).mul_(1 / width).clamp_(0, count - 1).int()
    more = following.index_select(0, cell).le_(values)
    return passed.index_select(0, cell).add_(more).int()


class _Piece(NamedTuple):
    """Radii up to an end in px, whose share in the rung after `rung` is a r² + b r + c."""

    rung: int
    end: float
    a: float
    b: float
    c: float


def _pieces(radii: tuple[float, ...]) -> list[_Piece]:
    """How shares follow from radii, in ascending order."""
    found = []
    for rung, (low, high) in enumerate(pairwise(radii)):
        square, width = high * high - low * low, high - low
        if low * high < 0:  # the ladder has no rung in focus
            found.append(_Piece(rung, high, 0.0, 1 / width, -low / width))
            continue
        a = 1 / square if square else 0.0
        whole = _Piece(rung, high, a, 0.0, -a * low * low)
        sharp = [] if min(abs(low), abs(high)) or max(-low, high) < 2 * SOFT else _sharp(whole)
        found += [*sharp, whole] if high > 0 else [whole, *sharp]
        if sharp and high == 0:
            found[-3] = whole._replace(end=-SOFT)
    return found


def _sharp(whole: _Piece) -> list[_Piece]:
    """What stands for a piece next to focus from 0 to SHARP, and from there to SOFT."""
    k = whole.a * (SOFT / (SOFT - SHARP)) ** 2  # times (|r| - SHARP)²
    if whole.end > 0:
        between = _Piece(whole.rung, SOFT, k, -2 * k * SHARP, k * SHARP**2)
        return [_Piece(whole.rung, SHARP, 0.0, 0.0, 0.0), between]
    between = _Piece(whole.rung, -SHARP, k, 2 * k * SHARP, 1 + k * SHARP**2)
    return [between, _Piece(whole.rung, 0.0, 0.0, 0.0, 1.0)]


def membership(places: Tensor, slices: Tensor) -> Tensor:
    """Share of pixels at the given positions [H, W] in slices [K]: [K, H, W], a partition of 1."""
    return (places - slices[:, None, None]).abs_().neg_().add_(1).clamp_(min=0)

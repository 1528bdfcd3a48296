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

from defocus_core.allowed_values import QUALITIES
from defocus_core.renderer.layers.quality import Quality, find
from defocus_core.tensors.validation import number

# Up to a radius of SHARP px a pixel counts as in focus: its disc is much narrower than the pixel.
# From there to SOFT its blur rises to what its radius says, so that shares have no step.
SHARP, SOFT = 0.15, 0.25
# Radius in px below which each slice is a layer of its own.
ALONE = 2.0
_PX = "radii are in px, negative nearer than focus"


class UnreachableTolerance(ValueError):  # noqa: N818 - named for the argument at fault
    """No quality has slices as close to the radii of pixels as the tolerance asks for.

    Attributes:
        tolerance: The tolerance that was asked for, in px of radius.
        finest: The least tolerance that a quality reaches, in px of radius, rounded up to 0.01 px.
        least: Signed radius in px of the nearest pixel.
        most: Signed radius in px of the farthest pixel.
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
    """The greatest distance in px from the radius of a pixel to the nearest rung: half a step.

    A pixel belongs to the slices on both sides, so that its blur has the right width in any case.
    If the quality renders at half size, the rounding to cells adds half a px.

    Args:
        least: Signed radius in px of the nearest pixel.
        most: Signed radius in px of the farthest pixel.
        quality: Name of the quality whose ladder is used.

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
    """The cheapest quality whose `quantisation` is within a tolerance.

    Args:
        tolerance: In px of radius.
        least: Signed radius in px of the nearest pixel.
        most: Signed radius in px of the farthest pixel.

    Raises:
        UnreachableTolerance: If no quality is within the tolerance.
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
    whose ratio is at most that of the quality; the ranges are fixed, as the ladder is. The visible
    parts of two surfaces so close to each other are nearly complementary after the blur, whichever
    is in front.
    """
    names: list[tuple[int, float]] = []
    for r in radii:
        steps = math.log(max(abs(r), ALONE) / ALONE) / math.log(quality.layer_ratio)
        names.append((0, r) if abs(r) < ALONE else (1 if r > 0 else -1, math.floor(steps)))
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    return [number[name] for name in names]


def position(signed_radius: Tensor, radii: tuple[float, ...]) -> Tensor:
    """Places of radii [...] px on the ladder: k on rung k, k + share between rungs k and k + 1.

    A radius beyond an end of the ladder gets the place of this end. Differentiable in the radius.
    """
    if len(radii) == 1:
        return torch.zeros_like(signed_radius)
    pieces = _pieces(radii)
    lower, a, b, c = (
        torch.tensor(column, dtype=torch.float64).to(signed_radius.device, signed_radius.dtype)
        for column in zip(*((p.rung, p.a, p.b, p.c) for p in pieces), strict=True)
    )
    r = signed_radius.flatten()
    ends = torch.tensor([p.end for p in pieces[:-1]], dtype=torch.float64).to(r)
    piece = torch.bucketize(r.detach(), ends, right=True, out_int32=True)
    share = torch.addcmul(c.index_select(0, piece), a.index_select(0, piece), r * r)
    if any(p.b for p in pieces):
        share = share.addcmul(b.index_select(0, piece), r)
    places = lower.index_select(0, piece) + share.clamp(0, 1)
    return places.reshape(signed_radius.shape)


class _QuadraticPiece(NamedTuple):
    """Radii up to `end` px, whose share in the slice after `rung` is a r² + b r + c."""

    rung: int
    end: float
    a: float
    b: float
    c: float


def _pieces(radii: tuple[float, ...]) -> list[_QuadraticPiece]:
    """The pieces of the function from radii to shares, in ascending order."""
    pieces = []
    for rung, (low, high) in enumerate(pairwise(radii)):
        square, width = high * high - low * low, high - low
        if low * high < 0:  # the ladder has no rung in focus
            pieces.append(_QuadraticPiece(rung, high, 0.0, 1 / width, -low / width))
            continue
        a = 1 / square if square else 0.0
        whole = _QuadraticPiece(rung, high, a, 0.0, -a * low * low)
        sharp = [] if min(abs(low), abs(high)) or max(-low, high) < 2 * SOFT else _sharp(whole)
        pieces += [*sharp, whole] if high > 0 else [whole, *sharp]
        if sharp and high == 0:
            pieces[-3] = whole._replace(end=-SOFT)
    return pieces


def _sharp(whole: _QuadraticPiece) -> list[_QuadraticPiece]:
    """Two pieces that replace one next to focus: from 0 to SHARP, and from SHARP to SOFT."""
    k = whole.a * (SOFT / (SOFT - SHARP)) ** 2  # times (|r| - SHARP)²
    if whole.end > 0:
        between = _QuadraticPiece(whole.rung, SOFT, k, -2 * k * SHARP, k * SHARP**2)
        return [_QuadraticPiece(whole.rung, SHARP, 0.0, 0.0, 0.0), between]
    between = _QuadraticPiece(whole.rung, -SHARP, k, 2 * k * SHARP, 1 + k * SHARP**2)
    return [between, _QuadraticPiece(whole.rung, 0.0, 0.0, 0.0, 1.0)]


def membership(places: Tensor, slices: Tensor) -> Tensor:
    """Shares [K, H, W] of pixels of places [H, W] in slices [K]; over all slices they sum to 1."""
    return (1 - (places - slices[:, None, None]).abs_()).clamp_(min=0)

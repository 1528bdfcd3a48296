"""Diagnosis of a depth map: noise, anti-aliased, soft or ramped edges, quantised levels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import islice
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.antialiased import averaged_from, averages
from defocus_core.depth.distance_scale import DistanceScale, distance_scale
from defocus_core.depth.edge_shifts import EdgeShifts
from defocus_core.depth.noise import noise_from, scatter_counts
from defocus_core.depth.quantised import are_few, steps_of
from defocus_core.depth.soft_edges import (
    FOOT_FRACTION,
    MINIMUM,
    STEEP,
    are_steeper,
    hard_steps,
    slope_of_soft_edges,
    softness,
    steepness,
)
from defocus_core.tensors.device_plan import launches_cost, sent
from defocus_core.tensors.neighbourhoods import extreme_around, ranges_of
from defocus_core.tensors.source import Pixels, Scalar, bands
from defocus_core.tensors.threads import threaded

# Greatest share of a frame that edges take; a frame that is steep beyond it is a steep surface.
_EDGES = 0.4
# Greatest half width in px of a soft edge; px beside it in which the surfaces are seen.
_HALF_EDGE, _BESIDE_EDGE = 14, 16
# Hard steps of radius for each hard step of distance from which on edges are soft in distance.
_LOPSIDED = 4
# Intervals of a px in the histogram of widths of soft edges.
_PER_PX = 10
# Slope of an edge of averages, as a share of that of a soft edge.
_AVERAGED = 0.4
# Hard edges for each pixel on a ramp from which on the ramps are surfaces, not edges.
_RARE = 16
# Rows above and below a band that are evidence for it.
_AROUND = 3


class _BandEvidence(NamedTuple):
    """The share of a band of rows in the evidence for the repair that a frame needs.

    Of a batch of frames each has a first dimension more.
    """

    scatter: Tensor
    limits: Tensor  # [2] least and greatest radius in px
    softest: Tensor  # slope in px per px of the steepest soft edge
    ramps: Tensor  # number of pixels on steep ramps, wide or not
    steps: Tensor  # [2, 4], from `steps_of`
    averages: Tensor  # [2, 4], from `averages`


class DepthRepair(NamedTuple):
    """The repair of a depth map.

    Attributes:
        noise: Standard deviation in px of noise, which is smoothed; None for no noise.
        antialiased: For edges of averages: the signed radius in px at infinity if they average
            distance, infinity if they average disparity; None if edges are no averages.
        soft_edges: Least slope in px per px of ramps that become steps, where most edges are soft
            or averages; None where most are hard.
        ramps: Whether steep ramps between surfaces become steps.
        edge_shifts: The displacements of edges from those of the colours, which are undone; None
            if edges stay where they are.
        quantised: Whether steps between few levels become slopes.
        edge_width: Px over which soft edges go from one surface to the other, in the median, or as
            it was said; None if edges are not soft.
        fraction: Share of the pixels whose radius was changed; 0 of a diagnosis alone.
        ramps_of: The scale of distance, if ramps are of distance; None if they are of disparity.
    """

    noise: float | None = None
    antialiased: float | None = None
    soft_edges: float | None = None
    ramps: bool = False
    edge_shifts: EdgeShifts | None = None
    quantised: bool = False
    edge_width: float | None = None
    fraction: float = 0.0
    ramps_of: DistanceScale | None = None


def diagnosed(
    signed_radius: Pixels, infinity: float | None, threads: int, noise: float | None = None
) -> DepthRepair:
    """The repair that radii need; for noisy radii only the noise, which hides everything else.

    `signed_radius`: [H, W] px; `infinity`: signed radius in px of what is infinitely far; None if
    that is not known; `noise`: standard deviation in px of the noise that was smoothed; None to
    look for noise.
    """
    (found,) = _found(signed_radius, infinity, threads)
    return _diagnosis(signed_radius, found, infinity, noise)


def diagnosed_each(signed_radius: Tensor, infinity: Sequence[float | None]) -> list[DepthRepair]:
    """What `diagnosed` says of each picture of a batch [B, H, W]."""
    common: Scalar | None = infinity[0]
    if len(set(infinity)) > 1:  # of lenses, which all know it
        common = sent(infinity, signed_radius)
    every = zip(signed_radius, _found(signed_radius, common, 1), infinity, strict=True)
    return [_diagnosis(radii, evidence, limit, None) for radii, evidence, limit in every]


def _found(
    signed_radius: Pixels, infinity: Scalar | None, threads: int
) -> list[dict[str, list[float]]]:
    """The evidence of a picture [H, W], or of each of a batch [B, H, W], by name."""
    dtype = torch.promote_types(signed_radius.dtype, torch.float32)

    def evidence(rows: tuple[int, int]) -> _BandEvidence:
        return _evidence(signed_radius, rows, dtype, infinity)

    count = math.prod(signed_radius.shape[:-2])
    return _fetched(list(threaded(evidence, bands(signed_radius), threads)), count)


def _diagnosis(
    signed_radius: Pixels,
    found: dict[str, list[float]],
    infinity: float | None,
    noise: float | None,
) -> DepthRepair:
    """The repair that the evidence of a picture asks for; arguments of `diagnosed`."""
    if noise is None:
        noise = noise_from([round(count) for count in found["scatter"]])
        if noise is not None:
            return DepthRepair(noise=noise)
    return _repair(signed_radius, found, infinity)._replace(noise=noise)


def _fetched(of_bands: list[_BandEvidence], count: int) -> list[dict[str, list[float]]]:
    """The evidence of all bands together for each picture, brought to the host at once."""
    together = {}
    for name, parts in zip(_BandEvidence._fields, zip(*of_bands, strict=True), strict=True):
        every = torch.stack(parts).reshape(len(parts), count, -1).double()
        if name == "limits":
            together[name] = torch.stack([every[..., 0].amin(0), every[..., 1].amax(0)], 1)
        else:
            together[name] = every.amax(0) if name == "softest" else every.sum(0)
    pictures = map(iter, torch.cat(list(together.values()), 1).tolist())
    return [
        {name: list(islice(values, each.shape[1])) for name, each in together.items()}
        for values in pictures
    ]


def _evidence(
    signed_radius: Pixels, rows: tuple[int, int], dtype: torch.dtype, infinity: Scalar | None
) -> _BandEvidence:
    """The evidence of the rows [first, end)."""
    above = min(rows[0], _AROUND)
    around = signed_radius[..., rows[0] - above : rows[1] + _AROUND, :].detach().to(dtype)
    band = (above, above + rows[1] - rows[0])
    within = (..., slice(*band), slice(None))
    r, steps = around[within], [around.diff(dim=dim) for dim in (-2, -1)]
    sizes = [step.abs() for step in steps]
    greatest = [size.amax() for size in sizes if size.numel()]
    steepest = float(torch.stack(greatest).amax()) if greatest else 0.0
    limits, each = ranges_of(r), r.shape[:-2]
    softest, averaged = limits.new_zeros(each), limits.new_zeros((*each, 2, 4), dtype=torch.float64)
    ramps = torch.zeros(each, dtype=torch.long, device=r.device)
    if steepest > MINIMUM:
        if launches_cost(r.device) or any(
            are_steeper(step, dim, MINIMUM) for dim, step in enumerate(steps)
        ):
            slope = steepness(around)
            softest = softness(slope)[within].amax((-2, -1))
            ramps = (slope[within] > STEEP).sum((-2, -1))
        averaged = averages(around, sizes, band, infinity)
    scatter = scatter_counts(steps, band, steepest)
    counts = steps_of([size[within] for size in sizes], steepest)
    return _BandEvidence(scatter, limits, softest, ramps, counts, averaged)


def _repair(
    signed_radius: Pixels, found: dict[str, list[float]], infinity: float | None
) -> DepthRepair:
    """The repair that the evidence of all bands asks for."""
    minimum, maximum, softest, ramps = *found["limits"], *found["softest"], *found["ramps"]
    if not (math.isfinite(minimum) and math.isfinite(maximum)):
        return DepthRepair()  # a picture of such depth is refused
    slope = slope_of_soft_edges(minimum, maximum, signed_radius.shape)
    soft, width, scale = 0, None, None
    if softest > slope:
        soft, width, scale = _soft_edges(
            signed_radius, slope, distance_scale(minimum, maximum, infinity)
        )
    averaged, steps = ([each[:4], each[4:]] for each in (found["averages"], found["steps"]))
    antialiased = averaged_from(averaged, infinity, soft)
    soft_edges = slope if soft else None
    if antialiased is not None:
        soft_edges = max(MINIMUM, _AVERAGED * slope)
    return DepthRepair(
        antialiased=antialiased,
        ramps=softest > STEEP or _has_ramps(signed_radius, int(ramps)),
        soft_edges=soft_edges,
        quantised=are_few(steps, signed_radius),
        edge_width=width if soft and antialiased is None else None,
        ramps_of=scale if antialiased is None else None,
    )


def _has_ramps(signed_radius: Pixels, pixels: int) -> bool:
    """Whether the given number of pixels on steep ramps are edges that the depth map has smoothed.

    A few ramps among many hard edges are surfaces that are seen between two others.
    """
    hard, enough = 0, _RARE * pixels
    for first, last in bands(signed_radius):
        if hard <= enough and pixels:
            around = signed_radius[max(0, first - 1) : last + 2]
            hard += int(hard_steps(around, STEEP))
    return pixels > 0 and hard <= enough


class _EdgeCounts(NamedTuple):
    """Edges of a frame."""

    soft: int  # number of pixels on soft edges
    hard: int  # number of steps that are hard edges
    width: float  # median width of soft edges in px

    @property
    def mostly_soft(self) -> bool:
        return self.hard < self.soft


def _soft_edges(
    signed_radius: Pixels, steep: float, scale: DistanceScale | None
) -> tuple[int, float | None, DistanceScale | None]:
    """The number of pixels on soft edges, their median width in px, and the scale of their ramps.

    0 if hard edges have more pixels, and if so large a share of the frame is steep that it is a
    surface, as in a frame of few px. What looks hard in radius may be soft in distance.
    """
    maximum = _EDGES * signed_radius.shape[0] * signed_radius.shape[1]
    of_radius = _edge_counts(signed_radius, steep)
    found: list[tuple[_EdgeCounts, DistanceScale | None]] = []
    if of_radius.mostly_soft and of_radius.soft < maximum:
        found.append((of_radius, None))
    if scale is not None and of_radius.hard:
        of_distance = _edge_counts(signed_radius, steep, scale)
        few_hard = _LOPSIDED * of_distance.hard < of_radius.hard
        if few_hard and of_distance.mostly_soft and of_distance.soft < maximum:
            found.append((of_distance, scale))
    if not found:
        return 0, None, None
    edges, of = max(found, key=lambda each: each[0].soft)
    return edges.soft, edges.width, of


def _edge_counts(
    signed_radius: Pixels, steep: float, scale: DistanceScale | None = None
) -> _EdgeCounts:
    """The edges of radii [H, W] px, of distance if a scale is given, steeper than a slope."""
    soft = hard = 0
    widths = torch.zeros(2 * _HALF_EDGE * _PER_PX + 1, dtype=torch.long)
    for first, last in bands(signed_radius):
        above = min(first, _BESIDE_EDGE + 1)
        around = signed_radius[first - above : last + _BESIDE_EDGE + 1].detach()
        steepest = steepness(around)
        if scale is not None:
            slow = steepest <= FOOT_FRACTION * steep  # far slopes are steep in distance
            around = scale.of(around)
            steepest = steepness(around).masked_fill_(slow, 0.0)
        slope = softness(steepest)
        minimum, maximum = (
            extreme_around(around, _BESIDE_EDGE, end) for end in (torch.minimum, torch.maximum)
        )
        to_ends = torch.maximum(around - minimum, maximum - around)
        is_edge = (slope > steep) & (to_ends < _HALF_EDGE * slope)
        soft += int(is_edge[above : above + last - first].sum())
        middle = is_edge & (steepest == extreme_around(steepest, 1, torch.maximum))
        wide = ((maximum - minimum) / steepest)[above : above + last - first]
        wide = wide[middle[above : above + last - first]] * _PER_PX
        widths += torch.bincount(wide.round().long().cpu(), minlength=len(widths))
        with_next = signed_radius[max(first - 2, 0) : last + 2].detach()
        hard += int(hard_steps(with_next, steep, scale))
    half = int((widths.cumsum(0) < widths.sum() / 2).sum())
    return _EdgeCounts(soft, hard, half / _PER_PX)

"""One repair of depth for all frames of a shot: what is decided for each frame could flip.

Radii of one scene through two lenses differ by a factor and a shift, as both are affine in
disparity. So thresholds in px of radius are multiples of this factor, the scale of a lens: px of
radius for a disparity of 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.displacement import EdgeShifts
from defocus_core.depth.distance_scale import DistanceScale
from defocus_core.depth.ramps import MINIMUM, STEEP


def agreed_repair(repairs: Sequence[DepthRepair], scales: Sequence[float]) -> DepthRepair:
    """The repair that most of some frames need, for a lens of scale 1."""
    if not repairs or len(repairs) != len(scales):
        raise ValueError(
            f"repairs and scales must be of as many frames, got {len(repairs)} and {len(scales)}"
        )
    each = list(zip(repairs, scales, strict=True))
    noise = _median([None if r.noise is None else r.noise / k for r, k in each])
    soft = _median([None if r.soft_edges is None else r.soft_edges / k for r, k in each])
    averaged = _commonest([r.antialiased is not None for r, _ in each])
    of_disparity = _commonest(
        [r.antialiased == float("inf") for r, _ in each if r.antialiased is not None]
    )
    return DepthRepair(
        noise=noise,
        antialiased=(float("inf") if of_disparity else 0.0) if averaged else None,
        soft_edges=soft,
        wide_edges=_median([None if r.wide_edges is None else r.wide_edges / k for r, k in each]),
        ramps=_commonest([r.ramps for r, _ in each]),
        edge_shifts=_agreed_shifts([(r.edge_shifts, k) for r, k in each]),
        edge_width=_median([r.edge_width for r, _ in each]),
        quantised=_commonest([r.quantised for r, _ in each]),
        ramps_of=_agreed_scale([(r.ramps_of, k) for r, k in each]),
    )


def repair_through(repair: DepthRepair, scale: float, infinity: float | None) -> DepthRepair:
    """An agreed repair for the frame of another lens.

    `infinity`: signed radius in px of what is infinitely far; None if that is not known.
    """
    shifts, averaged = repair.edge_shifts, repair.antialiased
    if averaged is not None and averaged != float("inf"):
        averaged = infinity  # of distance: known, or it would not have been found
    ramps_of = repair.ramps_of
    if ramps_of is not None and infinity is not None:
        ramps_of = ramps_of.through(scale, infinity)
    return repair._replace(
        noise=None if repair.noise is None else repair.noise * scale,
        antialiased=averaged,
        soft_edges=_slope_through(repair.soft_edges, scale),
        wide_edges=_slope_through(repair.wide_edges, scale),
        edge_shifts=None if shifts is None else shifts._replace(step=shifts.step * scale),
        ramps_of=ramps_of,
    )


def _slope_through(slope: float | None, scale: float) -> float | None:
    """The least slope of soft edges for the frame of another lens."""
    return None if slope is None else min(STEEP, max(MINIMUM, slope * scale))


def _agreed_shifts(of_frames: Sequence[tuple[EdgeShifts | None, float]]) -> EdgeShifts | None:
    """The displacements of edges in most frames; a displacement costs what it does on average."""
    there = [(shifts, scale) for shifts, scale in of_frames if shifts is not None]
    if 2 * len(there) <= len(of_frames):
        return None
    costs = zip(*(shifts.rarity for shifts, _ in there), strict=True)
    return EdgeShifts(
        step=median(shifts.step / scale for shifts, scale in there),
        median=median(shifts.median for shifts, _ in there),
        rarity=tuple(sum(cost) / len(there) for cost in costs),
        trust=median(shifts.trust for shifts, _ in there),
    )


def _agreed_scale(of_frames: Sequence[tuple[DistanceScale | None, float]]) -> DistanceScale | None:
    """The scale of all distances of the frames, if the ramps of most are of distance."""
    there = [(ramps_of, scale) for ramps_of, scale in of_frames if ramps_of is not None]
    if 2 * len(there) <= len(of_frames):
        return None
    nearest = max(ramps_of.nearest / scale for ramps_of, scale in there)
    farthest = min(ramps_of.farthest / scale for ramps_of, scale in there)
    return DistanceScale(0.0, nearest, farthest)


def _commonest(answers: Sequence[bool]) -> bool:
    return 2 * sum(answers) > len(answers)


def _median(values: Sequence[float | None]) -> float | None:
    """The median of the values if most frames have one."""
    there = [value for value in values if value is not None]
    return median(there) if 2 * len(there) > len(values) else None

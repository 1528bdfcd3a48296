"""Diagnosis of a depth map: noise, anti-aliased, soft or ramped edges, quantised levels."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.antialiased import EVERY, averaged_from, averages
from defocus_core.depth.edge_shifts import EdgeShifts
from defocus_core.depth.noise import noise_from, scatter_counts
from defocus_core.depth.quantised import Levels, are_few, levels_of
from defocus_core.depth.soft_edges import (
    LEAST,
    STEEP,
    are_steeper,
    hard_steps,
    slope_of_soft_edges,
    softness,
    steepness,
)
from defocus_core.images.neighbourhoods import ends_of, extreme_around
from defocus_core.images.source import Pixels, bands, spread
from defocus_core.runtime.threads import threaded

# Greatest share of a frame that edges take; a frame that is steep beyond it is a steep surface.
_EDGES = 0.4
# Greatest half width in px of a soft edge; px beside it in which the surfaces are seen.
_HALF_EDGE, _BESIDE_EDGE = 14, 16
# Intervals of a px in the histogram of widths of soft edges.
_PER_PX = 10
# Hard edges for each pixel on a ramp from which on the ramps are surfaces, not edges.
_RARE = 16
# Distance of the rows that are searched for levels, counted from either end of the frame.
_LEVEL_ROWS = 12


class _Evidence(NamedTuple):
    """The share of a band of rows in the evidence for the repair that a frame needs.

    Attributes:
        scatter: From `scatter_counts`.
        ends: [2] least and greatest radius in px.
        softest: Slope in px per px of the steepest soft edge.
        ramps: Number of pixels on steep ramps, wide or not.
        levels: Of depth.
        averages: [2, 4], from `averages`.
    """

    scatter: Tensor
    ends: Tensor
    softest: Tensor
    ramps: Tensor
    levels: Levels
    averages: Tensor


class DepthRepair(NamedTuple):
    """The repair of a depth map.

    Attributes:
        noise: Standard deviation in px of noise, which is smoothed; None for no noise.
        antialiased: For edges of averages, made hard: the signed radius in px at infinity if they
            average distance, infinity if they average disparity; None if edges are no averages.
        soft_edges: Least slope in px per px of ramps that become steps, where most edges are soft;
            None where most are hard.
        ramps: Whether steep ramps between surfaces become steps.
        edge_shifts: The displacements of edges from those of the colours, which are undone; None
            if edges stay where they are.
        quantised: Whether steps between few levels become slopes.
        edge_width: Px over which soft edges go from one surface to the other, in the median, or as
            it was said; None if edges are not soft.
        share: Share of the pixels whose radius was changed; 0 of a diagnosis alone.
        uncertain_edges: Whether colours say on which side of their edge pixels are: where edges
            were soft, or averages of an enlarged depth map; False of a diagnosis alone.
    """

    noise: float | None = None
    antialiased: float | None = None
    soft_edges: float | None = None
    ramps: bool = False
    edge_shifts: EdgeShifts | None = None
    quantised: bool = False
    edge_width: float | None = None
    share: float = 0.0
    uncertain_edges: bool = False


def diagnosed(
    signed_radius: Pixels, infinity: float | None, threads: int, noise: float | None = None
) -> DepthRepair:
    """The repair that radii need; for noisy radii only the noise, which hides everything else.

    Args:
        signed_radius: [H, W] px.
        infinity: Signed radius in px of what is infinitely far; None if that is not known.
        threads: Number of bands of rows examined at once.
        noise: Standard deviation in px of the noise that was smoothed; None to look for noise.
    """
    dtype = torch.promote_types(signed_radius.dtype, torch.float32)

    def evidence(rows: tuple[int, int]) -> _Evidence:
        return _evidence(signed_radius, rows, dtype, infinity)

    of_bands = list(threaded(evidence, bands(*signed_radius.shape), threads))
    if noise is None:
        noise = noise_from(torch.stack([band.scatter for band in of_bands]).sum(0))
        if noise is not None:
            return DepthRepair(noise=noise)
    return _repair(signed_radius, of_bands, infinity)._replace(noise=noise)


def _evidence(
    signed_radius: Pixels, rows: tuple[int, int], dtype: torch.dtype, infinity: float | None
) -> _Evidence:
    """The evidence of the rows [first, end)."""
    H, W = signed_radius.shape
    above = min(rows[0], 2)
    around = signed_radius[rows[0] - above : rows[1] + 2].detach().to(dtype)
    below = around[above : above + rows[1] + 1 - rows[0]]
    r = below[: rows[1] - rows[0]]
    steps = [around.diff(dim=dim) for dim in (0, 1)]
    steepest = max(float(ends_of(step).abs().amax()) if step.numel() else 0.0 for step in steps)
    ends = ends_of(r)
    softest, averaged = ends.new_zeros(()), ends.new_zeros((2, 4), dtype=torch.float64)
    ramps = torch.zeros((), dtype=torch.long, device=r.device)
    if steepest > LEAST:
        if any(are_steeper(step, dim, LEAST) for dim, step in enumerate(steps)):
            slope = steepness(around)
            softest = softness(slope)[above : above + len(r)].amax()
            ramps = (slope[above : above + len(r)] > STEEP).sum()
        averaged = averages(r, spread(H, EVERY, *rows), spread(W, EVERY), infinity)
    scatter = scatter_counts(around, rows[0] - above, rows, H)
    sample = spread(H, _LEVEL_ROWS, *rows)
    levels = levels_of(r[sample], below[1:][[i for i in sample if i + 1 < len(below)]])
    return _Evidence(scatter, ends, softest, ramps, levels, averaged)


def _repair(
    signed_radius: Pixels, of_bands: list[_Evidence], infinity: float | None
) -> DepthRepair:
    """The repair that the evidence of all bands asks for."""
    ends = torch.stack([band.ends for band in of_bands])
    if not bool(torch.isfinite(ends).all()):
        return DepthRepair()  # a picture of such depth is refused
    softest = float(torch.stack([band.softest for band in of_bands]).amax())
    ramps = torch.stack([band.ramps for band in of_bands]).sum()
    slope = slope_of_soft_edges(
        float(ends[:, 0].amin()), float(ends[:, 1].amax()), signed_radius.shape
    )
    soft, width = _mostly_soft(signed_radius, slope) if softest > slope else (0, None)
    averaged = torch.stack([band.averages for band in of_bands]).sum(0)
    antialiased = averaged_from(averaged, infinity, soft)
    return DepthRepair(
        antialiased=antialiased,
        ramps=softest > STEEP or _has_ramps(signed_radius, int(ramps)),
        soft_edges=slope if soft and antialiased is None else None,
        quantised=are_few([band.levels for band in of_bands]),
        edge_width=width if soft and antialiased is None else None,
    )


def _has_ramps(signed_radius: Pixels, pixels: int) -> bool:
    """Whether the given number of pixels on steep ramps are edges that the depth map has smoothed.

    A few ramps among many hard edges are surfaces that are seen between two others.
    """
    hard, enough = 0, _RARE * pixels
    for first, last in bands(*signed_radius.shape):
        if hard <= enough and pixels:
            around = signed_radius[max(0, first - 1) : last + 2]
            hard += int(hard_steps(around, STEEP))
    return pixels > 0 and hard <= enough


def _mostly_soft(signed_radius: Pixels, steep: float) -> tuple[int, float | None]:
    """The number of pixels on soft edges steeper than a slope, and the median width of edges in px.

    0 if hard edges have more pixels, and if so large a share of the frame is steep that it is a
    surface, as in a frame of few px.
    """
    soft = hard = 0
    widths = torch.zeros(2 * _HALF_EDGE * _PER_PX + 1, dtype=torch.long)
    for first, last in bands(*signed_radius.shape):
        above = min(first, _BESIDE_EDGE + 1)
        around = signed_radius[first - above : last + _BESIDE_EDGE + 1].detach()
        steepest = steepness(around)
        slope = softness(steepest)
        least, most = (
            extreme_around(around, _BESIDE_EDGE, end) for end in (torch.minimum, torch.maximum)
        )
        to_ends = torch.maximum(around - least, most - around)
        is_edge = (slope > steep) & (to_ends < _HALF_EDGE * slope)
        soft += int(is_edge[above : above + last - first].sum())
        middle = is_edge & (steepest == extreme_around(steepest, 1, torch.maximum))
        wide = ((most - least) / steepest)[above : above + last - first]
        wide = wide[middle[above : above + last - first]] * _PER_PX
        widths += torch.bincount(wide.round().long().cpu(), minlength=len(widths))
        hard += int(hard_steps(signed_radius[max(first - 2, 0) : last + 2].detach(), steep))
    height, width = signed_radius.shape
    if not hard < soft < _EDGES * height * width:
        return 0, None
    half = int((widths.cumsum(0) < widths.sum() / 2).sum())
    return soft, half / _PER_PX

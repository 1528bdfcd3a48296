"""Diagnosis of a depth map: noise, anti-aliased, soft or ramped edges, quantised levels.

A depth map that was filtered like colours, or resized, holds depths at which there is no surface.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import islice
from typing import NamedTuple

from defocus_core.depth.displacement import EdgeShifts
from defocus_core.depth.ramps import (
    FOOT_FRACTION,
    MINIMUM,
    STEEP,
    DistanceScale,
    distance_scale,
    hard_steps,
    reduced,
    reduction,
    slope_of_soft_edges,
    softness,
    steepness,
)
from defocus_core.depth.smoothing import are_few, noise_from, scatter_counts, steps_of
from defocus_core.tensors.device_plan import bands
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.neighbourhoods import exceeding, extreme_around, flat_nonzero, range_of
from defocus_core.tensors.threads import threaded
from defocus_core.tensors.ties import off_round

# Least range in px of the radii within 3 px that makes an edge.
MATTERS = off_round(1.0)
# Px around an edge in which both surfaces are seen.
_BESIDE = 3
# The share of an edge's height that the middle 3 px of a narrow edge span; the distance in height
# from both ends, as a share, from which a pixel is an average; and the greatest slope beside a hard
# step, as a share of the step.
ABRUPT, AVERAGE, FLAT = 0.5, 0.1, 0.1
# Least number of averages in all, for each hard step, and for each pixel on a wide edge.
FEWEST, EACH, _WIDER = 64, 2, 0.25


def averages(band: Tensor, rows: tuple[int, int]) -> Tensor:
    """Counts [3] of averages on narrow edges, of pixels on wide edges, and of hard steps.

    An average is a pixel of an edge with the mean depth of both surfaces. Edges along both axes
    count; 3 px span most of a narrow one. `band`: [h, W] px, the counted rows and up to three rows
    of the frame above and below; `rows`: (first, end) of the counted rows in the band.
    """
    radii = _runs(band, rows, slice(0, 2 * _BESIDE + 1, 2 * _BESIDE), 2 * _BESIDE + 1)
    before, step, after = _runs(band, rows, slice(1, 3), 4).diff(dim=1).abs().unbind(1)
    hard = torch.maximum(before, after) < FLAT * step
    return torch.stack([each.sum() for each in (*_on_edges(radii), hard)])


def _runs(band: Tensor, rows: tuple[int, int], ends: slice, width: int) -> Tensor:
    """Radii [m, width] of all runs of `width` pixels that cross an edge, along both axes.

    A run crosses an edge if the two pixels that the slice `ends` picks differ by more than MATTERS
    px. `rows`: (first, end) of the rows of the band in which runs have their middles.
    """
    every, before = [band.new_zeros((0, width))], (width - 1) // 2
    for dim in (-2, -1):
        if band.shape[dim] >= width:
            shift = before if dim == -2 else 0
            runs = band.unfold(dim, width, 1)[max(rows[0] - shift, 0) : max(rows[1] - shift, 0)]
            first, last = runs[..., ends].unbind(-1)
            index = flat_nonzero(exceeding((last - first).abs_(), MATTERS))
            row = index.div(max(runs.shape[1], 1), rounding_mode="floor")
            every.append(runs[row, index - row * runs.shape[1]])
    return torch.cat(every)


def are_averaged(counts: list[float]) -> bool:
    """Whether most edges of a frame show pixels with the mean depth of both surfaces.

    `counts`: sums [3] of `averages` over the frame.
    """
    average, wide, hard = counts
    return average > max(_WIDER * wide, FEWEST, EACH * hard)


def _on_edges(values: Tensor) -> tuple[Tensor, Tensor]:
    """Whether the middle of 7 values [m, 7] is on a narrow edge, and whether it is on a wide one.

    Both are [m] bool. On an edge the values only rise or only fall, and at least one end is level.
    """
    close, near, all_seven = (
        torch.aminmax(values[:, _BESIDE - by : _BESIDE + by + 1], dim=1) for by in (1, 2, _BESIDE)
    )
    within, size, whole = (limits.max - limits.min for limits in (close, near, all_seven))
    position = (values[:, _BESIDE] - near.min) / torch.where(size > 0, size, 1.0)
    step, level = values.diff(dim=1), FLAT * whole
    minimum, maximum = torch.aminmax(step[:, 1:-1], dim=1)
    on_edge = (position > AVERAGE) & (position < 1 - AVERAGE)
    on_edge &= (minimum >= -level) | (maximum <= level)
    on_edge &= torch.minimum(step[:, 0].abs(), step[:, -1].abs()) < level
    abrupt = within > ABRUPT * whole
    return on_edge & abrupt, on_edge & ~abrupt


# Greatest half width in px of a soft edge; px around it in which both surfaces are looked for.
_HALF_EDGE, _BESIDE_EDGE = 14, 16
# Intervals per px in the histogram of the widths of soft edges.
_PER_PX = 10
# Least slope of antialiased edges, as a share of that of soft edges.
_AVERAGED = 0.4
# Number of hard edges for each pixel on a ramp above which ramps are taken for surfaces.
RARE = 16
# Rows above and below a band that the evidence of the band needs.
_AROUND = 3


class _BandEvidence(NamedTuple):
    """Evidence from a band of rows for the repair that a frame needs."""

    scatter: Tensor  # histogram, from `scatter_counts`
    limits: Tensor  # [2] least and greatest radius in px
    softest: Tensor  # slope in px per px of the steepest soft edge
    ramps: Tensor  # number of pixels on steep ramps, wide or not
    steps: Tensor  # [2, 4], from `steps_of`
    averages: Tensor  # [3], from `averages`


class DepthRepair(NamedTuple):
    """The repair of a depth map.

    Attributes:
        noise: Standard deviation in px of noise, which is smoothed; None for no noise.
        antialiased: Whether most edges show pixels with the mean depth of both surfaces.
        soft_edges: Least slope in px per px of ramps that become steps, if most edges are soft or
            antialiased; None if most are hard.
        ramps: Whether steep ramps between surfaces become steps.
        edge_shifts: The displacements of edges from those of the colours, which are undone; None if
            edges stay where they are.
        quantised: Whether steps between few levels become slopes.
        edge_width: Median width of soft edges in px, from one surface to the other, or the given
            width; None if edges are not soft.
        fraction: Share of the pixels whose radius was changed; 0 of a diagnosis alone.
        ramps_of: The scale of distance, if ramps are linear in distance; None if they are linear in
            disparity.
        wide_edges: As `soft_edges`, but in the picture reduced to a common size, the size at which
            a network drew its edges; None if most of these are hard.
    """

    noise: float | None = None
    antialiased: bool = False
    soft_edges: float | None = None
    ramps: bool = False
    edge_shifts: EdgeShifts | None = None
    quantised: bool = False
    edge_width: float | None = None
    fraction: float = 0.0
    ramps_of: DistanceScale | None = None
    wide_edges: float | None = None

    @property
    def least_slope(self) -> float | None:
        """Least slope in px per px of edges that are soft or wide; None where they are hard."""
        return self.wide_edges if self.soft_edges is None else self.soft_edges


def diagnosed(
    signed_radius: Tensor, infinity: float | None, threads: int, noise: float | None = None
) -> DepthRepair:
    """The repair that radii need; for noisy radii, the noise alone, which hides other faults.

    `signed_radius`: [H, W] px; `infinity`: signed radius in px at infinity; None if that is not
    known; `noise`: standard deviation in px of noise that was smoothed before; None to look for
    noise.
    """
    found = _found(signed_radius, threads)
    if noise is None:
        noise = noise_from([round(count) for count in found["scatter"]])
        if noise is not None:
            return DepthRepair(noise=noise)
    repair = _repair(signed_radius, found, infinity)
    return _with_wide_edges(repair, signed_radius, found, infinity)._replace(noise=noise)


def _found(signed_radius: Tensor, threads: int) -> dict[str, list[float]]:
    """The evidence of all bands of radii [H, W] px together, by field of `_BandEvidence`."""
    of_bands = threaded(partial(_evidence, signed_radius), bands(signed_radius), threads)
    together = {}
    for name, parts in zip(_BandEvidence._fields, zip(*of_bands, strict=True), strict=True):
        every = torch.stack(parts).reshape(len(parts), -1).double()
        if name == "limits":
            together[name] = torch.stack([every[:, 0].amin(), every[:, 1].amax()])
        else:
            together[name] = every.amax(0) if name == "softest" else every.sum(0)
    values = iter(torch.cat(list(together.values())).tolist())  # waits for a GPU once
    return {name: list(islice(values, len(each))) for name, each in together.items()}


def _with_wide_edges(
    repair: DepthRepair,
    signed_radius: Tensor,
    found: dict[str, list[float]],
    infinity: float | None,
) -> DepthRepair:
    """The repair of radii [H, W] px, completed for edges that are soft in the reduced picture."""
    by, (minimum, maximum) = reduction(signed_radius.shape), found["limits"]
    if by == 1 or not math.isfinite(maximum - minimum):
        return repair
    size = [length // by for length in signed_radius.shape]
    slope = slope_of_soft_edges(minimum / by, maximum / by, size)
    if found["softest"][0] <= slope and not repair.quantised:  # levels hide slopes
        return repair
    infinity = None if infinity is None else infinity / by
    small = reduced(signed_radius, by) / by
    wide = _repair(small, _found(small, 1), infinity)
    if wide.soft_edges is None or wide.antialiased:
        return repair
    if repair.antialiased:  # the ends of wide ramps look like averages
        repair = repair._replace(antialiased=False, soft_edges=None)
    repair = repair._replace(wide_edges=wide.soft_edges)
    if repair.soft_edges is not None or wide.edge_width is None:
        return repair
    scale = None if wide.ramps_of is None else wide.ramps_of.times(by)
    return repair._replace(edge_width=wide.edge_width * by, ramps_of=scale)


def _evidence(signed_radius: Tensor, rows: tuple[int, int]) -> _BandEvidence:
    """Evidence for a repair from the rows (first, end) of radii [H, W] px."""
    dtype = torch.promote_types(signed_radius.dtype, torch.float32)
    above = min(rows[0], _AROUND)
    around = signed_radius[rows[0] - above : rows[1] + _AROUND].detach().to(dtype)
    band = (above, above + rows[1] - rows[0])
    within = slice(*band)
    r, steps = around[within], [around.diff(dim=dim) for dim in (-2, -1)]
    sizes, limits = [step.abs() for step in steps], range_of(r)
    softest, averaged = limits.new_zeros(()), limits.new_zeros(3, dtype=torch.long)
    ramps = torch.zeros((), dtype=torch.long, device=r.device)
    greatest = [size.amax() for size in sizes if size.numel()]
    if greatest and float(torch.stack(greatest).amax()) > MINIMUM:
        slope = steepness(around)
        softest, ramps = softness(slope)[within].amax(), (slope[within] > STEEP).sum()
        averaged = averages(around, band)
    scatter, counts = scatter_counts(steps, band), steps_of([size[within] for size in sizes])
    return _BandEvidence(scatter, limits, softest, ramps, counts, averaged)


def _repair(
    signed_radius: Tensor, found: dict[str, list[float]], infinity: float | None
) -> DepthRepair:
    """The repair of radii [H, W] px that the evidence `found` in all bands calls for."""
    minimum, maximum, softest, ramps = *found["limits"], *found["softest"], *found["ramps"]
    if not (math.isfinite(minimum) and math.isfinite(maximum)):
        return DepthRepair()  # such depth is refused elsewhere
    slope = slope_of_soft_edges(minimum, maximum, signed_radius.shape)
    soft, width, scale = 0, 0.0, None
    if softest > slope:
        of_distance = distance_scale(minimum, maximum, infinity)
        soft, width, scale = _soft_edges(signed_radius, slope, of_distance)
    steps = [found["steps"][:4], found["steps"][4:]]
    antialiased = are_averaged(found["averages"])
    soft_edges = slope if soft else None
    if antialiased:
        soft_edges = max(MINIMUM, _AVERAGED * slope)
    # a few ramps among many hard edges are surfaces that are seen between two others
    has_ramps = ramps > 0 and int(hard_steps(signed_radius.detach(), STEEP)) <= RARE * ramps
    return DepthRepair(
        antialiased=antialiased,
        ramps=softest > STEEP or has_ramps,
        soft_edges=soft_edges,
        quantised=are_few(steps, signed_radius),
        edge_width=width if soft and not antialiased else None,
        ramps_of=None if antialiased else scale,
    )


def _soft_edges(
    signed_radius: Tensor, steep: float, scale: DistanceScale | None
) -> tuple[int, float, DistanceScale | None]:
    """The number of pixels on soft edges, their median width in px, and the scale of distance.

    Soft edges are steeper than `steep` px per px. Those that are hard in radius may be soft in
    distance: only then is the scale not None.
    """
    soft, hard, width = _edge_counts(signed_radius, steep)
    if scale is not None and hard:
        of_distance, _, width_of_distance = _edge_counts(signed_radius, steep, scale)
        if of_distance > soft:
            return of_distance, width_of_distance, scale
    return soft, width, None


def _edge_counts(
    signed_radius: Tensor, steep: float, scale: DistanceScale | None = None
) -> tuple[int, int, float]:
    """(number of pixels on soft edges, number of hard edges, median width of soft edges in px).

    Edges of radii [H, W] px, or of distance if there is a scale, count if they are steeper than
    `steep` px per px. The number of pixels on soft edges is 0 unless it exceeds that of hard edges.
    """
    soft = hard = 0
    widths = torch.zeros(2 * _HALF_EDGE * _PER_PX + 1, dtype=torch.long)
    for first, last in bands(signed_radius):
        above = min(first, _BESIDE_EDGE + 1)
        around = signed_radius[first - above : last + _BESIDE_EDGE + 1].detach()
        steepest = steepness(around)
        if scale is not None:
            slow = steepest <= FOOT_FRACTION * steep  # far slopes are steep in distance
            around = scale.distances(around)
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
    return soft if hard < soft else 0, hard, half / _PER_PX

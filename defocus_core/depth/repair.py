"""Repair of a depth map before rendering: diagnosed once, done once, and recorded."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from defocus_core.allowed_values import DEPTH_REPAIRS, WIDEST_EDGE
from defocus_core.depth.diagnosis import DepthRepair, diagnosed
from defocus_core.depth.displacement import (
    EdgeShifts,
    least_step,
    measured_shifts,
    with_shifted_edges,
)
from defocus_core.depth.levels import coarse_shifts, with_coarse_shifts
from defocus_core.depth.matting import EDGE, SUBJECT
from defocus_core.depth.ramps import (
    AVERAGED,
    STEEP,
    around_ramps,
    slope_of_soft_edges,
    without_ramps,
    without_wide_ramps,
)
from defocus_core.depth.smoothing import AROUND, without_noise, without_terraces
from defocus_core.tensors.device_plan import repaired
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.neighbourhoods import range_of
from defocus_core.tensors.threads import own_modes
from defocus_core.tensors.ties import off_round
from defocus_core.tensors.validation import number, one_of

# With a given width of edges, a frame's range of radii holds this many of the smallest steps whose
# edges become steps.
_SMALL_STEPS = 3


def repair_depth(
    signed_radius: Tensor,
    image: Tensor,
    infinity: float | None = None,
    threads: int = 1,
    *,
    depth_repair: str = "auto",
    edge_width: float | None = None,
    decided: DepthRepair | None = None,
    matte: Tensor | None = None,
    reach: float = 0.0,
) -> tuple[Tensor, DepthRepair]:
    """The repaired signed radii by which `render` renders a picture, and the repair that was made.

    Noise is removed first, as it hides other faults; then edges are mended, then quantisation.

    Args:
        signed_radius: [H, W] px.
        image: [C, H, W], linear light; edges of depth are moved to its edges.
        infinity: As for `render`.
        threads: Number of bands of rows computed at once.
        depth_repair: As for `render`.
        edge_width: As for `render`.
        decided: The repair to make, if it is already known; None to find it.
        matte: As for `render`.
        reach: Px by which edges may be displaced, if that is more than a hundredth of the longer
            side of the picture.

    Returns:
        [H, W] px, the given radii themselves if they need no repair; and the repair.

    Raises:
        ValueError: If an option is out of its range.
    """
    check_repair(depth_repair, edge_width)
    if depth_repair == "off":
        return signed_radius, DepthRepair()
    with own_modes(signed_radius.device):
        if decided is None:
            radii, repair = _diagnosed(signed_radius, infinity, threads)
            repair = _as_said(repair, edge_width, radii)
        else:
            radii, repair = _muted(signed_radius, decided.noise, threads), decided
        if repair.wide_edges is not None and matte is None:
            radii = without_wide_ramps(radii, repair.wide_edges, repair.ramps_of)
        scale = repair.ramps_of
        for steep, width in _ramps(repair, edge_width):
            repair_window = partial(without_ramps, steep=steep, edge_width=width, scale=scale)
            radii = repaired(radii, repair_window, around_ramps(width), threads=threads)
        if matte is not None:
            radii = repaired(radii, with_matte, _AROUND_MATTE, matte, threads=threads)
        else:
            radii, shifts = _with_edges_of_colors(radii, image, repair, threads, decided, reach)
            repair = repair._replace(edge_shifts=shifts)
        if repair.quantised:
            radii = repaired(radii, without_terraces, AROUND, threads=threads)
        changed = 0 if radii is signed_radius else int((signed_radius != radii).sum())
        return radii, repair._replace(fraction=changed / radii.numel())


def _with_edges_of_colors(
    radii: Tensor,
    image: Tensor,
    repair: DepthRepair,
    threads: int,
    decided: DepthRepair | None,
    reach: float,
) -> tuple[Tensor, EdgeShifts | None]:
    """Radii [H, W] px with edges moved to those of the colours, and the displacements found.

    These are None if no edge is moved.
    """
    scale, soft, shifts = repair.ramps_of, repair.least_slope, repair.edge_shifts
    measure = partial(measured_shifts, pixels=image, threads=threads, soft=soft, scale=scale)
    if decided is None and soft is None:
        shifts = measure(radii)
    if shifts is None and (decided is not None or soft is None):
        return radii, None
    step = least_step(radii, soft) if shifts is None else shifts.step
    found = coarse_shifts(radii, image, step=step, scale=scale, reach=reach, threads=threads)
    radii = with_coarse_shifts(radii, found, step, scale)
    if decided is None and soft is not None:
        shifts = measure(radii)
    if shifts is None:
        return radii, None
    radii = with_shifted_edges(radii, image, shifts, scale, threads)
    if decided is None:
        median = shifts.median + sum(each.median for each in found)
        shifts = shifts._replace(median=median)
    return radii, shifts


def check_repair(depth_repair: str, edge_width: float | None) -> None:
    """Raise ValueError for options of `render` that are out of range or contradict each other."""
    one_of("depth_repair", depth_repair, DEPTH_REPAIRS)
    if edge_width is None:
        return
    width = number("edge_width", edge_width, "in px")
    if not 0 <= width <= WIDEST_EDGE:
        problem = f"edge_width must be 0 to {WIDEST_EDGE} px, got {width:g}"
        raise ValueError(f"{problem}; None leaves it to the diagnosis")
    if depth_repair == "off":
        problem = f"edge_width={width:g} contradicts depth_repair={depth_repair!r}"
        raise ValueError(f"{problem}; leave one of them out")


def _ramps(repair: DepthRepair, edge_width: float | None) -> Iterator[tuple[float, float | None]]:
    """Yield (least slope in px per px, greatest width in px) of each kind of ramp to replace.

    A width of None is unknown.
    """
    averaged = repair.antialiased
    if repair.soft_edges is not None:
        yield repair.soft_edges, AVERAGED if averaged else edge_width
    if repair.ramps and (repair.soft_edges is None or averaged):
        yield STEEP, edge_width


def _as_said(repair: DepthRepair, edge_width: float | None, radii: Tensor) -> DepthRepair:
    """The given repair with the width of soft edges set to `edge_width`, if the caller gave one.

    A width of 0 leaves edges as they are. `radii`: [H, W] px.
    """
    if edge_width is None:
        return repair
    if edge_width == 0:
        return repair._replace(soft_edges=None, wide_edges=None, ramps=False, edge_width=None)
    minimum, maximum = range_of(radii.detach()).tolist()
    slope = slope_of_soft_edges(minimum, maximum, radii.shape)
    slope = min(slope, (maximum - minimum) / (_SMALL_STEPS * edge_width))
    repair = repair._replace(antialiased=False, wide_edges=None)
    return repair._replace(soft_edges=slope, ramps=True, edge_width=edge_width)


def diagnose_depth(
    signed_radius: Tensor,
    infinity: float | None = None,
    threads: int = 1,
    *,
    depth_repair: str = "auto",
    edge_width: float | None = None,
) -> DepthRepair:
    """The repair that a depth map needs before it is rendered, judged without colours.

    Args:
        signed_radius: [H, W] px.
        infinity: As for `render`.
        threads: Number of bands of rows examined at once.
        depth_repair: As for `render`.
        edge_width: As for `render`.

    Raises:
        ValueError: If an option is out of its range.
    """
    check_repair(depth_repair, edge_width)
    if depth_repair == "off":
        return DepthRepair()
    with torch.no_grad():
        radii, repair = _diagnosed(signed_radius, infinity, threads)
        return _as_said(repair, edge_width, radii)


def _diagnosed(
    signed_radius: Tensor, infinity: float | None, threads: int
) -> tuple[Tensor, DepthRepair]:
    """Radii [H, W] px without noise, and the repair that they need, which includes the noise."""
    repair = diagnosed(signed_radius, infinity, threads)
    if repair.noise is None:
        return signed_radius, repair
    radii = _muted(signed_radius, repair.noise, threads)
    return radii, diagnosed(radii, infinity, threads, repair.noise)


def _muted(signed_radius: Tensor, noise: float | None, threads: int) -> Tensor:
    """Radii [H, W] px without noise of the given standard deviation in px; None for no noise."""
    if noise is None:
        return signed_radius
    muted = partial(without_noise, noise=noise)
    return repaired(signed_radius, muted, AROUND, threads=threads)


# Half width in px of the square in which the radii on both sides of a matte's silhouette are found.
_AROUND_MATTE = 8
# A subject counts as nearer even if it is this many px farther than the rest: on a slope both are
# equally near, and rounding would decide.
_NEARER = off_round(0.03)


def with_matte(signed_radius: Tensor, matte: Tensor) -> Tensor:
    """Radii [H, W] px whose edges lie at those of a matte [H, W], where its sides differ in depth.

    As soft depth near the silhouette lies between both sides, a pixel gets an extreme radius of its
    own side nearby: the least if it is the nearer one, else the greatest.
    """
    subject = matte >= SUBJECT
    of_subject, of_rest = (_ends_around(signed_radius, mask) for mask in (subject, ~subject))
    own = torch.where(subject, of_subject, of_rest)
    other = torch.where(subject, of_rest, of_subject)
    is_near = subject == (of_subject.sum(0) < of_rest.sum(0) + 2 * _NEARER)
    radius = torch.where(is_near, own[0], own[1])
    apart = radius - torch.where(is_near, other[1], other[0])
    known = torch.cat([own, other]).isfinite().all(0)
    return torch.where(known & (apart.abs() > EDGE), radius, signed_radius)


def _ends_around(signed_radius: Tensor, mask: Tensor) -> Tensor:
    """The least and greatest radius [2, H, W] px in the square around each pixel, within a mask.

    Both are infinite where the mask [H, W] has no pixel.
    """
    side, sign = 2 * _AROUND_MATTE + 1, signed_radius.new_tensor([-1.0, 1.0])[:, None, None]
    ends = torch.where(mask, sign * signed_radius, -torch.inf)[None]
    ends = torch.nn.functional.max_pool2d(ends, (side, 1), 1, (_AROUND_MATTE, 0))
    return sign * torch.nn.functional.max_pool2d(ends, (1, side), 1, (0, _AROUND_MATTE))[0]

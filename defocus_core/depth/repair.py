"""Repair of a depth map before rendering: diagnosed once, done once, and recorded."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from defocus_core.depth.diagnosis import DepthRepair, diagnosed, diagnosed_each
from defocus_core.depth.edge_shifts import AROUND as AROUND_SHIFTS
from defocus_core.depth.edge_shifts import (
    EdgeShifts,
    measured_shifts,
    measured_shifts_of_each,
    with_shifted_edges,
)
from defocus_core.depth.matte import AROUND as AROUND_MATTE
from defocus_core.depth.matte import with_matte
from defocus_core.depth.noise import AROUND as AROUND_NOISE
from defocus_core.depth.noise import without_noise
from defocus_core.depth.quantised import AROUND as AROUND_TERRACES
from defocus_core.depth.quantised import without_terraces
from defocus_core.depth.repair_options import RepairOptions, repair_options
from defocus_core.depth.soft_edges import (
    AVERAGED,
    STEEP,
    around_ramps,
    slope_of_soft_edges,
    without_ramps,
)
from defocus_core.tensors.derived import Repaired, fraction_changed, held
from defocus_core.tensors.neighbourhoods import range_of
from defocus_core.tensors.source import Pixels, banded
from defocus_core.tensors.torch_modes import own_modes

# Range of the radii of a frame, in the smallest steps whose edges are as wide as is said.
_SMALL_STEPS = 3
_BY_DIAGNOSIS = RepairOptions()


def repaired(
    signed_radius: Pixels,  # [H, W] px, as given
    pixels: Pixels,  # [C, H, W] linear; soft edges of depth are moved to their edges
    *,
    infinity: float | None,
    threads: int,
    hold: bool,
    options: RepairOptions = _BY_DIAGNOSIS,
    decided: DepthRepair | None = None,  # the repair, where it is known already; None to find it
    matte: Pixels | None = None,
) -> tuple[Pixels, DepthRepair]:
    """Signed radii as a renderer of scenes would write them, and the repair that was needed.

    Noise comes first, for it hides everything else; then edges, then quantisation.

    `infinity`: signed radius in px of what is infinitely far; None if that is not known; `matte`:
    [H, W], the coverage of a subject, whose edges are those of the depth. Returns [H, W] px, the
    given radii themselves if they need no repair; and the repair.
    """
    hold_all = partial(held, threads=threads, hold=hold)
    if decided is None:
        radii, repair = _diagnosed(signed_radius, infinity, threads, hold=hold)
        repair = _as_said(repair, options, radii)
    else:
        radii, repair = _muted(signed_radius, decided.noise, threads, hold=hold), decided
    soft, scale = repair.soft_edges, repair.ramps_of
    ramps = list[tuple[float, float | None]]()
    if repair.antialiased is not None and soft is not None:
        ramps.append((soft, AVERAGED))
    elif soft is not None:
        ramps.append((soft, options.edge_width))
    if repair.ramps and (soft is None or repair.antialiased is not None):
        ramps.append((STEEP, options.edge_width))
    for steep, width in ramps:
        repair_window = partial(without_ramps, steep=steep, edge_width=width, scale=scale)
        radii = hold_all(Repaired(radii, repair_window, around_ramps(width)), radii)
    shifts = repair.edge_shifts
    if matte is not None:
        radii = hold_all(Repaired(radii, with_matte, AROUND_MATTE, matte), radii, matte)
        shifts = None
    elif decided is None:
        shifts = measured_shifts(radii, pixels, threads, soft=soft, scale=scale)
    if shifts is not None:
        repair = repair._replace(edge_shifts=shifts)
        repair_window = partial(with_shifted_edges, shifts=shifts, scale=scale)
        radii = hold_all(Repaired(radii, repair_window, AROUND_SHIFTS, pixels), radii, pixels)
    if repair.quantised:
        radii = hold_all(Repaired(radii, without_terraces, AROUND_TERRACES), radii)
    return radii, repair._replace(fraction=fraction_changed(signed_radius, radii))


def repaired_each(
    signed_radius: Tensor, pixels: Tensor, infinity: Sequence[float | None]
) -> tuple[Tensor, list[DepthRepair]]:
    """What `repaired` makes of each picture of a batch, by diagnosis alone.

    `signed_radius`: [B, H, W] px; `pixels`: [C, B, H, W] linear. Returns [B, H, W] px, the given
    radii themselves if none needs a repair; and the repairs.
    """
    repairs = diagnosed_each(signed_radius, infinity)
    hard = [number for number, repair in enumerate(repairs) if repair == DepthRepair()]
    index = torch.tensor(hard, dtype=torch.long).to(signed_radius.device)
    shifts = dict[int, EdgeShifts | None]()
    if hard:
        whole = len(hard) == len(repairs)
        radii = signed_radius if whole else signed_radius.index_select(0, index)
        colors = pixels if whole else pixels.index_select(1, index)
        shifts = dict(zip(hard, measured_shifts_of_each(radii, colors), strict=True))
    pictures = list(signed_radius)
    for number in range(len(pictures)):
        found = shifts.get(number)
        if number in shifts and found is None:
            continue
        picture, repairs[number] = repaired(
            signed_radius[number],
            pixels[:, number],
            infinity=infinity[number],
            threads=1,
            hold=True,
            decided=None if found is None else DepthRepair(edge_shifts=found),
        )
        assert isinstance(picture, Tensor), "radii in memory are repaired in memory"
        pictures[number] = picture
    if all(number in shifts and shifts[number] is None for number in range(len(pictures))):
        return signed_radius, repairs
    return torch.stack(pictures), repairs


def _as_said(repair: DepthRepair, options: RepairOptions, radii: Pixels) -> DepthRepair:
    """The repair that was found, with soft edges as they are said to be."""
    if options.edge_width == 0:
        return repair._replace(soft_edges=None, ramps=False, edge_width=None)
    if options.soft_edges is None and options.edge_width is None:
        return repair
    slope, width = options.soft_edges, options.edge_width
    if slope is None:
        limits = torch.stack([range_of(band) for band in banded(radii)])
        minimum, maximum = float(limits[:, 0].amin()), float(limits[:, 1].amax())
        slope = slope_of_soft_edges(minimum, maximum, radii.shape)
        slope = min(slope, (maximum - minimum) / (_SMALL_STEPS * width)) if width else slope
    width = repair.edge_width if width is None else width
    return repair._replace(antialiased=None, soft_edges=slope, ramps=True, edge_width=width)


def diagnose_depth(
    signed_radius: Pixels,
    infinity: float | None = None,
    threads: int = 1,
    *,
    depth_repair: str = "auto",
    edge_width: float | None = None,
) -> DepthRepair:
    """The repair that a depth map needs before it is rendered, as far as it shows without colours.

    Args:
        signed_radius: [H, W] px.
        infinity: As for `render`.
        threads: Number of bands of rows examined at once.
        depth_repair: As for `render`.
        edge_width: As for `render`.

    Raises:
        ValueError: If an option is out of its range.
    """
    options = repair_options(depth_repair, edge_width)
    if not options.on:
        return DepthRepair()
    hold = isinstance(signed_radius, Tensor)
    with torch.no_grad():
        radii, repair = _diagnosed(signed_radius, infinity, threads, hold=hold)
        return _as_said(repair, options, radii)


def repair_depth(
    signed_radius: Pixels,
    image: Pixels,
    infinity: float | None = None,
    threads: int = 1,
    *,
    depth_repair: str = "auto",
    edge_width: float | None = None,
    decided: DepthRepair | None = None,
    hold: bool = False,
    matte: Pixels | None = None,
) -> tuple[Pixels, DepthRepair]:
    """The signed radii by which `render` renders a picture, and the repair that made them.

    Args:
        signed_radius: [H, W] px.
        image: [C, H, W], linear light.
        infinity: As for `render`.
        threads: Number of bands of rows computed at once.
        depth_repair: As for `render`.
        edge_width: As for `render`.
        decided: The repair, where it is known already; None to find it.
        hold: Whether there is room for the repaired radii if the given ones are no tensor; without
            room those of a large picture are computed anew for each window.
        matte: As for `render`.

    Returns:
        [H, W] px, the given radii themselves if they need no repair; and the repair.

    Raises:
        ValueError: If an option is out of its range.
    """
    options = repair_options(depth_repair, edge_width)
    if not options.on:
        return signed_radius, DepthRepair()
    with own_modes(signed_radius.device):
        return repaired(
            signed_radius,
            image,
            infinity=infinity,
            threads=threads,
            hold=hold or isinstance(signed_radius, Tensor),
            options=options,
            decided=decided,
            matte=matte,
        )


def _diagnosed(
    signed_radius: Pixels, infinity: float | None, threads: int, *, hold: bool
) -> tuple[Pixels, DepthRepair]:
    """Radii [H, W] px without noise, and the repair that given and noise-free radii need."""
    repair = diagnosed(signed_radius, infinity, threads)
    if repair.noise is None:
        return signed_radius, repair
    radii = _muted(signed_radius, repair.noise, threads, hold=hold)
    return radii, diagnosed(radii, infinity, threads, repair.noise)


def _muted(signed_radius: Pixels, noise: float | None, threads: int, *, hold: bool) -> Pixels:
    """Radii [H, W] px without noise of a standard deviation in px."""
    if noise is None:
        return signed_radius
    quiet = Repaired(signed_radius, partial(without_noise, noise=noise), AROUND_NOISE)
    return held(quiet, signed_radius, threads=threads, hold=hold)

"""One repair of depth for all frames of a shot, as decisions for single frames could flicker.

Radii of one scene through two lenses differ by a factor and a shift, as both are affine in
disparity. So thresholds in px of radius are multiplied by this factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.ramps import MINIMUM, STEEP


def agreed_repair(repairs: Sequence[DepthRepair]) -> DepthRepair:
    """The repair that most frames of one lens need, with the median of each value."""
    names, defaults = DepthRepair._fields, DepthRepair._field_defaults
    of_each = ([getattr(repair, name) for repair in repairs] for name in names)
    agreed = map(_median, of_each, map(defaults.get, names))
    return DepthRepair(*agreed)._replace(fraction=0.0)


def _median(values: Sequence[Any], otherwise: Any) -> Any:
    """The lower median of the values if most frames have one."""
    there = sorted(value for value in values if value is not None and value is not False)
    return there[(len(there) - 1) // 2] if 2 * len(there) > len(values) else otherwise


def repair_through(repair: DepthRepair, factor: float, infinity: float | None) -> DepthRepair:
    """The repair of a frame for another lens.

    `factor`: radii through that lens as multiples of those through the lens of the frame;
    `infinity`: signed radius in px at infinity; None if that is not known.
    """
    shifts, ramps_of = repair.edge_shifts, repair.ramps_of
    if ramps_of is not None and infinity is not None:
        ramps_of = ramps_of.rescaled(factor, infinity)
    return repair._replace(
        noise=None if repair.noise is None else repair.noise * factor,
        soft_edges=_slope_through(repair.soft_edges, factor),
        wide_edges=_slope_through(repair.wide_edges, factor),
        edge_shifts=None if shifts is None else shifts._replace(step=shifts.step * factor),
        ramps_of=ramps_of,
    )


def _slope_through(slope: float | None, factor: float) -> float | None:
    """The least slope of soft edges for the frame of another lens."""
    return None if slope is None else min(STEEP, max(MINIMUM, slope * factor))

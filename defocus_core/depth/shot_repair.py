"""One repair of depth for all frames of a shot, as separate decisions could flicker.

Radii of one scene through two lenses differ by a factor and an offset, as both are affine in
disparity. So thresholds in px of radius are multiplied by this factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.ramps import MINIMUM, STEEP


def agreed_repair(repairs: Sequence[DepthRepair]) -> DepthRepair:
    """One repair for all frames through a lens.

    Each field is set if most frames set it, to the median of their values.
    """
    names, defaults = DepthRepair._fields, DepthRepair._field_defaults
    of_each = ([getattr(repair, name) for repair in repairs] for name in names)
    agreed = map(_median, of_each, map(defaults.get, names))
    return DepthRepair(*agreed)._replace(fraction=0.0)


def _median(values: Sequence[Any], otherwise: Any) -> Any:
    """The lower median of values without None and False; `otherwise` unless most remain."""
    there = sorted(value for value in values if value is not None and value is not False)
    return there[(len(there) - 1) // 2] if 2 * len(there) > len(values) else otherwise


def repair_through(repair: DepthRepair, factor: float, infinity: float | None) -> DepthRepair:
    """The repair found for a frame through one lens, converted to another lens.

    `factor`: ratio of differences of radii through the other lens to those through the first;
    `infinity`: signed radius in px at infinity through the other lens; None if that is not known.
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
    return None if slope is None else min(STEEP, max(MINIMUM, slope * factor))

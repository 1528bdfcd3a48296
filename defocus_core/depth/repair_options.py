"""Options of depth repair: what a user knows of the edges of a depth map."""

from __future__ import annotations

import math
from dataclasses import dataclass

from defocus_core.allowed_values import DEPTH_REPAIRS, WIDEST_EDGE
from defocus_core.tensors.validation import described, number

# A choice of depth repair that is no word begins so and ends with a slope of soft edges.
SOFT_EDGES = "soft-edges="


@dataclass(frozen=True)
class RepairOptions:
    """What is known of a depth map before its repair."""

    on: bool = True  # whether it is repaired at all
    # Least slope of soft edges in px of radius per px; None leaves it to the diagnosis whether
    # edges are soft
    soft_edges: float | None = None
    # Width of the widest soft edges in px, 0 if none are soft; None leaves it to the diagnosis
    edge_width: float | None = None


def repair_options(depth_repair: str, edge_width: float | None = None) -> RepairOptions:
    """The options of `depth_repair` and `edge_width`, as `render` explains both."""
    slope = _slope(depth_repair)
    if edge_width is None:
        return RepairOptions(depth_repair != "off", slope)
    width = number("edge_width", edge_width, "in px")
    if not 0 <= width <= WIDEST_EDGE:
        problem = f"edge_width must be 0 to {WIDEST_EDGE} px, got {width:g}"
        raise ValueError(f"{problem}; None leaves it to the diagnosis")
    if depth_repair == "off" or (slope is not None and width == 0):
        problem = f"edge_width={width:g} contradicts depth_repair={depth_repair!r}"
        raise ValueError(f"{problem}; leave one of them out")
    return RepairOptions(True, slope, width)


def _slope(depth_repair: str) -> float | None:
    """The slope of ``soft-edges=SLOPE``; None for a word."""
    if isinstance(depth_repair, str):
        if depth_repair in DEPTH_REPAIRS:
            return None
        if depth_repair.startswith(SOFT_EDGES):
            try:
                slope = float(depth_repair.removeprefix(SOFT_EDGES))
            except ValueError:
                slope = math.nan
            if 0 <= slope < math.inf:
                return slope
    wanted = f"{', '.join(DEPTH_REPAIRS)} or {SOFT_EDGES}SLOPE"
    raise ValueError(
        f"depth_repair must be {wanted}, got {described(depth_repair)}; "
        "SLOPE is a number of px of radius per px, from 0"
    )

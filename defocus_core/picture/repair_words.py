"""The repair of a depth map as it is reported: in words, in JSON and journals, in EXR headers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from defocus_core.system.text import percent

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair


def repair_words(repair: DepthRepair | None) -> str:
    """How the depth was repaired before it was rendered; empty if it was not."""
    if repair is None:
        return ""
    done = []
    if repair.noise is not None:
        done.append(f"noisy by {repair.noise:.2g} px of radius, smoothed within surfaces")
    done += _edge_words(repair)
    if repair.quantised:
        done.append("of few levels, smoothed between them")
    if done and repair.fraction:
        done.append(f"{percent(repair.fraction)} of the pixels changed")
    return "; ".join(done)


def _edge_words(repair: DepthRepair) -> list[str]:
    """What was found at edges, in one phrase."""
    found = []
    if repair.antialiased is not None:
        found.append(f"averaged in {'disparity' if math.isinf(repair.antialiased) else 'distance'}")
    elif repair.least_slope is not None:
        of = "" if repair.ramps_of is None else " in distance"
        over = "" if repair.edge_width is None else f" over {repair.edge_width:.3g} px"
        found.append(f"soft{of}{over}")
    if repair.edge_shifts is not None:
        shift = round(repair.edge_shifts.median, 1)
        found.append(
            f"{abs(shift)} px too {'far out' if shift > 0 else 'far in'}" if shift else "uneven"
        )
    return [f"edges {' and '.join(found)}, made hard where the colours change"] if found else []


def repair_record(repair: DepthRepair | None) -> dict[str, Any] | None:
    """The repair in plain values; None where nothing was looked for.

    Its keys are ``kinds``, of noise, anti-aliased, soft-edges, ramps, displaced-edges and
    few-levels; ``noise_px``, of radius; ``edge_width_px`` of soft edges; ``displaced_px`` of edges
    in the median, positive outwards; ``share`` of the pixels that were changed.
    """
    if repair is None:
        return None
    kinds = {
        "noise": repair.noise is not None,
        "anti-aliased": repair.antialiased is not None,
        "soft-edges": repair.least_slope is not None and repair.antialiased is None,
        "ramps": repair.ramps and repair.least_slope is None,
        "displaced-edges": repair.edge_shifts is not None,
        "few-levels": repair.quantised,
    }
    shift = None if repair.edge_shifts is None else repair.edge_shifts.median
    return {
        "kinds": [kind for kind, is_there in kinds.items() if is_there],
        "noise_px": _round(repair.noise),
        "edge_width_px": _round(repair.edge_width),
        "displaced_px": _round(shift),
        "share": _round(repair.fraction),
    }


def repair_attribute(repair: DepthRepair | None) -> str:
    """The record in one line, for an EXR header; empty if nothing was changed."""
    values = repair_record(repair)
    if values is None or not values["kinds"]:
        return ""
    numbers = (f"{name}={value:g}" for name, value in values.items() if isinstance(value, float))
    return " ".join((",".join(values["kinds"]), *numbers))


def _round(value: float | None) -> float | None:
    """Four significant digits."""
    return None if value is None else float(f"{value:.4g}")

"""The declarations on one depth file: of its format, the user, the file and its sidecar.

Options that contradict or mean nothing are refused; a missing one is asked for by its name.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from defocus_core.errors import UsageProblem
from defocus_core.io.depth_formats.depth_numbers import DepthNumbers
from defocus_core.io.depth_formats.reading import DepthReading
from defocus_core.io.depth_formats.rules import DepthFormat
from defocus_core.io.depth_formats.sidecars import Facts


@dataclass(frozen=True)
class Declared:
    """A depth file and the declarations on it."""

    path: Path
    reading: DepthReading  # the options of the user
    row: DepthFormat
    samples: DepthNumbers  # its numbers and its metadata
    facts: Facts | None  # the facts of its sidecar; None if there is none

    @property
    def rule(self) -> str:
        """scale, inverse, log or radius; empty where the user must say it."""
        return self.facts.rule if self.facts is not None and self.facts.rule else self.row.rule

    @property
    def asked_by(self) -> dict[str, str]:
        """The option that asks for the format, and its value: what errors are about."""
        name = self.reading.depth_format
        if name is None:
            return {"field": "depth-kind", "value": "disparity"}
        return {"field": "depth-format", "value": name}


def refuse_idle(declared: Declared, rule: str) -> None:
    """Refuse options that would mean nothing for the rule, or contradict the format."""
    reading, row = declared.reading, declared.row
    disparity, radial = rule == "inverse", geometry_of(declared) == "radial"
    in_px = disparity and not row.per_metre  # disparity of two cameras
    has_range = row.name in ("metres", "disparity") or "depth-range" in row.needs or not row.rule
    has_unit = row.unitless and (not disparity or row.per_metre)
    has_scale = rule in ("scale", "inverse") and (
        declared.facts is None or not declared.facts.scale
    )
    means_nothing = {
        "depth-unit": reading.depth_unit is not None and not has_unit,
        "depth-range": reading.depth_range is not None and not has_range,
        "depth-scale": reading.depth_scale is not None and not has_scale,
        "baseline": reading.baseline is not None and not in_px,
        "doffs": reading.doffs is not None and not in_px,
        "focal-px": reading.focal_px is not None and not (in_px or radial),
        "fov": reading.fov is not None and not radial,
        "radial": reading.geometry == "radial" and disparity,
    }
    for option in (option for option, idle in means_nothing.items() if idle):
        kind = "disparity" if disparity else row.name
        if reading.depth_format is None and not disparity:
            kind = "planar depth"
        raise UsageProblem("idle-option", f"means nothing for {kind}", "leave it out", field=option)
    if reading.depth_range is None:
        return
    for option in ("depth_unit", "depth_scale", "baseline", "doffs"):
        if getattr(reading, option) is not None:
            name = option.replace("_", "-")
            problem = "stands beside ‹depth-range›"
            raise UsageProblem("contradiction", problem, "give one of them", field=name)


def ask(declared: Declared, option: str, value: str) -> NoReturn:
    """Ask for an option that the format cannot do without."""
    note = declared.row.note
    problem = f"leaves ‹{option}› open" + (f": {note}" if note else "")
    raise UsageProblem("missing-option", problem, f"add ‹{option}› {value}", **declared.asked_by)


def geometry_of(declared: Declared) -> str:
    """Planar, radial, or ask: by the user, the file, the channel or the format, in this order."""
    reading, row, facts = declared.reading, declared.row, declared.facts
    if reading.geometry is not None:
        return reading.geometry
    if facts is not None and facts.radial:
        return "radial"
    return "radial" if declared.samples.channel in row.radial_channels else row.geometry


def focal_of(declared: Declared, picture_width: int, lens_focal: float | None) -> float | None:
    """Focal length in px of the depth map where it holds distances to the point, else None."""
    reading, row, width = declared.reading, declared.row, declared.samples.width
    geometry = geometry_of(declared)
    if geometry == "ask":
        problem = "leaves open whether the numbers are depth or the distance to the point"
        problem += f" ({row.note})" if row.note else ""
        remedy = "add ‹planar› or ‹radial›"
        raise UsageProblem("missing-option", problem, remedy, **declared.asked_by)
    if geometry == "planar":
        return None
    if reading.fov is not None and reading.focal_px is not None:
        remedy = "give one of them"
        raise UsageProblem("contradiction", "stands beside ‹focal-px›", remedy, field="fov")
    if reading.focal_px is not None:
        return reading.focal_px * width / picture_width  # it is that of the colour
    if reading.fov is not None:
        return width / 2 / math.tan(math.radians(reading.fov) / 2)
    if row.focal_px is not None:
        return row.focal_px if row.focal_width is None else row.focal_px * width / row.focal_width
    if lens_focal is not None:
        return lens_focal * width
    by = {"field": "radial"} if reading.geometry else declared.asked_by
    problem = "is the distance to the point, and nothing says the field of view"
    raise UsageProblem("missing-option", problem, "add ‹fov› 60deg or ‹focal-px› PX", **by)

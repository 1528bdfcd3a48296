"""Rules by which numbers become depth: the options that each takes, and its formula.

A format (a row of the table) names a rule; a sidecar and the user's options complete the format.
From numbers v come:
  scale      depth  scale · v + shift
  inverse    depth  1 / (scale · v + shift), v a disparity in px of two cameras
  per-metre  depth  1 / (scale · v + shift), v a disparity in 1 / m
  radius     signed CoC radius in px, v itself
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.depth_formats.reading import DepthNumbers, DepthReading
from defocus_core.io.depth_formats.table import FORMATS, UNIT_WORDS, UNITS, DepthFormat
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan

HALF_MAX = 65504.0  # the largest number that half can hold
MM_PER_M = 1000.0
_FEW_LEVELS = 255.0  # greatest number of a type too small to reserve a number for holes
_APART = 0.753  # if the greatest number marks holes, all others are below this share of it
# Options that say how numbers become depth, in the order in which they are refused.
_OPTIONS = ("depth-unit", "depth-range", "depth-scale", "baseline", "doffs", "focal-px", "fov")
_FLOATS = (1e-30, 1e30)  # allowed range of focal length times baseline, well within float32
_CALIBRATION = {"focal-px": "‹focal-px› PX", "baseline": "‹baseline› 65mm"}


class DepthRule(NamedTuple):
    """A formula that turns numbers into depth, and the options that it uses."""

    holds: str  # what the numbers are: depth, disparity or radii
    options: tuple[str, ...]  # options that the rule uses, besides those that the row takes
    # Returns the row with its scale, shift and words set by the user's options
    complete: Callable[[DepthReading, DepthFormat, DepthNumbers], DepthFormat]


def resolved(
    reading: DepthReading, samples: DepthNumbers, lens_focal: float | None = None
) -> DepthFormat:
    """The format of a file, completed by its sidecar, the user's options and the lens.

    `lens_focal`: focal length of the lens in widths of its sensor.
    """
    if reading.relative:
        near = "black" if reading.invert else "white"
        return replace(FORMATS["coc"], words=f"relative disparity, {near} near")
    row = reading.row
    if row.sidecar:
        from defocus_core.io.depth_formats.sidecars import with_sidecar

        row = with_sidecar(row, samples)
    row = _ruled(reading, row)
    radial = samples.channel in row.radial_channels
    row = replace(row, geometry=reading.geometry or ("radial" if radial else row.geometry))
    _refuse_idle(reading, row)
    if reading.depth_range is not None:
        row = _by_range(reading, row, samples)
    elif row.ends is not None:
        scale, shift = linear(*row.ends, samples.top)
        row = replace(row, scale=scale, shift=shift, words=f"{row.name}, {row.words}")
    else:
        row = RULES[row.rule].complete(reading, row, samples)
    sky = reading.sky
    if sky is None and RULES[row.rule].holds == "disparity":
        sky = -math.inf if row.scale >= 0 else math.inf
    elif sky is None:  # this number and those beyond it at the far end
        sky = min(row.sky, HALF_MAX) if samples.is_half else row.sky
        sky = -sky if row.scale < 0 else sky
    row = replace(row, sky=sky)
    if reading.invalid_value is not None:
        row = replace(row, invalid=(*row.invalid, reading.invalid_value))
    focal = None if row.rule == "radius" else _focal(reading, row, samples, lens_focal)
    if focal is None:
        return replace(row, geometry="planar")
    words = f"{row.words}, radial with {_focal_words(focal, samples.width)}"
    return replace(row, focal_px=focal, words=words)


def _ruled(reading: DepthReading, row: DepthFormat) -> DepthFormat:
    """The format `row` with its rule, or if it has none, with that of the ``depth_kind``."""
    kind = reading.depth_kind
    if not row.rule:
        if kind is None:
            _ask(reading, row, "depth-kind", "depth or disparity")
        if kind == "depth":
            return replace(row, rule="scale")
        return replace(row, rule="inverse", needs=("depth-range",))  # of a network, without scale
    holds = RULES[row.rule].holds
    if kind not in (None, holds):
        what = row.title if holds == "radii" else holds
        problem = f"contradicts ‹depth-format› {row.name}, which is {what}"
        raise UsageProblem("contradiction", problem, "leave one of them out", field="depth-kind")
    if reading.depth_range is not None and reading.depth_format is None and kind is None:
        problem = "does not say whether the numbers are depth or disparity"
        remedy = "add ‹depth-kind› disparity, or depth"
        raise UsageProblem("missing-option", problem, remedy, field="depth-range")
    return row


def _refuse_idle(reading: DepthReading, row: DepthFormat) -> None:
    rule = RULES[row.rule]
    takes = {*row.takes, *row.needs, *(() if row.ends else rule.options)}
    takes |= {"focal-px", "fov"} if row.geometry == "radial" else set()
    said = [each for each in _OPTIONS if getattr(reading, each.replace("-", "_")) is not None]
    idle = [each for each in said if each not in takes]
    idle += ["radial"] * (reading.geometry == "radial" and rule.holds != "depth")
    if idle:
        what = rule.holds if rule.holds == "disparity" else row.name
        if reading.depth_format is None and rule.holds == "depth":
            what = "planar depth"
        raise UsageProblem("idle-option", f"has no effect on {what}", "leave it out", field=idle[0])
    other = set(said) & {"depth-unit", "depth-scale", "baseline", "doffs"}
    if reading.depth_range is not None and other:
        problem, field = "contradicts ‹depth-range›", min(other, key=said.index)
        raise UsageProblem("contradiction", problem, "give one of them", field=field)


def _ask(reading: DepthReading, row: DepthFormat, option: str, value: str) -> NoReturn:
    """Raise the UsageProblem for a missing option that the format needs; `value` is an example."""
    problem = f"needs ‹{option}›" + (f": {row.note}" if row.note else "")
    raise UsageProblem("missing-option", problem, f"add ‹{option}› {value}", **reading.asked_by)


def _by_range(reading: DepthReading, row: DepthFormat, samples: DepthNumbers) -> DepthFormat:
    """The format `row` with the scale and the shift that follow from the ``depth_range``."""
    assert reading.depth_range is not None
    near, far = (end / MM_PER_M for end in reading.depth_range)
    if near == far:
        problem = "has the same distance twice"
        raise UsageProblem("out-of-range", problem, "give two distances", field="depth-range")
    holds = RULES[row.rule].holds
    if (math.inf if holds == "depth" else 0.0) in (near, far):
        which = "inf, but depth" if holds == "depth" else "0, but 1/z"
        problem = f"has the end {which} is linear between finite ends"
        raise UsageProblem("out-of-range", problem, "give another distance", field="depth-range")
    ends = shown = near, far
    if holds != "depth":
        ends, shown = (1 / far, 1 / near), (far, near)
    top, which = samples.top, ""
    if not samples.is_integer:
        top, which = _top_of_floats(row, samples)
    scale, shift = linear(*ends, top)
    words = f"{holds}, 0 is {shown[0]:.6g} m and {top:.6g}{which} is {shown[1]:.6g} m"
    return replace(row, scale=scale, shift=shift, words=words)


def _top_of_floats(row: DepthFormat, samples: DepthNumbers) -> tuple[float, str]:
    """The upper end of the range of floats that `depth_range` describes, and a note in words.

    It is 1, or the maximum of the file for a network's disparity that exceeds 1.
    """
    finite = samples.values[np.isfinite(samples.values)]
    minimum, maximum = float(finite.min(initial=np.inf)), float(finite.max(initial=-np.inf))
    is_of_network = "depth-range" in row.needs and row.rule == "inverse"
    if is_of_network and minimum >= 0 and maximum > 1 + 1e-3:
        return maximum, ", the greatest of the file,"
    if minimum < -1e-3 or maximum > 1 + 1e-3:
        problem = f"has floats from {minimum:.4g} to {maximum:.4g}, and ‹depth-range› takes 0 to 1"
        remedy = "give ‹depth-scale› and ‹doffs› instead"
        raise InputError("out-of-range", problem, remedy, path=samples.path)
    return 1.0, ""


def _by_unit(reading: DepthReading, row: DepthFormat, samples: DepthNumbers) -> DepthFormat:
    """The format `row` of depth, its scale multiplied by ``depth_unit`` and ``depth_scale``."""
    if "depth-range" in row.needs:
        _ask(reading, row, "depth-range", "NEAR FAR, like 1m 20m")
    if "depth-scale" in row.needs and reading.depth_scale is None:
        _ask(reading, row, "depth-scale", "METRES")
    unit = reading.depth_unit
    if reading.depth_format is None and unit is None:
        unit = "mm" if samples.type == "16-bit PNG" else "m"
        if reading.depth_scale is None and samples.is_integer and unit == "m":
            numbers = f"holds {samples.values.dtype} numbers"
            if samples.channel:
                numbers = f"has {samples.channel} in whole numbers"
            remedy = "‹depth-format› apple-heic" if samples.type == "HEIC" else "‹depth-unit› mm"
            problem = f"{numbers}, whose unit is unknown"
            raise InputError("unknown-unit", problem, f"give {remedy}", path=samples.path)
    scale = row.scale * UNITS[unit or "m"]
    words = [UNIT_WORDS[unit] if unit else ""]
    if reading.depth_scale is not None:
        scale *= reading.depth_scale
        words.append(f"× {reading.depth_scale:g}: 1 is {scale:.6g} m")
    if reading.depth_format is not None:
        words = [row.name, row.words, *words]
    return replace(row, scale=scale, words=", ".join(filter(None, words)))


def _by_cameras(reading: DepthReading, row: DepthFormat, samples: DepthNumbers) -> DepthFormat:
    """The format `row`, which holds disparity in px, with the scale and the shift of its cameras.

    Without cameras, they are ``depth_scale`` and ``doffs``.
    """
    scale = row.scale * (1.0 if reading.depth_scale is None else reading.depth_scale)
    if "depth-range" in row.needs and reading.depth_scale is None:
        remedy = "NEAR FAR, like 1m 20m; or ‹depth-scale› and ‹doffs›, as 1/z = scale v + doffs"
        _ask(reading, row, "depth-range", remedy)
    focal = row.focal_px if reading.focal_px is None else reading.focal_px
    baseline = row.baseline if reading.baseline is None else reading.baseline / MM_PER_M
    doffs = row.shift if reading.doffs is None else reading.doffs
    if focal is not None and baseline is not None:
        across = _focal_words(focal, samples.width).partition("px, ")[2]
        source = f" by {row.words}" if row.words else ""
        words = f"{row.name}, {focal:.6g} px ({across}) × {baseline:.6g} m{source}"
        if not _FLOATS[0] <= focal * baseline <= _FLOATS[1]:
            problem = f"makes with {focal:.3g} px of focal length depths beyond all floats"
            raise UsageProblem("out-of-range", problem, "check both", field="baseline")
        scale, doffs = scale / (focal * baseline), doffs / (focal * baseline)
        return replace(row, scale=scale, shift=doffs, words=words)
    if focal is None and baseline is None and reading.depth_scale is not None:
        words = f"disparity, 1/z = {scale:g} v{f' + {doffs:g}' if doffs else ''}"
        return replace(row, scale=scale, shift=doffs, words=words)
    missing = [n for n, value in zip(_CALIBRATION, (focal, baseline), strict=True) if value is None]
    names = " and ".join(f"‹{name}›" for name in missing)
    why = f": there is no {row.sidecar} beside {samples.path}" if row.sidecar else ""
    remedy = f"add {' and '.join(_CALIBRATION[name] for name in missing)}"
    if row.name == "disparity":
        remedy += ", or ‹depth-range› NEAR FAR, or ‹depth-scale›"
    raise UsageProblem("missing-option", f"needs {names}{why}", remedy, **reading.asked_by)


def _per_metre(reading: DepthReading, row: DepthFormat, _: DepthNumbers) -> DepthFormat:
    scale = row.scale * (1.0 if reading.depth_scale is None else reading.depth_scale)
    return replace(row, scale=scale / UNITS[reading.depth_unit or "m"], words=f"{row.name}, 1 / z")


def _focal(
    reading: DepthReading, row: DepthFormat, samples: DepthNumbers, lens_focal: float | None
) -> float | None:
    """Focal length in px, if the depth map holds distances to the point; None if it is planar."""
    if row.geometry == "ask":
        problem = (
            "does not tell whether the numbers are depth along the axis or distances to the point"
        )
        problem += f" ({row.note})" if row.note else ""
        remedy = "add ‹planar› or ‹radial›"
        raise UsageProblem("missing-option", problem, remedy, **reading.asked_by)
    if row.geometry == "planar":
        return None
    if reading.fov is not None and reading.focal_px is not None:
        remedy = "give one of them"
        raise UsageProblem("contradiction", "contradicts ‹focal-px›", remedy, field="fov")
    if reading.focal_px is not None:
        return reading.focal_px
    if reading.fov is not None:
        return samples.width / 2 / math.tan(math.radians(reading.fov) / 2)
    if row.focal_px is not None:
        return row.focal_px * (samples.width / row.focal_width if row.focal_width else 1.0)
    if lens_focal is not None:
        return lens_focal * samples.width
    by = {"field": "radial"} if reading.geometry else reading.asked_by
    problem = "holds distances to the point, and the field of view is unknown"
    raise UsageProblem("missing-option", problem, "add ‹fov› 60deg or ‹focal-px› PX", **by)


def _focal_words(focal: float, width: int) -> str:
    degrees = 2 * math.degrees(math.atan(width / 2 / focal))
    return f"a focal length of {focal:.6g} px, {degrees:.3g}° across"


def linear(at_zero: float, at_top: float, top: float) -> tuple[float, float]:
    """The (scale, shift) of the linear function that maps 0 to `at_zero` and `top` to `at_top`."""
    return (at_top - at_zero) / top, at_zero


RULES = {
    "scale": DepthRule("depth", ("depth-scale",), _by_unit),
    "inverse": DepthRule(
        "disparity", ("depth-scale", "baseline", "doffs", "focal-px"), _by_cameras
    ),
    "per-metre": DepthRule("disparity", ("depth-scale",), _per_metre),
    "radius": DepthRule(
        "radii", (), lambda _, row, __: replace(row, words="signed CoC radius in px")
    ),
}


def decoded(
    numbers: NDArray[Any], row: DepthFormat, overscan: Overscan = NO_OVERSCAN
) -> NDArray[np.float32]:
    """Planar metres [H, W] of numbers by the format `row`, which options have completed.

    +inf is sky; NaN, 0 and less are invalid. A format of radii gives signed radii in px instead.
    """
    is_disparity = RULES[row.rule].holds == "disparity"
    with np.errstate(over="ignore", divide="ignore"):  # a double beyond float32 is sky
        if is_disparity or (row.scale, row.shift) != (1, 0):
            scaled = numbers.astype(np.float64) * row.scale + row.shift
            if is_disparity:  # a negative one, of no point in front of the cameras, is invalid
                scaled = np.where(scaled < 0, np.nan, 1 / np.abs(scaled))
            metres = scaled.astype(np.float32)
        else:
            metres = numbers.astype(np.float32, copy=False)
    if row.geometry == "radial":
        assert row.focal_px is not None
        cosine = _cosine(metres.shape, row.focal_px, overscan.shown(*metres.shape[:2]))
        metres = (metres.astype(np.float64) * cosine).astype(np.float32)
    invalid = np.isin(numbers, row.invalid) if row.invalid else np.False_
    for pixels, value in ((is_sky(numbers, row), np.inf), (invalid, np.nan)):
        if pixels.any():
            metres = np.where(pixels, np.float32(value), metres)
    return metres


def is_sky(numbers: NDArray[Any], row: DepthFormat) -> NDArray[np.bool_]:
    """The mask of numbers that stand for sky; all False for radii."""
    holds = RULES[row.rule].holds
    if holds == "radii":
        return np.zeros(numbers.shape, bool)
    falls = (row.scale < 0) != (holds == "disparity")  # numbers fall with distance
    with np.errstate(over="ignore"):
        values, end = numbers.astype(np.float32, copy=False), np.float32(row.sky)
    sky: NDArray[np.bool_] = values <= end if falls else values >= end
    return sky | np.isin(numbers, row.sky_numbers) if row.sky_numbers else sky


def ends_in_hole(reading: DepthReading, row: DepthFormat, samples: DepthNumbers) -> bool:
    """Whether the greatest number of the type marks holes.

    This is so if no option or format explains that number, and all others lie far below it.
    """
    top, values = samples.top, samples.values
    said = reading.sky is not None or reading.depth_range is not None or row.ends is not None
    if said or top <= _FEW_LEVELS or row.rule != "scale" or row.bits or row.weights:
        return False
    if not samples.is_integer or row.sky <= top or top in (*row.invalid, *row.sky_numbers):
        return False
    others = values[values != top]
    return others.size < values.size and int(others.max(initial=0)) < _APART * top


def _cosine(
    shape: tuple[int, ...], focal_px: float, shown: tuple[slice, slice]
) -> NDArray[np.float64]:
    """The ratio [H, W] of depth along the axis to distance to the point, f / √(x² + y² + f²).

    x and y are positions of pixel centres in px from the middle of the rows and columns `shown`, f
    is `focal_px`.
    """
    y, x = (
        np.arange(count) - side.start - (side.stop - side.start - 1) / 2
        for count, side in zip(shape, shown, strict=True)
    )
    cosine: NDArray[np.float64] = focal_px / np.sqrt(x**2 + y[:, None] ** 2 + focal_px**2)
    return cosine

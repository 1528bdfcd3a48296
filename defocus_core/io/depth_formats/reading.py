"""How a depth file is to be read: what a user may say of it, which completes its format."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn, Self

import numpy as np

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.arrays import bands
from defocus_core.io.depth_formats.rules import (
    HALF_MAX,
    DepthFormat,
    DepthNumbers,
    linear,
)
from defocus_core.io.depth_formats.table import FORMATS, NAMES, UNIT_WORDS, UNITS
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.safe_files import is_heic, is_jpeg, read_head

KINDS = ("depth", "disparity")
INVALID = ("error", "far", "fill")
RESIZES = ("nearest", "guided")
UNPREMULTIPLY = ("auto", "on", "off")
ALICEVISION = "AliceVision:"  # begins the names of attributes
_XMP_BYTES = 1 << 17  # of a JPEG, which begins with it


def holds_gdepth(path: Path) -> bool:
    """Whether a file is a JPEG whose XMP has GDepth."""
    head = read_head(path, _XMP_BYTES)
    return is_jpeg(head) and b"GDepth:" in head


def holds_depth(path: Path) -> bool:
    """Whether a file is a photograph of a kind that has depth inside it."""
    return is_heic(read_head(path)) or holds_gdepth(path)


def own_format(path: Path) -> str:
    """The format that a file itself names: of a photograph, or in a header; else empty."""
    if holds_gdepth(path):
        return "android-gdepth"
    if is_exr(read_head(path)):
        names = (name for header in read_headers(path) for name in header.attributes)
        return "alicevision" if any(name.startswith(ALICEVISION) for name in names) else ""
    return "apple-heic" if is_heic(read_head(path)) else ""


@dataclass(frozen=True, kw_only=True)
class DepthReading:
    """What a user says of depth files; None leaves it to the format or to the type of file."""

    depth_format: str | None = None  # name of a row of the table
    depth_unit: str | None = None  # unit of the numbers: mm, cm, m or ft
    # Which channel of an EXR, or array of a container; PART/CHANNEL works too
    depth_channel: str | None = None
    part: int | None = None  # which part of an EXR, page of a TIFF or frame of an array, from 0
    view: str | None = None  # which view of an EXR of several, like left
    depth_scale: float | None = None
    depth_kind: str | None = None  # whether they are depth or disparity
    # The distances in mm of the ends of the number's type, 0 and 255 or 65535, or 0 and 1: of
    # depth, the distance of 0, then of the top; of disparity, that of the top, then of 0
    depth_range: tuple[float, float] | None = None
    focal_px: float | None = None  # focal length in px of the depth file
    baseline: float | None = None  # distance in mm between the two cameras
    doffs: float | None = None  # px added to the disparity; without focal length and baseline, 1/m
    geometry: str | None = None  # radial (distance to the point) or planar (depth along the axis)
    fov: float | None = None  # horizontal field of view in degrees
    sky: float | None = None  # numbers from this one on are sky; of disparity, up to this one
    invalid: str = "error"  # error, far (infinitely far) or fill (from the farther neighbour)
    # Whether the numbers are divided by alpha: on, off, or auto, where edges show that they are
    # multiplied by it
    unpremultiply_depth: str = "auto"
    # Nearest or guided (by the colours), where depth of another size than the colour is to be
    # resampled
    resize_depth: str | None = None
    # Whether depth beside its colour is turned by the orientation of the colour
    turn_depth: str | None = None
    relative: bool = False  # the numbers are disparity of unknown scale and offset, white near
    invert: str | None = None  # whether black is near; of relative disparity

    @property
    def row(self) -> DepthFormat:
        """The format: the one named, or ``metres`` or ``disparity`` where none is."""
        if self.depth_format is not None:
            return NAMES[self.depth_format]
        return FORMATS["disparity" if self.depth_kind == "disparity" else "metres"]

    @property
    def says_scale(self) -> bool:
        """Whether the scale of numbers of any type is said."""
        return (
            self.relative
            or self.depth_format is not None
            or self.depth_unit is not None
            or self.depth_scale is not None
            or self.depth_range is not None
            or self.depth_kind == "disparity"
        )

    @property
    def holds_radii(self) -> bool:
        """Whether no lens is needed but the shape of its opening: the files hold radii, or all but.

        Relative disparity gives radii by the largest of them and a number in focus.
        """
        return self.relative or self.row.rule == "radius"

    def as_relative(self) -> Self:
        """This reading of files whose numbers are relative disparity."""
        for name in _OF_METRES:
            if getattr(self, name) is not None:
                problem = "stands beside ‹blur›, which takes the numbers as relative disparity"
                field = self.geometry if name == "geometry" else name.replace("_", "-")
                remedy = "leave one of them out"
                raise UsageProblem("contradiction", problem, remedy, field=field or "")
        return replace(self, relative=True)

    @property
    def needs_lens(self) -> bool:
        """Whether the lens itself may have to say the field of view of the picture."""
        row = self.row
        if any(value is not None for value in (self.fov, self.focal_px, row.focal_px)):
            return False
        file_says = bool(row.radial_channels) or row.sidecar == "gdepth"
        geometry = self.geometry or row.geometry
        return geometry == "radial" or (file_says and self.geometry is None)


# Fields that say what the numbers of a file are in metres or radii.
_OF_METRES = (
    *("depth_format", "depth_unit", "depth_scale", "depth_kind", "depth_range", "focal_px"),
    *("baseline", "doffs", "geometry", "fov", "sky"),
)
AS_IT_IS = DepthReading()


MOST_STRETCHED = 0.02  # difference of the aspects of one view: networks round to 14, 32, 64 px


def stretched(size: tuple[int, int], target: tuple[int, int]) -> float | None:
    """How much wider, as a share, one view becomes in another size; None of another view.

    0 where the sizes are rounded alone. `size`, `target`: width and height.
    """
    (columns, rows), (width, height) = size, target
    if abs(width * rows - height * columns) <= max(*size, *target):
        return 0.0
    share = width * rows / (height * columns) - 1
    return share if abs(share) <= MOST_STRETCHED else None


def require_size(
    path: Path, reading: DepthReading, shape: tuple[int, ...], size: tuple[int, int] | None
) -> None:
    """Refuse depth of another size than its colour, before it is read, if it is not to be resized.

    Smaller depth is enlarged where nothing is said of it.

    `size`: width and height of the colour, None if there is none.
    """
    rows, columns = (-(-length // reading.row.stride) for length in shape[:2])
    if size is None or (columns, rows) == size or reading.resize_depth is not None:
        return
    smaller = columns < size[0] and rows < size[1]
    if not smaller or stretched((columns, rows), size) is None:
        raise wrong_size(path, (rows, columns), size)


def wrong_size(path: Path, shape: tuple[int, int], size: tuple[int, int]) -> InputError:
    """The error for depth of rows and columns beside a colour of a width and a height."""
    problem = f"is {shape[1]}x{shape[0]} px but its colour is {size[0]}x{size[1]} px"
    if shape == size:
        remedy = "turn one of them; or say ‹turn-depth› if Exif turned the colour alone"
        return InputError("wrong-size", f"{problem}, turned", remedy, path=path)
    remedy = "give depth of the size of the colour, or say ‹resize-depth› guided, or nearest"
    return InputError("wrong-size", problem, remedy, path=path)


@dataclass(frozen=True)
class Declared:
    """A depth file and the declarations on it."""

    path: Path
    reading: DepthReading  # the options of the user
    row: DepthFormat  # completed by its sidecar
    samples: DepthNumbers  # its numbers and its metadata

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
    has_scale = rule in ("scale", "inverse") and row.sidecar not in ("heic", "gdepth")
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
        raise UsageProblem("idle-option", f"has no effect on {kind}", "leave it out", field=option)
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
    reading, row = declared.reading, declared.row
    if reading.geometry is not None:
        return reading.geometry
    return "radial" if declared.samples.channel in row.radial_channels else row.geometry


def focal_of(declared: Declared, lens_focal: float | None) -> float | None:
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
        return reading.focal_px
    if reading.fov is not None:
        return width / 2 / math.tan(math.radians(reading.fov) / 2)
    if row.focal_px is not None:
        return row.focal_px if row.focal_width is None else row.focal_px * width / row.focal_width
    if lens_focal is not None:
        return lens_focal * width
    by = {"field": "radial"} if reading.geometry else declared.asked_by
    problem = "is the distance to the point, and nothing says the field of view"
    raise UsageProblem("missing-option", problem, "add ‹fov› 60deg or ‹focal-px› PX", **by)


MM_PER_M = 1000.0
_CALIBRATION = {"focal-px": "‹focal-px› PX", "baseline": "‹baseline› 65mm"}


def resolved(
    path: Path,
    reading: DepthReading,
    samples: DepthNumbers,
    *,
    lens_focal: float | None,
) -> DepthFormat:
    """The format of a file, completed by its sidecar and the user.

    `lens_focal`: focal length of the lens in widths of its sensor, None if there is no lens.
    """
    if reading.relative:
        near = "black" if reading.invert else "white"
        return replace(FORMATS["coc"], words=f"relative disparity, {near} near")
    row = reading.row
    if row.sidecar:
        from defocus_core.io.depth_formats.sidecars import with_sidecar

        row = with_sidecar(row, path, samples.metadata)
    declared = Declared(path, reading, row, samples)
    rule = _rule(declared)
    refuse_idle(declared, rule)
    if rule == "radius":
        return replace(row, words="signed CoC radius in px")
    row = (_disparity_row if rule == "inverse" else _depth_row)(declared)
    row = replace(row, rule=rule, sky=_sky(declared, row, rule))
    focal = focal_of(declared, lens_focal)
    if focal is None:
        return replace(row, geometry="planar")
    words = f"{row.words}, radial with {_focal_words(focal, samples.width)}"
    return replace(row, geometry="radial", focal_px=focal, words=words)


def _sky(declared: Declared, row: DepthFormat, rule: str) -> float:
    """The number from which on, towards the far end, the numbers of a file are sky."""
    if declared.reading.sky is not None:
        return declared.reading.sky
    if rule == "inverse":
        return -math.inf if row.scale > 0 else math.inf
    is_half = declared.samples.values.dtype.newbyteorder("=") == "float16"
    sky = min(row.sky, HALF_MAX) if is_half else row.sky
    return -sky if row.scale < 0 else sky


def _focal_words(focal: float, width: int) -> str:
    """A focal length in px, and the field of view that it is."""
    degrees = 2 * math.degrees(math.atan(width / 2 / focal))
    return f"a focal length of {focal:.6g} px, {degrees:.3g}° across"


def _rule(declared: Declared) -> str:
    """scale, inverse, log or radius: of the format, or by depth_kind."""
    reading, rule = declared.reading, declared.row.rule
    by_kind = {"depth": "scale", "disparity": "inverse"}.get(reading.depth_kind or "")
    if not rule:
        if by_kind is None:
            ask(declared, "depth-kind", "depth or disparity")
        return by_kind
    if by_kind is not None and by_kind != rule:
        holds = {"scale": "depth", "log": "depth", "inverse": "disparity"}.get(
            rule, declared.row.title
        )
        problem = f"contradicts ‹depth-format› {declared.row.name}, which is {holds}"
        raise UsageProblem("contradiction", problem, "leave one of them out", field="depth-kind")
    if reading.depth_range is not None and reading.depth_format is None and by_kind is None:
        problem = "does not say whether the numbers are depth or disparity"
        remedy = "add ‹depth-kind› disparity, or depth"
        raise UsageProblem("missing-option", problem, remedy, field="depth-range")
    return rule


def _ends(declared: Declared, *, disparity: bool) -> tuple[float, float] | None:
    """Near and far in metres, where a range is set."""
    reading, row = declared.reading, declared.row
    ends, is_relative = reading.depth_range, "depth-range" in row.needs or not row.rule
    if ends is None:
        if disparity and is_relative and reading.depth_scale is None:
            remedy = "NEAR FAR, like 1m 20m; or ‹depth-scale› and ‹doffs›, as 1/z = scale v + doffs"
            ask(declared, "depth-range", remedy)
        if not disparity and "depth-range" in row.needs:
            ask(declared, "depth-range", "NEAR FAR, like 1m 20m")
        return None
    near, far = (end / MM_PER_M for end in ends)
    if near == far:
        problem = "has the same distance twice"
        raise UsageProblem("out-of-range", problem, "give two distances", field="depth-range")
    return near, far


def _ends_in_words(top: float, of_network: bool, ends: tuple[float, float]) -> str:
    which = ", the greatest of the file," if of_network else ""
    return f"0 is {ends[0]:.6g} m and {top:.6g}{which} is {ends[1]:.6g} m"


def _top(declared: Declared) -> tuple[float, bool]:
    """The number at the other end of a range than 0, and whether it is that of the file.

    That of the type; a network's floats have no other end than their greatest. Floats beyond 0 and
    1 of which nothing is known are refused.
    """
    values, row = declared.samples.values, declared.row
    if declared.samples.is_integer:
        return declared.samples.top, False
    minimum, maximum = math.inf, -math.inf
    for rows in bands(values.shape):
        band = values[rows]
        finite = band[np.isfinite(band)]
        if finite.size:
            minimum, maximum = min(minimum, float(finite.min())), max(maximum, float(finite.max()))
    of_network = ("depth-range" in row.needs and row.rule == "inverse") or not row.rule
    if of_network and minimum >= 0 and maximum > 1 + 1e-3:
        return maximum, True
    if minimum < -1e-3 or maximum > 1 + 1e-3:
        problem = f"has floats from {minimum:.4g} to {maximum:.4g}, and ‹depth-range› is of 0 and 1"
        remedy = "give ‹depth-scale› and ‹doffs› instead"
        raise InputError("out-of-range", problem, remedy, path=declared.path)
    return 1.0, False


def _depth_row(declared: Declared) -> DepthFormat:
    reading, row, samples = declared.reading, declared.row, declared.samples
    if (ends := _ends(declared, disparity=False)) is not None:
        top, of_network = _top(declared)
        scale, shift = linear(*ends, top)
        words = f"depth, {_ends_in_words(top, of_network, ends)}"
        return replace(row, scale=scale, shift=shift, words=words)
    if "depth-scale" in row.needs and reading.depth_scale is None:
        ask(declared, "depth-scale", "METRES")
    unit = reading.depth_unit
    if reading.depth_format is None and unit is None:
        unit = "mm" if samples.type == "16-bit PNG" else "m"  # the custom
        if reading.depth_scale is not None:
            unit = "m"
        elif samples.is_integer and unit == "m":
            numbers = f"has {samples.channel} in whole numbers"
            if not samples.channel:
                numbers = f"holds {samples.values.dtype} numbers"
            problem = f"{numbers}, whose unit is unknown"
            named = samples.type == "HEIC"
            remedy = "say ‹depth-format› apple-heic" if named else "say ‹depth-unit› mm"
            raise InputError("unknown-unit", problem, remedy, path=declared.path)
    words = UNIT_WORDS.get(unit or "", "")
    own = row.integer_scale if samples.is_integer else None
    scale = (row.scale if own is None else own) * UNITS[unit or "m"]
    if reading.depth_scale is not None:
        scale *= reading.depth_scale
        words = ", ".join(filter(None, (words, f"× {reading.depth_scale:g}")))
    if reading.depth_format is not None:
        words = ", ".join(filter(None, (row.name, row.words, words)))
    return replace(row, scale=scale, words=words)


def _disparity_row(declared: Declared) -> DepthFormat:
    """A format of 1 / (scale · v + shift), be it by focal length and baseline."""
    reading, row, samples = declared.reading, declared.row, declared.samples
    if (ends := _ends(declared, disparity=True)) is not None:
        top, of_network = _top(declared)
        scale, shift = linear(1 / ends[1], 1 / ends[0], top)  # 1 / inf is 0
        words = f"disparity, {_ends_in_words(top, of_network, ends[::-1])}"
        return replace(row, scale=scale, shift=shift, words=words)
    scale = row.scale * (1.0 if reading.depth_scale is None else reading.depth_scale)
    if row.per_metre:
        words = f"{row.name}, {row.words or '1 / z'}"
        return replace(row, scale=scale / UNITS[reading.depth_unit or "m"], words=words)
    focal = row.focal_px if reading.focal_px is None else reading.focal_px
    baseline = row.baseline if reading.baseline is None else reading.baseline / MM_PER_M
    doffs = row.shift if reading.doffs is None else reading.doffs
    source = f" by {row.words}" if row.words else ""
    if focal is not None and baseline is not None:
        across = _focal_words(focal, samples.width).partition("px, ")[2]
        words = f"{row.name}, {focal:.6g} px ({across}) × {baseline:.6g} m{source}"
        scale, doffs = scale / (focal * baseline), doffs / (focal * baseline)
        return replace(row, scale=scale, shift=doffs, words=words)
    if focal is None and baseline is None and reading.depth_scale is not None:
        words = f"disparity, 1/z = {scale:g} v{f' + {doffs:g}' if doffs else ''}"
        return replace(row, scale=scale, shift=doffs, words=words)
    missing = [n for n, value in zip(_CALIBRATION, (focal, baseline), strict=True) if value is None]
    names = " and ".join(f"‹{name}›" for name in missing)
    why = f": there is no {row.sidecar} beside {declared.path}" if row.sidecar else ""
    remedy = f"add {' and '.join(_CALIBRATION[name] for name in missing)}"
    if row.name == "disparity":
        remedy += ", or ‹depth-range› NEAR FAR, or ‹depth-scale›"
    raise UsageProblem("missing-option", f"leaves {names} open{why}", remedy, **declared.asked_by)

"""Evidence for people to judge: of a depth file's format, and of colour and depth together.

Numbers, names and files beside it name the formats that a file could be of. Sharp colour has sharp
edges at every depth, which is measured. Neither changes what is read or rendered, and only strong
evidence is told.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import DefocusError
from defocus_core.io.arrays import IN_MEMORY, Keeping, bands
from defocus_core.io.depth_formats.depth import read_depth, read_numbers
from defocus_core.io.depth_formats.reading import DepthNumbers, DepthReading, holds_gdepth
from defocus_core.io.depth_formats.table import FLOATS, ROWS
from defocus_core.io.images.color import read_color
from defocus_core.io.images.describe import FileInfo
from defocus_core.io.safe_files import is_heic, read_head
from defocus_core.picture.element import element_depth
from defocus_core.request.job import Reading
from defocus_core.system.text import percent

if TYPE_CHECKING:
    Floats = NDArray[np.float32]

_TOP = 65535
_GROWS = 2.0  # how many times greater numbers are below
_SEVERAL = 0.001  # share of pixels
# Names of channels and arrays that only one format has.
_TELLING_NAMES = {
    "unreal-mrq": ("FinalImage*WorldDepth*", "ImageDepth*"),
    "coc": ("coc",),
    "houdini": ("Pz", "*.Pz"),
    "hypersim": ("dataset",),
    "nyu-mat": ("rawDepths",),
    "spring": ("disparity",),
    "vision-blender": ("depth_map",),
}
_BESIDE = {
    "middlebury": ("PFM", "calib.txt"),
    "hci-lightfield": ("PFM", "parameters.cfg"),
    "diode": ("NPY", "{stem}_mask.npy"),
    "moge": ("EXR", "fov.json"),
}
_LEAST_SIDE = 3  # px of a picture that has an edge
_WINDOW = 2048  # px, side of the middle of the picture that is measured
# Widths of edges are measured at two scales, standard deviations in px.
_FINE, _COARSE = 1, 2
_MIN_STEP = 0.02  # least gradient of an edge, in parts of white a px
# Of the edges at one range of depths, the sharpest quarter tells how sharp the colour is there.
_QUARTER, _MIN_EDGES, _RANGES = 25, 300, 6
_SHARP_PX, _BLURRED_PX = 1.0, 1.6  # standard deviation of an edge: as good as sharp, surely blurred


def evidence_of(
    path: Path, reading: DepthReading, info: FileInfo, keeping: Keeping
) -> tuple[str, ...]:
    """Sentences on the formats that a depth file could be of."""
    sentences = [] if reading.depth_format is not None else [*_names_evidence(path, info)]
    if holds_gdepth(path):
        return tuple(sentences)
    try:
        scaled = reading if reading.says_scale else replace(reading, depth_scale=1.0)
        samples = read_numbers(path, scaled, keeping, None)
    except DefocusError:  # another line of the report says why
        return tuple(sentences)
    if reading.depth_format is None:
        sentences += _numbers_evidence(path, samples, reading)
    return tuple(sentences)


def _names_evidence(path: Path, info: FileInfo) -> Iterator[str]:
    """Evidence of the names of channels, and of files beside the depth file."""
    names = [name.split(" ")[0] for name in info.names]
    for name, patterns in _TELLING_NAMES.items():
        hits = [n for n in names if any(fnmatchcase(n, pattern) for pattern in patterns)]
        if hits:
            yield f"{hits[-1]}: {_say(name)}"
    if holds_gdepth(path):
        yield f"GDepth in its XMP: {_say('android-gdepth')}"
    if is_heic(read_head(path)):
        yield f"a depth image beside the picture: {_say('apple-heic')}"
    kind = path.suffix[1:].upper()
    for name, (file_type, place) in _BESIDE.items():
        if kind == file_type and path.with_name(place.format(stem=path.stem)).is_file():
            yield f"{place.format(stem=path.stem)} beside it: {_say(name)}"


def _numbers_evidence(path: Path, samples: DepthNumbers, reading: DepthReading) -> Iterator[str]:
    """Evidence of the numbers of a file without a named format."""
    if samples.is_of_nuke:
        yield f"Nuke wrote it, whose ScanlineRender writes 1/z: {_say('nuke-scanline')}"
    if samples.type == "16-bit PNG":
        top, zero = (_share(samples, number) for number in (_TOP, 0))
        if top >= _SEVERAL:
            names = [r.name for r in _rows_of("16-bit PNG") if 65000 <= r.sky <= _TOP]
            yield f"{_TOP} in {percent(top)} of the 16-bit pixels: {_say(*names)}"
        if zero >= _SEVERAL:
            names = [r.name for r in _rows_of("16-bit PNG") if 0 in r.invalid and r.rule == "scale"]
            shown = ", ".join(names[:5])
            yield (
                f"0 in {percent(zero)} of the 16-bit pixels: holes of {shown} and others, or far "
                "away by a network; say ‹depth-format›, and ‹invalid› far or fill for holes"
            )
    if samples.type in FLOATS and not reading.says_scale and _grows_downwards(samples):
        yield (
            "greater numbers below than above, as disparity has: of a network say ‹depth-format› "
            "depth-anything ‹depth-range› NEAR FAR, or ‹blur› 20px ‹focus-at› X,Y"
        )
    if samples.type == "8-bit PNG" and not reading.says_scale:
        yield (
            "8 bits: relative depth of a network; say ‹blur› 20px ‹focus-at› X,Y if bright is near "
            "(‹invert› if not), or in metres ‹depth-range› NEAR FAR, and ‹depth-kind› disparity if "
            "bright is near, or depth if bright is far"
        )
    has_sidecar = any(path.with_name(place).is_file() for _, place in _BESIDE.values())
    if samples.type == "PFM" and not has_sidecar and samples.values.min() < 0:
        yield f"negative numbers: disparity about a plane, {_say('hci-lightfield')}"


def _grows_downwards(samples: DepthNumbers) -> bool:
    """Whether the lower third has clearly greater numbers than the upper: the ground is near."""
    values, height = samples.values, samples.values.shape[0]
    if samples.marks or height < 3:
        return False
    above, below = (
        np.asarray(values[rows], np.float64)
        for rows in (slice(height // 3), slice(-(height // 3), None))
    )
    usable = all(np.isfinite(each).all() and each.min() >= 0 for each in (above, below))
    return usable and float(np.median(below)) > _GROWS * float(np.median(above)) + 1e-9


def _share(samples: DepthNumbers, number: int) -> float:
    values = samples.values
    count = sum(int((values[rows] == number).sum()) for rows in bands(values.shape))
    return count / float(values.shape[0] * values.shape[1])


def _rows_of(file_type: str) -> list[Any]:
    return [row for row in ROWS if file_type in row.files and not row.bits]


def _say(*names: str) -> str:
    """Formats that fit, and the option that names one."""
    listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"
    return f"{listed}; say ‹depth-format› {names[0] if len(names) == 1 else 'NAME'}"


def evidence_of_pair(
    color: Path,
    depth: Path,
    reading: Reading,
    *,
    keeping: Keeping = IN_MEMORY,
    lens_focal: float | None = None,
) -> tuple[str, ...]:
    """Sentences on what is wrong between colour and depth of one size; empty if nothing."""
    image = read_color(
        color,
        layer=reading.color_layer,
        part=None,
        view=reading.view,
        keeping=keeping,
        carried=False,
    )
    height, width = image.shape[:2]
    beside = read_depth(
        depth,
        reading,
        keeping=keeping,
        size=(width, height),
        lens_focal=lens_focal,
        alpha=image.alpha,
        orientation=image.orientation,
    )
    if beside.metres.shape != (height, width):
        return ()
    metres = element_depth(beside, image, keeping).metres
    rows, columns = _middle(height), _middle(width)
    near = metres[rows][:, columns]
    if min(near.shape) < _LEAST_SIDE:
        return ()
    planes = [plane[rows][:, columns] for plane in image.planes[:3]]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        disparity = np.where(near > 0, 1 / near, 0).astype(np.float32)  # holes count as far
        light = np.mean(planes, 0, dtype=np.float32)
    white = float(np.percentile(light, 99)) or 1.0
    seen: Floats = np.power(np.clip(np.nan_to_num(light) / white, 0, 1), np.float32(1 / 2.2))
    return tuple(filter(None, [_blurred(seen, disparity)]))


def _middle(length: int) -> slice:
    start = max(length - _WINDOW, 0) // 2
    return slice(start, start + min(length, _WINDOW))


def _blurred(seen: Floats, disparity: Floats) -> str:
    """A sentence if edges are wide at one range of depths, or at all; else empty."""
    smoothed = (_smoothed(seen, scale) for scale in (_FINE, _COARSE))
    fine, coarse = (np.hypot(*np.gradient(image)) for image in smoothed)
    is_edge = _is_crest(fine) & (fine > _MIN_STEP)
    # An edge of standard deviation s, smoothed by a, has a gradient that goes with 1/√(s² + a²).
    ratio = np.square(fine[is_edge] / np.maximum(coarse[is_edge], 1e-6))
    variance = (_COARSE**2 - ratio * _FINE**2) / np.maximum(ratio - 1, 1e-3)
    order = np.argsort(disparity[is_edge], kind="stable")
    groups = np.array_split(order, _RANGES)
    if len(groups[-1]) < _MIN_EDGES:
        return ""
    widths = [float(np.percentile(variance[group], _QUARTER)) for group in groups]
    widths = [max(width, 0) ** 0.5 for width in widths]
    widest = int(np.argmax(widths))
    if widths[widest] < _BLURRED_PX:
        return ""
    if min(widths) >= _BLURRED_PX:
        spread = f"three quarters of its edges have a spread of {min(widths):.1f} px and more"
        return f"warning: the colour looks blurred everywhere: {spread}; take a sharp picture"
    if min(widths) > _SHARP_PX:
        return ""
    at = float(np.median(disparity[is_edge][groups[widest]]))
    where = f"at {1 / at:.3g} m" if at > 0 else "far away"
    spread = f"edges have a spread of {widths[widest]:.1f} px {where}"
    sharp = f"{min(widths):.1f} px where they are sharpest"
    remedy = "take a picture that is in focus everywhere"
    return f"warning: the colour looks blurred already: {spread}, {sharp}; {remedy}"


def _smoothed(image: Floats, scale: float) -> Floats:
    """An image smoothed by a Gaussian of a standard deviation in px; edges are continued."""
    reach = int(3 * scale)
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / scale)).astype(np.float32)
    weights /= weights.sum()
    for axis in (0, 1):
        margins = [(reach, reach) if axis == each else (0, 0) for each in (0, 1)]
        views = np.lib.stride_tricks.sliding_window_view(
            np.pad(image, margins, mode="edge"), len(weights), axis
        )
        image = views @ weights
    return image


def _is_crest(gradient: Floats) -> NDArray[np.bool_]:
    """Where a gradient is not less than that of both neighbours in a row or in a column."""
    crest = np.zeros(gradient.shape, bool)
    middle = gradient[1:-1, 1:-1]
    in_row = (middle >= gradient[1:-1, :-2]) & (middle >= gradient[1:-1, 2:])
    in_column = (middle >= gradient[:-2, 1:-1]) & (middle >= gradient[2:, 1:-1])
    crest[1:-1, 1:-1] = in_row | in_column
    return crest

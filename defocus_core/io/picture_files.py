"""Reading and writing of pictures, depth and maps as NumPy arrays, for Python programs.

Colour is scene-linear and premultiplied by alpha. Depth is planar, in metres. Declarations
of a file are returned with its numbers; options complete them. `torch.from_numpy` makes tensors.
Errors name the options of the command line: ‹depth-format› is ``format`` here.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from defocus_core import gone
from defocus_core.errors import DefocusError, UsageProblem, did_you_mean
from defocus_core.io.depth_formats import depth as depth_files
from defocus_core.io.depth_formats.depth import Depth, require_valid
from defocus_core.io.depth_formats.reading import KINDS, DepthReading
from defocus_core.io.depth_formats.table import NAMES, UNITS
from defocus_core.io.exr.writing import write_exr, write_exr_image
from defocus_core.io.images import color as color_files
from defocus_core.io.images import encode
from defocus_core.io.images.color import Color
from defocus_core.io.images.raster import PLAIN_CHANNELS

if TYPE_CHECKING:
    from os import PathLike

BYTES = "bytes"  # what errors name where there is no file
HOLES = ("keep", "error", "far", "fill")


@contextmanager
def as_file(source: str | PathLike[str] | bytes) -> Iterator[Path]:
    """The path of a file, or of a temporary copy of its bytes that lasts for the block."""
    if not isinstance(source, bytes):
        yield Path(source)
        return
    with tempfile.NamedTemporaryFile(prefix="defocus-") as file:
        file.write(source)
        file.flush()
        try:
            yield Path(file.name)
        except DefocusError as error:
            if error.path == file.name:
                error.place = replace(error.place, path=BYTES)
            raise


def read_color(
    path: str | PathLike[str] | bytes,
    *,
    layer: str | None = None,
    part: int | None = None,
    view: str | None = None,
) -> Color:
    """Read the colour of an EXR, HDR, PNG, JPEG, TIFF or WEBP file.

    Args:
        path: The file, or its bytes.
        layer: Which colour layer of an EXR file of several; PART/LAYER works.
        part: Which part of an EXR file, or page of a TIFF, from 0.
        view: Which view of an EXR file of several; None for its default one.

    Returns:
        Its ``pixels``, float32 [H, W, C], scene-linear, premultiplied by alpha; the names of their
        ``channels``, R G B or Y, then A if there is one; ``note``, how the samples were understood;
        ``warnings``, what of the file was not applied; ``attributes``, its metadata.

    Raises:
        InputError: The file cannot be read, or has no colour or several to choose from.
        UsageProblem: A layer or view is asked of a file that has none.
    """
    with as_file(path) as file:
        return color_files.read_color(file, layer=layer, part=part, view=view)


def read_depth(
    path: str | PathLike[str] | bytes,
    *,
    format: str | None = None,
    unit: str | None = None,
    scale: float | None = None,
    kind: str | None = None,
    channel: str | None = None,
    part: int | None = None,
    view: str | None = None,
    range_mm: tuple[float, float] | None = None,
    radial: bool | None = None,
    focal_px: float | None = None,
    fov: float | None = None,
    baseline_mm: float | None = None,
    doffs: float | None = None,
    sky: float | None = None,
    invalid: str = "keep",
) -> Depth:
    """Read depth of any format as planar metres.

    Args:
        path: The file: EXR, PNG, TIFF, NPY, NPZ, PFM, HDF5, …; or its bytes.
        format: The name of its format, like ``kitti``; ``defocus help depth`` lists all.
        unit: Of the numbers: mm, cm, m or ft.
        scale: Multiplies the numbers; negative for depth that is negative in front of the camera.
        kind: What the numbers are: depth or disparity.
        channel: Which channel of an EXR file, or array of a container; PART/CHANNEL works.
        part: Which part of an EXR file, page of a TIFF or frame of an array, from 0.
        view: Which view of an EXR file of several.
        range_mm: The distances in mm at the ends of the range of the numbers (of floats 0 and 1):
            for depth that of 0, then that of the greatest number; for disparity that of the
            greatest number, then that of 0.
        radial: True if the numbers are distances to the point, False if they are planar.
        focal_px: Focal length of the picture in px.
        fov: Horizontal field of view in degrees.
        baseline_mm: Distance between the two cameras of a disparity.
        doffs: Px added to a disparity.
        sky: Numbers from this one on are sky; of disparity, up to this one.
        invalid: What becomes of pixels without depth: keep (as the file has them: NaN, 0 or
            negative), error, far (+inf) or fill (from the farther neighbour).

    Returns:
        Its ``metres``, float32 [H, W], planar distance along the axis, where +inf is sky;
        ``invalid``, bool [H, W], where there is no depth; ``note``, how the file was understood;
        ``warnings``, what was taken for granted. Of a format that holds radii (``is_radius``),
        ``metres`` are signed radii of the blur in px.

    Raises:
        InputError: The file cannot be read, what its depth is stays open, or pixels have none and
            ``invalid="error"``.
        UsageProblem: An option is missing, unknown, or makes no sense for this file.
    """
    _bounded("depth-scale", None if scale is None else abs(scale))  # negative: the axis is reversed
    _one_of("depth-format", format, tuple(NAMES), "'defocus help depth' lists all")
    reading = DepthReading(
        depth_format=format,
        depth_unit=_one_of("depth-unit", unit, tuple(UNITS)),
        depth_scale=scale,
        depth_kind=_one_of("depth-kind", kind, KINDS),
        depth_channel=channel,
        part=part,
        view=view,
        depth_range=range_mm,
        geometry=None if radial is None else "radial" if radial else "planar",
        focal_px=_bounded("focal-px", focal_px),
        fov=_bounded("fov", fov, 180.0),
        baseline=_bounded("baseline", baseline_mm),
        doffs=doffs,
        sky=sky,
        invalid=invalid if _one_of("invalid", invalid, HOLES) in ("far", "fill") else "error",
    )
    with as_file(path) as file:
        depth = depth_files.read_depth(file, reading)
        if invalid == "error":
            require_valid(depth)
    return depth


def write_image(
    path: str | PathLike[str],
    pixels: ArrayLike,
    *,
    channels: Sequence[str] | None = None,
    exr_type: str = "half",
    bits: int = 8,
    jpeg_quality: int = 95,
    attributes: Mapping[str, object] | None = None,
) -> list[str]:
    """Write a picture; its folder is made, and a file that is there replaced.

    Args:
        path: Its suffix says the format: exr, png, tif, tiff, jpg, jpeg or webp. EXR is linear; the
            others are sRGB, clipped to 0…1, and their alpha is unassociated.
        pixels: [H, W, C] or [H, W], scene-linear, premultiplied by alpha if there is one.
        channels: Names of the C channels; None for Y, YA, RGB or RGBA.
        exr_type: Number type of an EXR, half or float.
        bits: Of a PNG, 8 or 16; a TIFF has 16.
        jpeg_quality: Of JPEG and WEBP, 1 to 100.
        attributes: Metadata, as those of a `Color`.

    Returns:
        What the file cannot hold, like pixels that were clipped; one clause each.

    Raises:
        InputError: The file cannot be written.
        UsageProblem: A suffix of no known format, or an option out of its range.
        ValueError: The array has another shape.
    """
    image = np.asarray(pixels, np.float32)
    image = image[:, :, None] if image.ndim == 2 else image
    if channels is None and image.ndim == 3:
        channels = PLAIN_CHANNELS.get(image.shape[2])
    if channels is None or image.ndim != 3 or len(channels) != image.shape[2] or not image.size:
        wanted = "[H, W] or [H, W, C] with the C channels named, or 1 to 4 of them"
        raise ValueError(f"pixels must be {wanted}, got {list(np.shape(pixels))}")
    _one_of("exr-type", exr_type, ("half", "float"))
    if bits not in (8, 16):
        raise UsageProblem("out-of-range", f"{bits} is neither 8 nor 16", "write 8", field="bits")
    if not 1 <= jpeg_quality <= 100:
        problem = f"{jpeg_quality} is not 1 to 100"
        raise UsageProblem("out-of-range", problem, "write 95", field="jpeg-quality")
    planes = tuple(np.moveaxis(image, 2, 0))
    if Path(path).suffix.lower() == ".exr":
        named = dict(zip(channels, planes, strict=True))
        return write_exr_image(Path(path), named, exr_type, attributes or {})
    return encode.write_image(
        Path(path),
        planes,
        tuple(channels),
        bits=bits,
        jpeg_quality=jpeg_quality,
        attributes=attributes or {},
    )


def write_map(path: str | PathLike[str], plane: ArrayLike, *, channel: str = "Z") -> None:
    """Write numbers as they are, in float32: depth in metres, radii in px, ….

    Args:
        path: An EXR or TIFF file; its folder is made, and a file that is there replaced.
        plane: [H, W].
        channel: Name of the channel; Z is depth.

    Raises:
        InputError: The file cannot be written.
        UsageProblem: Another suffix.
        ValueError: The array has another shape.
    """
    values: NDArray[np.float32] = np.asarray(plane, np.float32)
    if values.ndim != 2 or not values.size:
        raise ValueError(f"plane must be [H, W], got {list(values.shape)}")
    suffix = Path(path).suffix.lower()
    if suffix == ".exr":
        write_exr(Path(path), {channel: values}, {})
    elif suffix in (".tif", ".tiff"):
        encode.write_map(Path(path), values, channel)
    else:
        problem = "does not have the suffix of a format of maps"
        raise UsageProblem("wrong-type", problem, "use .exr or .tif", path=Path(path))


def _one_of(field: str, word: str | None, known: Sequence[str], otherwise: str = "") -> str | None:
    """The word of an option, once it is known to be one of those that it may have."""
    if word is None or word in known:
        return word
    remedy = did_you_mean(str(word), known, otherwise or f"choose from {', '.join(known)}")
    remedy = gone.remedy("value", word, field, remedy)
    raise UsageProblem("unknown-name", f"{word!r} is not known", remedy, field=field)


def _bounded(field: str, value: float | None, end: float = math.inf) -> float | None:
    """A number between 0 and `end`, or None."""
    if value is None or 0 < value < end:
        return value
    wanted = "positive and finite" if end == math.inf else f"above 0 and below {end:g}"
    remedy = "give such a number"
    raise UsageProblem("out-of-range", f"{value:g} is not {wanted}", remedy, field=field)

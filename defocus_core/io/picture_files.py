"""Reading and writing of pictures, depth and maps as NumPy arrays, for Python programs.

Colour is scene-linear and premultiplied by alpha. Depth is planar, in metres. What a file declares
is returned with its numbers; options supply what it does not declare. `torch.from_numpy` makes
tensors. Errors name options as the command line does, in angle quotes: ‹depth-format› stands for
the argument ``format``.
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
from defocus_core.io.array_files import array_of
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

BYTES = "bytes"  # the name in errors of input that is not a file
HOLES = ("keep", "error", "far", "fill")


@contextmanager
def as_file(source: str | PathLike[str] | bytes) -> Iterator[Path]:
    """Yield the path of a file, or of a temporary copy of its bytes that lasts for the block."""
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
        layer: Name of a colour layer of an EXR file of several; PART/LAYER works, too.
        part: Index of a part of an EXR file or a page of a TIFF, from 0.
        view: Name of a view of an EXR file of several; None for its default one.

    Returns:
        A `Color`: ``pixels``, float32 [H, W, C], scene-linear, premultiplied by alpha; the names
        of their ``channels``, R G B or Y, then A if there is one; ``note``, how the samples were
        understood; ``warnings``, declarations of the file that were not applied; ``attributes``,
        the metadata of the file.

    Raises:
        InputError: The file cannot be read, or has no colour or several to choose from.
        UsageProblem: A layer or view is named for a file that has none.
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
        unit: Unit of the numbers: mm, cm, m or ft.
        scale: Factor on the numbers; negative for depth that is negative in front of the camera.
        kind: What the numbers are: depth or disparity.
        channel: Name of a channel of an EXR file, or of an array in a file of several; PART/CHANNEL
            works, too.
        part: Index of a part of an EXR file, page of a TIFF or frame of an array, from 0.
        view: Name of a view of an EXR file of several.
        range_mm: The distances in mm of the ends of the range of the numbers (0 and 1 for floats).
            For depth, first that of 0, then that of the greatest number; for disparity, first that
            of the greatest number, then that of 0.
        radial: True if the numbers are distances to the point, False if they are planar.
        focal_px: Focal length of the picture in px.
        fov: Horizontal field of view in degrees.
        baseline_mm: Distance in mm between the two cameras of a disparity.
        doffs: px added to a disparity.
        sky: This number and greater ones are sky; for disparity, this number and smaller ones.
        invalid: What is done with pixels without depth: keep (as in the file: NaN, 0 or negative),
            error, far (set to +inf) or fill (from the farther neighbour).

    Returns:
        A `Depth`: ``metres``, float32 [H, W], planar distance along the axis, +inf for sky;
        ``invalid``, bool [H, W], where there is no depth; ``note``, how the file was understood;
        ``warnings``, what was assumed. If the format holds radii (``is_radius``), ``metres`` are
        signed radii of the blur in px.

    Raises:
        InputError: The file cannot be read, the meaning of its numbers is unknown, or pixels have
            no depth and ``invalid="error"``.
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
    """Write a picture; missing folders are made, and an existing file is replaced.

    Args:
        path: Its suffix says the format: exr, png, tif, tiff, jpg, jpeg or webp. EXR is linear; the
            others are sRGB, clipped to 0…1, and their alpha is unassociated.
        pixels: [H, W, C] or [H, W], scene-linear, premultiplied by alpha if there is one.
        channels: Names of the C channels; None for Y, YA, RGB or RGBA.
        exr_type: Number type of an EXR, half or float.
        bits: Bits of a PNG, 8 or 16; a TIFF has 16.
        jpeg_quality: Quality of JPEG and WEBP, 1 to 100.
        attributes: Metadata, as in ``attributes`` of `read_color`.

    Returns:
        Warnings of what the file cannot hold, like clipped pixels; one clause each.

    Raises:
        InputError: The file cannot be written.
        UsageProblem: A suffix of no known format, or an option out of its range.
        ValueError: The array has another shape.
    """
    image = array_of(pixels)
    if image.dtype.kind != "f":
        remedy = "decode integers to linear light first, as read_color does"
        raise ValueError(f"pixels must be floats, got {image.dtype}; {remedy}")
    image = np.asarray(image, np.float32)
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
        path: An EXR or TIFF file; missing folders are made, and an existing file is replaced.
        plane: [H, W].
        channel: Name of the channel; Z is depth.

    Raises:
        InputError: The file cannot be written.
        UsageProblem: Another suffix.
        ValueError: The array has another shape.
    """
    values: NDArray[np.float32] = np.asarray(array_of(plane), np.float32)
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
    if word is None or word in known:
        return word
    remedy = did_you_mean(str(word), known, otherwise or f"choose from {', '.join(known)}")
    remedy = gone.remedy("value", word, field, remedy)
    raise UsageProblem("unknown-name", f"{word!r} is not known", remedy, field=field)


def _bounded(field: str, value: float | None, end: float = math.inf) -> float | None:
    if value is None or 0 < value < end:
        return value
    wanted = "positive and finite" if end == math.inf else f"above 0 and below {end:g}"
    remedy = "give such a number"
    raise UsageProblem("out-of-range", f"{value:g} is not {wanted}", remedy, field=field)

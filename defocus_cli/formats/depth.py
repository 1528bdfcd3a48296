"""Depth maps decoded to planar metres, with sky at infinity; holes are refused.

Nothing is read off the range of the values. Floats (EXR, PFM, NPY, float TIFF) are metres and
16-bit integers of PNG and TIFF millimetres unless a unit is given; those of EXR and NPY have no
custom, so they need one. +inf and 1e10 and beyond, in the file's unit,
are sky; so is 65504 in a half channel, the largest number that half can hold. NaN, 0 and negative
are no depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from defocus_cli.formats.exr import read_parts
from defocus_cli.formats.exr_channels import NoDepthChannel, choose_depth
from defocus_cli.formats.exr_header import is_exr, read_headers
from defocus_cli.formats.float_maps import is_float_map, read_float_map
from defocus_cli.formats.raster import choose_page, read_pages, read_samples
from defocus_cli.system.arrays import IN_MEMORY, Keeping, Scratch, bands, count_of
from defocus_cli.system.console import counted
from defocus_cli.system.errors import InputError, UsageProblem
from defocus_cli.system.safe_files import read_head

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from defocus_cli.formats.exr import Part
    from defocus_cli.formats.exr_header import Header

METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "ft": 0.3048}
WORDS = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "ft": "feet"}
SKY = 1e10
HALF_SKY = 65504.0
FORMATS = "EXR, PFM, NPY or float TIFF, or 16-bit PNG in millimetres"


@dataclass(frozen=True)
class Depth:
    """A decoded depth map.

    Attributes:
        metres: float32 [H, W], planar distance along the axis; +inf is sky.
        path: the file.
        channel: the channel's name in the file, empty where channels have none.
        note: how the file was understood, for people.
    """

    metres: Any
    path: Path
    channel: str
    note: str

    def valid(self, rows: slice) -> NDArray[np.bool_]:
        """Where some rows have a depth: the file may have NaN, 0 and negative numbers."""
        found: NDArray[np.bool_] = self.metres[rows] > 0  # asked this way round, NaN is invalid too
        return found

    @property
    def invalid(self) -> NDArray[np.bool_]:
        """Where the file has NaN, 0 or a negative number: [H, W]."""
        return ~self.valid(slice(None))


def read_depth(
    path: Path,
    *,
    channel: str | None = None,
    part: int | None = None,
    unit: str | None = None,
    keeping: Keeping = IN_MEMORY,
) -> Depth:
    """Decode a depth map; holes are marked, not refused (see `require_valid`).

    Args:
        path: an EXR, PFM, NPY, 16-bit PNG or TIFF, or float TIFF file.
        channel: which channel of an EXR file; PART/CHANNEL works too.
        part: only look in this part of a multi-part EXR file, or page of a TIFF, counted from 0.
        unit: mm, cm, m or ft; None for metres, or millimetres in 16-bit PNG and TIFF.
        keeping: where the numbers are to be kept.

    Raises:
        InputError: the file cannot be read, or what its depth is cannot be told.
        UsageProblem: an unknown unit, or a channel for a file that has no named ones.
    """
    if unit is not None and unit not in METRES:
        raise UsageProblem("--depth-unit", f"{unit} is not known", f"use {', '.join(METRES)}")
    head = read_head(path)
    if is_exr(head):
        return _from_exr(path, channel, part, unit, keeping)
    if path.suffix.lower() == ".exr":
        raise InputError(path, "is not an OpenEXR file", "check what wrote it")
    if channel is not None:
        raise UsageProblem("--depth-channel", f"{path} has no named channels", "leave it out")
    if is_float_map(head):
        read = read_float_map(path, integers=unit is not None)
        return _depth(path, "", read.values, unit or "m", read.format, keeping)
    return _from_raster(path, part, unit, keeping)


def require_valid(depth: Depth) -> None:
    """Refuse a depth map with holes.

    Raises:
        InputError: naming how many pixels are NaN, 0 or negative, and the first as x,y.
    """
    count, first = count_of((~depth.valid(rows), rows.start) for rows in bands(depth.metres.shape))
    if not count:
        return
    problem = f"is NaN or ≤ 0 in {counted(count, 'pixel')}, the first at {first}"
    raise InputError(depth.path, problem, "fill the holes, and write inf for sky")


def _from_exr(
    path: Path, channel: str | None, part: int | None, unit: str | None, keeping: Keeping
) -> Depth:
    headers = read_headers(path)
    try:
        chosen = choose_depth(path, headers, channel=channel, part=part)
    except NoDepthChannel as error:
        if not any(_grey(each) for each in read_parts(path)):
            raise
        remedy = "R, G and B are equal: if they are the depth, say --depth-channel R"
        raise NoDepthChannel(path, error.problem, remedy) from None
    header = chosen.header
    if not header.data.covers(header.display):
        problem = "has depth in its data window only, which leaves pixels of the picture without"
        raise InputError(path, problem, "render the depth over the whole display window")

    def wanted(other: Header, name: str) -> bool:
        return (other.index, name) == (header.index, chosen.name)

    parts = read_parts(path, headers, keeping, wanted)
    pixels = parts[header.index].channels.get(chosen.name)
    del parts  # other channels are not needed
    if pixels is None:
        problem = f"has {chosen.name} at a lower resolution than its other channels"
        raise InputError(path, problem, "save the depth without subsampling")
    if unit is None and pixels.dtype.kind in "iu":
        problem = f"has {chosen.name} in whole numbers, whose unit is unknown"
        raise InputError(path, problem, "say --depth-unit mm")
    kind = {"float16": "half", "float32": "float"}.get(pixels.dtype.name, pixels.dtype.name)
    place = f" of part {header.label}" if len(headers) > 1 else ""
    told = ", ".join(filter(None, (f"EXR {kind} channel {chosen.name}{place}", header.cut_note)))
    return _depth(path, chosen.name, pixels, unit or "m", told, keeping)


def _grey(part: Part) -> bool:
    """Whether R, G and B of a part are equal: depth may have been saved as a grey picture."""
    import numpy as np

    planes: Sequence[Any] = [part.channels.get(name) for name in "RGB"]
    if any(plane is None for plane in planes):
        return False
    return all(np.array_equal(planes[0], plane, equal_nan=True) for plane in planes[1:])


def _from_raster(path: Path, part: int | None, unit: str | None, keeping: Keeping) -> Depth:
    import numpy as np

    raster = choose_page(path, read_pages(path, wanted=FORMATS), part)
    if raster.deep:
        raise InputError(path, "holds deep data", "flatten it first")
    if raster.type == "uint8":
        problem = "has 8 bits, too few for depth and without a metric scale"
        raise InputError(path, problem, f"save depth as {FORMATS}")
    if len(raster.channels) != 1:
        problem = f"has channels {', '.join(raster.channels)}; depth is one channel"
        raise InputError(path, problem, "save the depth as a single grey channel")
    integer = raster.type == "uint16"
    kind = f"{'16-bit' if integer else raster.type} {path.suffix[1:].upper()}"
    unit = unit or ("mm" if integer else "m")
    size = raster.height, raster.width
    dtypes = {"uint16": np.uint16, "half": np.float16}  # of half, 65504 is told apart
    values = keeping.new(size, dtypes.get(raster.type, np.float32))
    for window, samples in read_samples(path, raster.page):
        values[window] = samples[:, :, 0]
    return _depth(path, "", values, unit, kind, keeping)


def _depth(path: Path, channel: str, values: Any, unit: str, kind: str, keeping: Keeping) -> Depth:
    """Values of a file, in ``unit``, as planar metres."""
    import numpy as np

    own = isinstance(values, Scratch) or (values.flags.owndata and values.flags.writeable)
    # what is read is not needed any more: metres take its place
    metres = values if own and values.dtype == "=f4" else keeping.new(values.shape, np.float32)
    half_sky = False
    for rows in bands(values.shape):
        given = values[rows]
        with np.errstate(over="ignore"):  # a double beyond float32 is sky
            found = given.astype(np.float32)
        sky = found >= SKY
        if given.dtype.newbyteorder("=") == np.float16:
            largest = given == HALF_SKY
            half_sky |= bool(largest.any())
            sky |= largest
        if unit != "m":
            found = (given.astype(np.float64) * METRES[unit]).astype(np.float32)
        metres[rows] = np.where(sky, np.float32(np.inf), found)
    note = f"{kind}, {WORDS[unit]}{', 65504 taken as sky' * half_sky}"
    return Depth(metres, path, channel, note)

"""Options for reading a depth file, which complete its format, and the numbers that are read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.depth_formats.table import FORMATS, NAMES, DepthFormat
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.read_files import is_heic, is_jpeg, once, open_plain, read_head

KINDS = ("depth", "disparity")
INVALID = ("error", "far", "fill")
RESIZES = ("nearest", "guided")
ALICEVISION, OF_NUKE = "AliceVision:", "nuke/"  # prefixes of names of EXR attributes
XMP_BYTES = 1 << 17  # bytes at the beginning of a JPEG that hold its XMP
_LARGEST = 1 << 28  # bytes of a photograph that are searched
PICTURES = b"MPF\0"  # start of the list of further pictures in a JPEG
_OF_APPLE = re.compile(rb"""apdi:AuxiliaryImageType\s*(?:=\s*["']|>)(?:depth|disparity)\b""")


def own_format(path: Path) -> str:
    """The name of the depth format by which a photograph or EXR declares itself; empty if none."""
    head = read_head(path, XMP_BYTES)
    if is_jpeg(head):
        if b"GDepth:" in head or b"DepthMap:" in head:
            return "android-gdepth"
        return "apple-heic" if PICTURES in head and _holds_depth_of_apple(path) else ""
    if is_exr(head):
        names = (name for header in read_headers(path) for name in header.attributes)
        return "alicevision" if any(name.startswith(ALICEVISION) for name in names) else ""
    return "apple-heic" if is_heic(head) else ""


@once
def _holds_depth_of_apple(path: Path) -> bool:
    with open_plain(path) as file:
        return _OF_APPLE.search(file.read(_LARGEST)) is not None


@dataclass(frozen=True, kw_only=True)
class DepthReading:
    """Options for reading depth files; None leaves an option to the format or the type of file."""

    depth_format: str | None = None  # name of a row of the table
    depth_unit: str | None = None  # unit of the numbers: mm, cm, m or ft
    # Name of a channel of an EXR, or of an array in a file of several; also as PART/CHANNEL
    depth_channel: str | None = None
    part: int | None = None  # index, from 0, of a part of an EXR, page of a TIFF or frame of arrays
    view: str | None = None  # name of a view of an EXR with several, like left
    depth_scale: float | None = None  # factor on the numbers
    depth_kind: str | None = None  # what the numbers are: depth or disparity
    # Two distances in mm, of the least and the greatest number of the type: 0 and 255, 0 and 65535,
    # or 0 and 1. For depth, first that of the least; for disparity, first that of the greatest
    depth_range: tuple[float, float] | None = None
    focal_px: float | None = None  # focal length in px of the depth file
    baseline: float | None = None  # distance in mm between the two cameras
    # Added to the disparity: in px with a focal length and a baseline, else in 1/m
    doffs: float | None = None
    geometry: str | None = None  # radial (distance to the point) or planar (depth along the axis)
    fov: float | None = None  # horizontal field of view in degrees
    sky: float | None = None  # sky is this number and greater ones; of disparity, smaller ones
    invalid_value: float | None = None  # the number that means no depth
    invalid: str = "error"  # error, far (infinitely far) or fill (from the farther neighbour)
    # How depth of another size than its colour is resampled: nearest or guided (by the colours);
    # None refuses it
    resize_depth: str | None = None
    relative: bool = False  # whether numbers are disparity of unknown scale and offset, white near
    invert: bool | None = None  # whether black is near; only for relative disparity

    @property
    def row(self) -> DepthFormat:
        """The named format; without a name, ``disparity`` or ``metres`` by ``depth_kind``."""
        if self.depth_format is not None:
            return NAMES[self.depth_format]
        return FORMATS["disparity" if self.depth_kind == "disparity" else "metres"]

    @property
    def says_scale(self) -> bool:
        """Whether options say what the numbers mean; defaults of the file type are then unused."""
        said = (self.depth_format, self.depth_unit, self.depth_scale, self.depth_range)
        return self.relative or self.depth_kind == "disparity" or said != (None,) * 4

    @property
    def asked_by(self) -> dict[str, str]:
        """The option that chose the format, as the fields ``field`` and ``value`` of an error."""
        if self.depth_format is None:
            return {"field": "depth-kind", "value": "disparity"}
        return {"field": "depth-format", "value": self.depth_format}

    @property
    def holds_radii(self) -> bool:
        """Whether the files hold radii or relative disparity, so that no focal length is needed."""
        return self.relative or self.row.rule == "radius"

    def as_relative(self) -> Self:
        """This reading with the numbers taken as relative disparity.

        Raises:
            UsageProblem: If an option is set that gives the numbers another meaning.
        """
        for name in _OF_METRES:
            is_layout = name == "depth_format" and self.row.is_right_half
            if getattr(self, name) is not None and not is_layout:
                problem = "contradicts ‹blur›, which reads the numbers as relative disparity"
                field = self.geometry if name == "geometry" else name.replace("_", "-")
                remedy = "leave one of them out"
                raise UsageProblem("contradiction", problem, remedy, field=field or "")
        return replace(self, relative=True)

    @property
    def needs_lens(self) -> bool:
        """Whether decoding may need the lens's field of view, as no option or format gives one."""
        row = self.row
        if any(value is not None for value in (self.fov, self.focal_px, row.focal_px)):
            return False
        file_says = bool(row.radial_channels) or row.sidecar == "gdepth"
        return (self.geometry or ("radial" if file_says else row.geometry)) == "radial"


# Fields that give the numbers of a file a meaning in metres or radii.
_OF_METRES = (
    *("depth_format", "depth_unit", "depth_scale", "depth_kind", "depth_range", "focal_px"),
    *("baseline", "doffs", "geometry", "fov", "sky"),
)
AS_IT_IS = DepthReading()


MOST_STRETCHED = 0.02  # greatest change of aspect: networks round sizes to 14, 32 or 64 px


def stretched(size: tuple[int, int], target: tuple[int, int]) -> float | None:
    """The relative change of aspect from one (width, height) to another; None if it is over 2 %."""
    (columns, rows), (width, height) = size, target
    if abs(width * rows - height * columns) <= max(*size, *target):
        return 0.0
    share = width * rows / (height * columns) - 1
    return share if abs(share) <= MOST_STRETCHED else None


def require_size(
    path: Path, reading: DepthReading, shape: tuple[int, ...], size: tuple[int, int] | None
) -> None:
    """Refuse depth of another size than its colour, unless it can be resized.

    `shape`: of the depth, rows and columns first; `size`: (width, height) of the colour, or None.
    Smaller depth of the same aspect passes, and any depth if the reading says how to resize.
    """
    rows, columns = shape[:2]
    if size is None or (columns, rows) == size or reading.resize_depth is not None:
        return
    smaller = columns < size[0] and rows < size[1]
    if not smaller or stretched((columns, rows), size) is None:
        raise wrong_size(path, (rows, columns), size)


def wrong_size(path: Path, shape: tuple[int, int], size: tuple[int, int]) -> InputError:
    """The error for depth of (rows, columns) `shape` whose colour has (width, height) `size`."""
    rows, columns = shape
    problem = f"is {columns}x{rows} px but its colour is {size[0]}x{size[1]} px"
    remedy = "give depth of the size of the colour, or give ‹resize-depth› guided, or nearest"
    if stretched((columns, rows), size) is None:
        problem = f"{problem}, of another aspect"
        remedy = "give depth of the view that the colour shows, all of it"
        if stretched((rows, columns), size) is not None:
            remedy = "turn the depth as Exif turns the colour"
    return InputError("wrong-size", problem, remedy, path=path)


class Mark(NamedTuple):
    """Pixels whose depth is set by another channel or file."""

    pixels: NDArray[np.bool_]  # [H, W]
    depth: float  # inf is sky, NaN no depth
    words: str  # a note for people; may be empty


@dataclass(frozen=True)
class DepthNumbers:
    """The numbers of a depth file before they are decoded."""

    path: Path  # the file
    values: Any  # [H, W], of the type that they have in the file
    type: str  # type of the file and its numbers, as in `DepthFormat.files`
    words: str  # the same in words, for people
    channel: str = ""  # name of the channel or array; empty where it has none
    metadata: Mapping[str, Any] = field(default_factory=dict)  # of the file, by key
    marks: tuple[Mark, ...] = ()  # applied in order, so that a later mark wins
    data_window: str = ""  # its data window in words, if it does not cover the picture
    # The greatest number of the file's type, if it has fewer bits than the type of `values`
    greatest: int | None = None
    is_deep: bool = False  # whether the numbers are of the nearest samples of deep pixels

    @property
    def width(self) -> int:
        """The width in px."""
        return int(self.values.shape[1])

    @property
    def top(self) -> float:
        """The greatest number of the file's type: 255, 65535, …; 1 for floats."""
        dtype = np.dtype(self.values.dtype)
        if dtype.kind == "f":
            return 1.0
        return float(np.iinfo(dtype).max if self.greatest is None else self.greatest)

    @property
    def is_half(self) -> bool:
        """Whether the numbers are floats of 16 bits."""
        return bool(np.dtype(self.values.dtype).newbyteorder("=") == np.float16)

    @property
    def is_integer(self) -> bool:
        """Whether the numbers are integers."""
        return self.values.dtype.kind in "iu"

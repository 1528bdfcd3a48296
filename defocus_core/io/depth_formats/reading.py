"""How a depth file is to be read: all that a user may say of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.depth_formats.rules import DepthFormat
from defocus_core.io.depth_formats.table import FORMATS, NAMES
from defocus_core.io.safe_files import is_heic, is_jpeg, read_head

KINDS = ("depth", "disparity")
GEOMETRIES = ("radial", "planar")
INVALID = ("error", "far", "fill")
RESIZES = ("nearest", "guided")
UNPREMULTIPLY = ("auto", "on", "off")
_XMP_BYTES = 1 << 17  # of a JPEG, which begins with it


def holds_gdepth(path: Path) -> bool:
    """Whether a file is a JPEG whose XMP has GDepth."""
    head = read_head(path, _XMP_BYTES)
    return is_jpeg(head) and b"GDepth:" in head


def holds_depth(path: Path) -> bool:
    """Whether a file is a photograph of a kind that has depth inside it."""
    return is_heic(read_head(path)) or holds_gdepth(path)


def own_format(path: Path) -> str:
    """The format of the depth inside a photograph; empty if it has none."""
    if holds_gdepth(path):
        return "android-gdepth"
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
    focal_px: float | None = None  # focal length of the picture in px
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


def require_size(
    path: Path, reading: DepthReading, shape: tuple[int, ...], size: tuple[int, int] | None
) -> None:
    """Refuse depth of another size than its colour, before it is read, if it is not to be resized.

    `size`: width and height of the colour, None if there is none.
    """
    rows, columns = (-(-length // reading.row.stride) for length in shape[:2])
    if size is not None and reading.resize_depth is None and (columns, rows) != size:
        raise wrong_size(path, (rows, columns), size)


def wrong_size(path: Path, shape: tuple[int, int], size: tuple[int, int]) -> InputError:
    """The error for depth of rows and columns beside a colour of a width and a height."""
    problem = f"is {shape[1]}x{shape[0]} px but its colour is {size[0]}x{size[1]} px"
    if shape == size:
        remedy = "turn one of them; or say ‹turn-depth› if Exif turned the colour alone"
        return InputError("wrong-size", f"{problem}, turned", remedy, path=path)
    remedy = "give depth of the size of the colour, or say ‹resize-depth› guided, or nearest"
    return InputError("wrong-size", problem, remedy, path=path)

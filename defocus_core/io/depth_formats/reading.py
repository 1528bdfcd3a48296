"""How a depth file is to be read: all that a user may say of it."""

from __future__ import annotations

from dataclasses import dataclass

from defocus_core.io.depth_formats.rules import DepthFormat
from defocus_core.io.depth_formats.table import FORMATS, NAMES

KINDS = ("depth", "disparity")
GEOMETRIES = ("radial", "planar")
INVALID = ("error", "far", "fill")
RESIZES = ("nearest", "guided")
UNPREMULTIPLY = ("auto", "on", "off")


@dataclass(frozen=True, kw_only=True)
class DepthReading:
    """What a user says of depth files; None leaves it to the format or to the type of file.

    Attributes:
        depth_format: name of a row of the table.
        depth_unit: unit of the numbers: mm, cm, m or ft.
        depth_channel: which channel of an EXR, or array of a container; PART/CHANNEL works too.
        part: which part of an EXR, page of a TIFF or frame of an array, from 0.
        view: which view of an EXR of several, like left.
        depth_scale: multiplies the numbers.
        depth_kind: whether they are depth or disparity.
        depth_range: the distances in mm of the ends of the number's type, 0 and 255 or 65535, or 0
            and 1: of depth, the distance of 0, then of the top; of disparity, that of the top,
            then of 0.
        focal_px: focal length of the picture in px.
        baseline: distance in mm between the two cameras.
        doffs: px added to the disparity; without focal length and baseline, 1/m.
        geometry: radial (distance to the point) or planar (depth along the axis).
        fov: horizontal field of view in degrees.
        sky: numbers from this one on are sky; of disparity, up to this one.
        invalid: error, far (infinitely far) or fill (from the farther neighbour).
        unpremultiply_depth: whether the numbers are divided by alpha: on, off, or auto, where edges
            show that they are multiplied by it.
        resize_depth: nearest or guided (by the colours), where depth of another size than the
            colour is to be resampled.
    """

    depth_format: str | None = None
    depth_unit: str | None = None
    depth_channel: str | None = None
    part: int | None = None
    view: str | None = None
    depth_scale: float | None = None
    depth_kind: str | None = None
    depth_range: tuple[float, float] | None = None
    focal_px: float | None = None
    baseline: float | None = None
    doffs: float | None = None
    geometry: str | None = None
    fov: float | None = None
    sky: float | None = None
    invalid: str = "error"
    unpremultiply_depth: str = "auto"
    resize_depth: str | None = None

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
            self.depth_format is not None
            or self.depth_unit is not None
            or self.depth_scale is not None
            or self.depth_range is not None
            or self.depth_kind == "disparity"
        )

    @property
    def holds_radii(self) -> bool:
        """Whether the files hold radii, so that no lens is needed but the shape of its opening."""
        return self.row.rule == "radius"

    @property
    def needs_lens(self) -> bool:
        """Whether the lens itself may have to say the field of view of the picture."""
        row = self.row
        if any(value is not None for value in (self.fov, self.focal_px, row.focal_px)):
            return False
        file_says = bool(row.radial_channels) or row.sidecar == "gdepth"
        geometry = self.geometry or row.geometry
        return geometry == "radial" or (file_says and self.geometry is None)


AS_IT_IS = DepthReading()

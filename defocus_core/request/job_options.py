"""The tables of the options of a job that are not lens options.

The same option names serve the command line and the tables ``[reading]``, ``[inputs]``,
``[animate]``, ``[shot]``, ``[outputs]`` and ``[machine]`` of jobs files. Lens files may contain
options of ``[reading]``, too. The flags ``radial`` and ``planar`` both set the field ``geometry``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial

from defocus_core.allowed_values import DEPTH_REPAIRS, MIN_TILE, QUALITIES, WIDEST_EDGE
from defocus_core.errors import UsageProblem
from defocus_core.io.depth_formats.reading import INVALID, RESIZES
from defocus_core.io.depth_formats.reading import KINDS as DEPTH_KINDS
from defocus_core.io.depth_formats.table import NAMES, UNITS
from defocus_core.io.shots.frame_patterns import MISSING
from defocus_core.request import quantities
from defocus_core.request.job import DEVICES, Machine, Outputs
from defocus_core.request.output_kinds import (
    COLOR_SPACES,
    COMPRESSIONS,
    FORMAT_ALIASES,
    KINDS,
    LOSSY,
    MAP_FORMATS,
    MAPS,
    SUFFIXES,
    UNWRITTEN,
    compression,
    format_of_file,
    is_picture_name,
)
from defocus_core.request.parameters import Param
from defocus_core.request.quantities import always, one_of, quantity, several, switch, whole_within

_edge_width = quantity(
    "the width of an edge", "like 8px", {"": 1, "px": 1}, least=0, most=WIDEST_EDGE
)


_FORMAT = one_of(NAMES, otherwise="'defocus help depth' lists all of them")


@dataclass(frozen=True, kw_only=True)
class ReadingParam(Param):
    """An option for reading input files."""

    heading: str = "Files"
    of_pictures: bool = False  # whether it needs a picture or a lens, not a depth file alone
    of_render: bool = False  # whether it needs outputs


_READING = (
    ReadingParam(
        name="depth-format",
        is_common=True,
        parse=lambda text: _FORMAT(text.lower()),
        metavar="NAME",
        help="Format of the depth file, like kitti; 'defocus help depth' lists all formats.",
    ),
    ReadingParam(
        name="depth-unit",
        choices=tuple(UNITS),
        help="Unit of the depth.  [default: m; mm in 16-bit PNG]",
        is_common=True,
    ),
    ReadingParam(
        name="depth-scale",
        parse=quantities.scale,
        metavar="FACTOR",
        help="Factor by which the numbers of the depth file are multiplied, like 1/256.",
    ),
    ReadingParam(
        name="depth-kind",
        choices=DEPTH_KINDS,
        help="Meaning of the numbers in the depth file. [default: depth]",
        is_common=True,
    ),
    ReadingParam(
        name="depth-range",
        is_common=True,
        parse=quantities.distances,
        words=2,
        metavar="NEAR FAR",
        help="Distances of the least and the greatest value of the number type: 0 and 255 or "
        "65535, or 0 and 1. In depth, 0 is NEAR; in disparity, 0 is FAR. Give them in the other "
        "order if the file is reversed.",
        unit="mm",
        separator=" ",
    ),
    ReadingParam(
        name="focal-px",
        parse=quantities.pixel_count,
        metavar="PX",
        help="Focal length in px of the depth file, for disparity and for ‹radial›.",
    ),
    ReadingParam(
        name="baseline",
        parse=quantities.distance,
        metavar="LENGTH",
        help="Distance between the two cameras of a stereo pair, for disparity, like 65mm.",
        unit="mm",
    ),
    ReadingParam(
        name="doffs",
        parse=quantities.number,
        metavar="PX",
        help="Offset in px that is added to disparity: the difference of the two principal points.",
    ),
    ReadingParam(
        name="radial",
        stored_as="geometry",
        flag=True,
        parse=always("radial"),
        help="The numbers are distances to the camera's centre, not along the axis.",
    ),
    ReadingParam(
        name="planar",
        stored_as="geometry",
        flag=True,
        parse=always("planar"),
        help="The numbers are depth along the optical axis.",
        instead_of="radial",
    ),
    ReadingParam(
        name="invert",
        is_common=True,
        toggle=True,
        parse=switch,
        help="Whether black is near in relative disparity, with ‹blur›.  [default: no; for one "
        "photograph, found from its depth]",
        of_pictures=True,
    ),
    ReadingParam(
        name="fov",
        parse=quantities.field_of_view,
        metavar="DEG",
        help="Horizontal field of view, for ‹radial›.  [default: the lens's]",
    ),
    ReadingParam(
        name="sky",
        parse=quantities.number,
        metavar="NUMBER",
        help="Numbers that are sky: of depth, this and greater ones; of disparity, this and less.",
    ),
    ReadingParam(
        name="invalid-value",
        parse=quantities.number,
        metavar="NUMBER",
        help="This number means no depth, like 65535.",
    ),
    ReadingParam(
        name="invalid",
        choices=INVALID,
        help="Treatment of pixels without depth: an error, infinitely far, or filled from the "
        "farther neighbour.  [default: error]",
    ),
    ReadingParam(
        name="resize-depth",
        choices=RESIZES,
        help="Resize depth whose size is not that of the colour: nearest pixel, or guided, with "
        "edges where the colours change.  [default: guided, for smaller depth of the same aspect]",
        of_pictures=True,
    ),
    ReadingParam(
        name="depth-repair",
        choices=DEPTH_REPAIRS,
        help="auto repairs depth that is noisy, anti-aliased, soft at edges or of few levels; off "
        "uses it as it is.  [default: auto]",
        of_pictures=True,
    ),
    ReadingParam(
        name="edge-width",
        parse=_edge_width,
        metavar="PX",
        help="Width of the softest edges of the depth, like 8px; 0 if edges are hard.  "
        "[default: measured]",
        of_pictures=True,
    ),
    ReadingParam(
        name="depth-channel",
        metavar="NAME",
        help="Depth channel of an EXR, or array of an NPZ or HDF5.",
    ),
    ReadingParam(
        name="color-layer", metavar="NAME", help="Colour layer of an EXR.", of_pictures=True
    ),
    ReadingParam(
        name="blur-channels",
        parse=several(str),
        metavar="NAME,…",
        help="Further EXR channels to blur with the picture, like diffuse.*; others are copied.",
        separator=",",
        of_pictures=True,
        of_render=True,
    ),
    ReadingParam(
        name="part",
        parse=quantities.whole,
        metavar="N",
        help="Part of an EXR, page of a TIFF or frame of an array, counted from 0.",
    ),
    ReadingParam(
        name="view",
        metavar="NAME",
        help="View of a multi-view EXR, like left; 'defocus render' takes several, left,right. "
        "[default: the first of the file]",
    ),
)
READING_OPTIONS: Mapping[str, ReadingParam] = {row.name: row for row in _READING}


def image_format(text: str) -> str:
    """Parse an image format; ``jpeg`` and ``tif`` are accepted for ``jpg`` and ``tiff``."""
    return one_of(tuple(SUFFIXES), "unknown-name")(FORMAT_ALIASES.get(text, text))


@dataclass(frozen=True, kw_only=True)
class OutputParam(Param):
    """An option for writing outputs."""

    heading: str = "Output"
    suits: Callable[[Outputs], bool] = lambda _: True  # whether it applies to the outputs
    idle: str = ""  # the problem if it does not apply, with ``{format}``
    remedy: str = "leave it out"


_ROWS = (
    OutputParam(
        name="outputs",
        key="kinds",
        stored_as="kinds",
        is_common=True,
        parse=several(one_of(KINDS, "unknown-name")),
        metavar="KIND,…",
        help=f"Kinds of output to write: {', '.join(KINDS)}.  [default: render]",
        separator=",",
    ),
    OutputParam(
        name="format",
        is_common=True,
        parse=image_format,
        choices=tuple(SUFFIXES),
        help=f"File type of the images; maps ({', '.join(MAPS)}) are always float.  "
        "[default: exr, or that of the file -o]",
    ),
    OutputParam(
        name="map-format",
        choices=MAP_FORMATS,
        help="File type of the maps: EXR, or float TIFF, which more image libraries read.  "
        "[default: exr]",
    ),
    OutputParam(
        name="exr-type",
        choices=("half", "float"),
        help=f"Number type of EXR images.  [default: {Outputs.exr_type}]",
        suits=lambda outputs: outputs.format == "exr",
        idle="has no effect on {format}",
        remedy="leave it out, or write the format exr",
    ),
    OutputParam(
        name="color-space",
        choices=COLOR_SPACES,
        help="Convert images other than EXR to sRGB.  [default: keep the colour file's profile]",
        suits=lambda outputs: outputs.format != "exr",
        idle="has no effect on {format}, which is linear",
    ),
    OutputParam(
        name="compression",
        parse=compression,
        metavar="CODEC",
        help=f"EXR compression: {', '.join(COMPRESSIONS)} (that of the colour file). dwaa:45 sets "
        f"a level and is lossy.  [default: {Outputs.compression}]",
        suits=lambda outputs: any(n.lower().endswith(".exr") for n in outputs.names("").values()),
        idle="is for EXR, and no EXR is written",
    ),
    OutputParam(
        name="jpeg-quality",
        parse=whole_within(1, 100),
        metavar="1…100",
        help=f"Quality of JPEG and WEBP images.  [default: {Outputs.jpeg_quality}]",
        suits=lambda outputs: outputs.format in LOSSY,
        idle="has no effect on {format}",
        remedy="leave it out, or write the format jpg",
    ),
    OutputParam(
        name="preview",
        is_common=True,
        flag=True,
        parse=always(True),
        help="Also write OUT/<kind>/<stem>.preview.png to look at.",
    ),
    OutputParam(
        name="keep-overscan",
        flag=True,
        parse=always(True),
        help="Also write the pixels of an EXR beyond its display window. They are blurred in any "
        "case.",
    ),
    OutputParam(
        name="inputs",
        only="files",
        choices=("copy",),
        help="Also write the sharp picture and its depth, kinds image and depth.",
    ),
)
OUTPUT_OPTIONS: Mapping[str, OutputParam] = {row.name: row for row in _ROWS}
_shot, _file, _machine = (partial(Param, heading=h) for h in ("Shot", "Files", "Machine"))
_SHOT = (
    _shot(
        name="steady",
        toggle=True,
        parse=switch,
        help="Decide the repair of depth, and a focus that depends on depth, once for the shot "
        "instead of for each frame.  [default: steady]",
    ),
)
SHOT_OPTIONS = {row.name: row for row in _SHOT}
_INPUTS = (
    *(
        Param(name=name, only="files", is_path=True)
        for name in ("color", "depth", "hidden-depth", "holdout-depth")
    ),
    _file(
        name="hidden",
        key="hidden-color",
        words=2,
        is_path=True,
        metavar="COLOR DEPTH",
        help="Colour and depth of the surfaces behind the visible ones. Depth inf with colour 0 is "
        "unknown and is invented; inf with colour is sky.",
    ),
    _file(
        name="over",
        key="over-color",
        is_path=True,
        metavar="PLATE",
        help="Plate behind the element COLOR; both are blurred as one scene. Its depth comes from "
        "‹over-depth› or from the EXR; without either it is infinitely far.",
    ),
    _file(name="over-depth", is_path=True, metavar="DEPTH", help="Depth of the plate."),
    _file(
        name="holdout",
        key="holdout-color",
        is_path=True,
        metavar="DEEP",
        help="Deep EXR that hides what is behind its samples and is not shown, like objects "
        "composited later.",
    ),
    _file(
        name="matte",
        is_path=True,
        metavar="FILE",
        help="Coverage of the near subject, 0 to 1, as grey or alpha, like that of a portrait "
        "mode. Its silhouette becomes the edge of the depth, and hair is separated from the "
        "background.",
    ),
    _shot(
        name="frames",
        metavar="LIST",
        help="Frames of patterns like 'shot.####.exr': 1001-1240, 1001-1240x2, 1001,1005.  "
        "[default: all that are there]",
    ),
    _shot(
        name="missing",
        choices=MISSING,
        help="Treatment of pictures and frames without one of their files: an error, or skipped.  "
        "[default: error]",
    ),
    Param(name="list", only="files"),
    Param(name="pictures", only="files"),
)
INPUT_OPTIONS = {row.name: row for row in _INPUTS}
_ANIMATE = (
    Param(
        name="animate",
        key="file",
        heading="Lens",
        multiple=True,
        metavar="FILE",
        help="Lens options by frame: a CSV with columns like frame,focus,fnumber, or a "
        "TOML.  ('defocus help shots')",
    ),
)
ANIMATION_OPTIONS = {row.name: row for row in _ANIMATE}
MAX_THREADS = 1024  # more than one picture can use
_MAX_TILE = 1 << 14  # px
_MACHINE = (
    _machine(
        name="quality",
        choices=QUALITIES,
        help=f"Accuracy; higher takes longer.  [default: {Machine.quality}]",
        is_common=True,
    ),
    _machine(
        name="device",
        only="commands",
        choices=DEVICES,
        help=f"Where to compute; auto takes a GPU if there is one.  [default: {Machine.device}]",
    ),
    _machine(
        name="threads",
        only="commands",
        parse=whole_within(1, MAX_THREADS),
        metavar="N",
        help="Threads to compute with.  [default: one for each core]",
    ),
    _machine(
        name="memory",
        only="commands",
        parse=quantities.byte_count,
        metavar="SIZE",
        help="Memory limit of a process, like 2GB; pictures that need more are refused.  "
        "[default: most of what is free]",
    ),
    _machine(
        name="tile",
        only="commands",
        parse=whole_within(MIN_TILE, _MAX_TILE),
        metavar="PX",
        help=f"Side of the tiles in px, at least {MIN_TILE}; it changes the last digits.",
    ),
)
MACHINE_OPTIONS = {row.name: row for row in _MACHINE}
# The tables of jobs files, and their options.
TABLES: Mapping[str, Mapping[str, Param]] = {
    **{"inputs": INPUT_OPTIONS, "animate": ANIMATION_OPTIONS, "shot": SHOT_OPTIONS},
    **{"outputs": OUTPUT_OPTIONS, "machine": MACHINE_OPTIONS},
}


def in_one_file(outputs: Outputs, given: Collection[str]) -> Outputs:
    """Outputs with `file` and format set, if the root is the path of a file; else unchanged.

    ``given`` has the names of the fields that the user set.

    Raises:
        UsageProblem: The file type or the other options do not allow a single file.
    """
    path = outputs.root
    if path.is_dir():
        return outputs
    if path.suffix.lower() in UNWRITTEN:
        remedy = f"end its name in {', '.join(dict.fromkeys(SUFFIXES.values()))}"
        raise UsageProblem("wrong-type", "is of a type that is not written", remedy, path=path)
    if not is_picture_name(path.suffix):
        return outputs
    if outputs.preview:
        remedy = "leave it out, or name a directory"
        raise UsageProblem("contradiction", f"stands beside -o {path}", remedy, field="preview")
    if len(outputs.kinds) > 1:
        problem, remedy = f"are several, -o {path} is one", "name one kind, or a directory"
        raise UsageProblem("contradiction", problem, remedy, field="outputs")
    kind = outputs.rows[0]
    field = "format" if kind.image else "map_format"
    asked = getattr(outputs, field) if field in given else None
    format = format_of_file(kind, path.suffix, asked)
    if format is None:
        problem = f"cannot hold {kind.name}{f' as {asked}' if asked else ''}"
        raise UsageProblem("wrong-type", problem, "give it another suffix", path=path)
    outputs = replace(outputs, root=path.parent, file=path.name)
    return replace(outputs, format=format) if kind.image else replace(outputs, map_format=format)

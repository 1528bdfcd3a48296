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
        help="Format of the depth file, by its name, like kitti; 'defocus help depth' lists all "
        "names.",
    ),
    ReadingParam(
        name="depth-unit",
        choices=tuple(UNITS),
        help="Unit of the numbers in the depth file.  [default: m; mm in 16-bit PNG]",
        is_common=True,
    ),
    ReadingParam(
        name="depth-scale",
        parse=quantities.scale,
        metavar="FACTOR",
        help="Multiply the numbers of the depth file by this factor, like 0.001 or 1/256.  "
        "[default: 1]",
    ),
    ReadingParam(
        name="depth-kind",
        choices=DEPTH_KINDS,
        help="What the numbers in the depth file are: depth, or disparity (1/depth).  [default: "
        "depth]",
        is_common=True,
    ),
    ReadingParam(
        name="depth-range",
        is_common=True,
        parse=quantities.distances,
        words=2,
        metavar="NEAR FAR",
        help="Distances that the ends of the number range stand for, like 2m 50m. The ends are 0 "
        "and 255 in files of 8 bits, 0 and 65535 of 16 bits, 0 and 1 in float. Depth: 0 is "
        "NEAR. Disparity: 0 is FAR. If the file has it the other way round, give FAR NEAR.",
        unit="mm",
        separator=" ",
    ),
    ReadingParam(
        name="focal-px",
        parse=quantities.pixel_count,
        metavar="PX",
        help="Focal length in px of the depth file, like 721.5. Disparity of a stereo pair needs "
        "it, and ‹radial› can use it in place of ‹fov›.",
    ),
    ReadingParam(
        name="baseline",
        parse=quantities.distance,
        metavar="LENGTH",
        help="Distance between the two cameras of a stereo pair, like 65mm, to convert disparity "
        "to depth.",
        unit="mm",
    ),
    ReadingParam(
        name="doffs",
        parse=quantities.number,
        metavar="PX",
        help="Number of px to add to disparity before it is converted to depth: the horizontal "
        "distance between the principal points of the two cameras.  [default: 0]",
    ),
    ReadingParam(
        name="radial",
        stored_as="geometry",
        flag=True,
        parse=always("radial"),
        help="The numbers are distances from the camera to the point, not depth along the "
        "optical axis; they are converted with ‹fov›, ‹focal-px› or the lens.",
    ),
    ReadingParam(
        name="planar",
        stored_as="geometry",
        flag=True,
        parse=always("planar"),
        help="The numbers are depth along the optical axis, even if ‹depth-format› or the file "
        "says otherwise.",
        instead_of="radial",
    ),
    ReadingParam(
        name="invert",
        is_common=True,
        toggle=True,
        parse=switch,
        help="With ‹blur›: black is near, or white is near.  [default: white is near; for a "
        "single photograph, found from its depth]",
        of_pictures=True,
    ),
    ReadingParam(
        name="fov",
        parse=quantities.field_of_view,
        metavar="DEG",
        help="Horizontal field of view in degrees, like 60, for ‹radial›.  [default: that of the "
        "lens]",
    ),
    ReadingParam(
        name="sky",
        parse=quantities.number,
        metavar="NUMBER",
        help="Treat this number and all beyond it as sky, infinitely far away: greater ones in "
        "depth, smaller ones in disparity.",
    ),
    ReadingParam(
        name="invalid-value",
        parse=quantities.number,
        metavar="NUMBER",
        help="Treat this number, like 65535, as a pixel without depth; ‹invalid› says what to do "
        "with it.",
    ),
    ReadingParam(
        name="invalid",
        choices=INVALID,
        help="What to do with pixels without depth: stop with an error, take them as infinitely "
        "far, or fill them from the farther of the two neighbours in the row.  [default: "
        "error]",
    ),
    ReadingParam(
        name="resize-depth",
        choices=RESIZES,
        help="Resize depth to the size of the colour. nearest copies the nearest pixel; guided "
        "puts depth edges where the colours change.  [default: guided if the depth is "
        "smaller and of the same aspect ratio, else an error]",
        of_pictures=True,
    ),
    ReadingParam(
        name="depth-repair",
        choices=DEPTH_REPAIRS,
        help="auto finds and repairs noise, soft or displaced edges, and coarse levels in the "
        "depth; off uses the depth as it is.  [default: auto]",
        of_pictures=True,
    ),
    ReadingParam(
        name="edge-width",
        parse=_edge_width,
        metavar="PX",
        help="Width in px of the softest edges of the depth, like 8px, 0 to 100; 0 means that "
        "all edges are hard.  [default: measured in the depth]",
        of_pictures=True,
    ),
    ReadingParam(
        name="depth-channel",
        metavar="NAME",
        help="Name of the channel that holds depth in an EXR, like Z, or of the array in an NPZ "
        "or HDF5 file.  [default: found by its name]",
    ),
    ReadingParam(
        name="color-layer",
        metavar="NAME",
        help="Name of the EXR layer that holds the colour, like ViewLayer.Combined.  [default: "
        "found by its name]",
        of_pictures=True,
    ),
    ReadingParam(
        name="blur-channels",
        parse=several(str),
        metavar="NAME,…",
        help="Further EXR channels that are light, like 'diffuse.*,specular.*', to blur with the "
        "picture; all other channels are copied.",
        separator=",",
        of_pictures=True,
        of_render=True,
    ),
    ReadingParam(
        name="part",
        parse=quantities.whole,
        metavar="N",
        help="Number of the part of an EXR, of the page of a TIFF or of the frame of an array, "
        "counted from 0.",
    ),
    ReadingParam(
        name="view",
        metavar="NAME",
        help="Name of the view to read from an EXR of several cameras, like left. 'defocus "
        "render' takes several, like left,right.  [default: the first view in the file]",
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
        help=f"Kinds of output to write, separated by commas: {', '.join(KINDS)}.  [default: "
        "render]",
        separator=",",
    ),
    OutputParam(
        name="format",
        is_common=True,
        parse=image_format,
        choices=tuple(SUFFIXES),
        help=f"File type of the images; ‹map-format› is that of the maps ({', '.join(MAPS)}).  "
        "[default: exr, or that of the file -o]",
    ),
    OutputParam(
        name="map-format",
        choices=MAP_FORMATS,
        help="File type of the maps: float EXR, or float TIFF, which more image libraries read.  "
        "[default: exr]",
    ),
    OutputParam(
        name="exr-type",
        choices=("half", "float"),
        help="Number type of EXR images: half has 16 bits, float 32. Maps are always float.  "
        f"[default: {Outputs.exr_type}]",
        suits=lambda outputs: outputs.format == "exr",
        idle="has no effect on {format}",
        remedy="leave it out, or write the format exr",
    ),
    OutputParam(
        name="color-space",
        choices=COLOR_SPACES,
        help="Convert the images to sRGB. EXR stays linear.  [default: keep the colour profile "
        "of the colour file]",
        suits=lambda outputs: outputs.format != "exr",
        idle="has no effect on {format}, which is linear",
    ),
    OutputParam(
        name="compression",
        parse=compression,
        metavar="CODEC",
        help=f"Compression of EXR files: {', '.join(COMPRESSIONS)} (as in the colour file). dwaa "
        "is lossy, at level 45 unless a level is given, like dwaa:100; more is smaller.  "
        f"[default: {Outputs.compression}]",
        suits=lambda outputs: any(n.lower().endswith(".exr") for n in outputs.names("").values()),
        idle="is for EXR, and no EXR is written",
    ),
    OutputParam(
        name="jpeg-quality",
        parse=whole_within(1, 100),
        metavar="1…100",
        help=f"Quality of JPEG and WEBP images; 100 is best.  [default: {Outputs.jpeg_quality}]",
        suits=lambda outputs: outputs.format in LOSSY,
        idle="has no effect on {format}",
        remedy="leave it out, or write the format jpg",
    ),
    OutputParam(
        name="preview",
        is_common=True,
        flag=True,
        parse=always(True),
        help="Also write a PNG of each output to look at, OUT/<kind>/<stem>.preview.png.",
    ),
    OutputParam(
        name="keep-overscan",
        flag=True,
        parse=always(True),
        help="Also write the pixels of an EXR outside its display window. Without this option "
        "they take part in the blur, but are cropped.",
    ),
    OutputParam(
        name="inputs",
        only="files",
        choices=("copy",),
        help="Also write the sharp picture and its depth, as kinds image and depth.",
    ),
)
OUTPUT_OPTIONS: Mapping[str, OutputParam] = {row.name: row for row in _ROWS}
_shot, _file, _machine = (partial(Param, heading=h) for h in ("Shot", "Files", "Machine"))
_SHOT = (
    _shot(
        name="steady",
        toggle=True,
        parse=switch,
        help="Decide once for a whole shot (‹steady›), or for each frame (‹no-steady›), how to "
        "repair the depth and how far away a focus is that depends on the depth.  [default: "
        "steady]",
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
        help="Colour and depth of the surfaces that the visible ones hide. Depth inf with black "
        "means unknown: that part is invented. Depth inf with another colour is sky.",
    ),
    _file(
        name="over",
        key="over-color",
        is_path=True,
        metavar="PLATE",
        help="Picture of the background, the plate, over which to composite the element COLOR; "
        "both are blurred as one scene. Its depth is that of ‹over-depth› or of its own "
        "EXR, else infinity.",
    ),
    _file(
        name="over-depth", is_path=True, metavar="DEPTH", help="Depth file of the plate of ‹over›."
    ),
    _file(
        name="holdout",
        key="holdout-color",
        is_path=True,
        metavar="DEEP",
        help="Deep EXR of objects that hide what is behind them but are not shown; composite the "
        "output over them.",
    ),
    _file(
        name="matte",
        is_path=True,
        metavar="FILE",
        help="Picture that shows how much of each pixel the near subject covers, from 0 (black) "
        "to 1 (white), or as alpha, like the matte of a portrait mode. The depth edge moves "
        "to its outline, hair included.",
    ),
    _shot(
        name="frames",
        metavar="LIST",
        help="Frames to render of a pattern like 'shot.####.exr': 1001-1240, every second one "
        "1001-1240x2, or a list 1001,1005-1010.  [default: all frames found]",
    ),
    _shot(
        name="missing",
        choices=MISSING,
        help="What to do with a picture or frame that lacks one of its files: stop with an "
        "error, or skip it.  [default: error]",
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
        help="File of lens options that change by frame: CSV with columns like "
        "frame,focus,fnumber, or TOML; 'defocus help shots' explains both.",
    ),
)
ANIMATION_OPTIONS = {row.name: row for row in _ANIMATE}
MAX_THREADS = 1024  # more than one picture can use
_MAX_TILE = 1 << 14  # px
_MACHINE = (
    _machine(
        name="quality",
        choices=QUALITIES,
        help="Accuracy of the rendering; higher quality takes longer.  [default: "
        f"{Machine.quality}]",
        is_common=True,
    ),
    _machine(
        name="device",
        only="commands",
        choices=DEVICES,
        help="Where to compute: on the CPU, on a GPU (cuda), or auto: on a GPU if there is one.  "
        f"[default: {Machine.device}]",
    ),
    _machine(
        name="threads",
        only="commands",
        parse=whole_within(1, MAX_THREADS),
        metavar="N",
        help="Number of CPU threads.  [default: one for each core]",
    ),
    _machine(
        name="memory",
        only="commands",
        parse=quantities.byte_count,
        metavar="SIZE",
        help="Memory that the process may use, like 2GB; pictures that need more are refused.  "
        "[default: 80 % of the free memory]",
    ),
    _machine(
        name="tile",
        only="commands",
        parse=whole_within(MIN_TILE, _MAX_TILE),
        metavar="PX",
        help=f"Render by torch in square tiles with a side of this number of px, {MIN_TILE} or "
        "more. Smaller tiles need less memory; the last digits of the result depend on the "
        "size.  [default: chosen by the renderer]",
    ),
)
MACHINE_OPTIONS = {row.name: row for row in _MACHINE}
# The tables of jobs files, and their options.
TABLES: Mapping[str, Mapping[str, Param]] = {
    **{"inputs": INPUT_OPTIONS, "animate": ANIMATION_OPTIONS, "shot": SHOT_OPTIONS},
    **{"outputs": OUTPUT_OPTIONS, "machine": MACHINE_OPTIONS},
}


def in_one_file(outputs: Outputs, given: Collection[str]) -> Outputs:
    """Set `file` and format of outputs if their root is the path of a file rather than a folder.

    ``given`` has the names of the fields that the user set. UsageProblem is raised if the file type
    or another option does not allow a single file.
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
        raise UsageProblem(
            "contradiction", f"is not possible for one file, -o {path}", remedy, field="preview"
        )
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

"""The tables of options of a job but those of its lens and of reading.

The command line and the tables ``[inputs]``, ``[animate]``, ``[shot]``, ``[outputs]`` and
``[machine]`` of jobs files have them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial

from defocus_core.allowed_values import MIN_TILE, QUALITIES
from defocus_core.errors import UsageProblem
from defocus_core.io.shots.frame_patterns import MISSING
from defocus_core.request.job import DEVICES, LONGEST_SMOOTH, Machine, Outputs
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
from defocus_core.request.quantities import (
    QuantityError,
    always,
    byte_count,
    one_of,
    switch,
    whole_within,
)

_word = partial(one_of, code="unknown-name")


def kinds(text: str) -> tuple[str, ...]:
    """Kinds of output, separated by commas, each once."""
    names = tuple(dict.fromkeys(word.strip() for word in text.split(",")))
    if not text:
        raise QuantityError("names no kind of output", f"choose from {', '.join(KINDS)}")
    return tuple(map(_word(tuple(KINDS)), names))


def image_format(text: str) -> str:
    """The type of image files, by either spelling of its suffix."""
    return _word(tuple(SUFFIXES))(FORMAT_ALIASES.get(text, text))


@dataclass(frozen=True, kw_only=True)
class OutputParam(Param):
    """An option of outputs."""

    heading: str = "Output"
    suits: Callable[[Outputs], bool] = lambda _: True  # whether it says anything about them
    idle: str = ""  # what is wrong where it does not, with ``{format}``
    remedy: str = "leave it out"


_ROWS = (
    OutputParam(
        name="outputs",
        key="kinds",
        stored_as="kinds",
        is_common=True,
        parse=kinds,
        metavar="KIND,…",
        help=f"What to write, of {', '.join(KINDS)}.  [default: render]",
        separator=",",
    ),
    OutputParam(
        name="format",
        is_common=True,
        parse=image_format,
        choices=tuple(SUFFIXES),
        help=f"Type of the images; maps ({', '.join(MAPS)}) are always float.  "
        "[default: exr, or that of the file -o]",
    ),
    OutputParam(
        name="map-format",
        parse=_word(MAP_FORMATS),
        choices=MAP_FORMATS,
        help="Type of the maps: EXR, or float TIFF, which image libraries read, too.  "
        "[default: exr]",
    ),
    OutputParam(
        name="exr-type",
        parse=_word(("half", "float")),
        choices=("half", "float"),
        help=f"Number type of the images' EXR.  [default: {Outputs.exr_type}]",
        suits=lambda outputs: outputs.format == "exr",
        idle="has no effect on {format}",
        remedy="leave it out, or write the format exr",
    ),
    OutputParam(
        name="color-space",
        parse=_word(COLOR_SPACES),
        choices=COLOR_SPACES,
        help="Convert what is not an EXR to sRGB.  [default: the profile that the colour has]",
        suits=lambda outputs: outputs.format != "exr",
        idle="has no effect on {format}, which is linear",
    ),
    OutputParam(
        name="compression",
        parse=compression,
        metavar="CODEC",
        help=f"Codec of EXR: {', '.join(COMPRESSIONS)} (that of the colour). dwaa:45 has a "
        f"level, and loses detail.  [default: {Outputs.compression}]",
        suits=lambda outputs: outputs.writes_exr,
        idle="is of EXR, and none is written",
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
        help="Write the pixels beyond the display window of an EXR, too; they take part in the "
        "blur in any case.",
    ),
    OutputParam(
        name="inputs",
        only="files",
        parse=_word(("copy",)),
        choices=("copy",),
        help="Also write the sharp picture and its depth, kinds image and depth.",
    ),
)
OUTPUT_OPTIONS: Mapping[str, OutputParam] = {row.name: row for row in _ROWS}
_SHOT = (
    Param(
        name="steady",
        heading="Shot",
        toggle=True,
        parse=switch,
        help="Decide once for the shot how depth is repaired and where a focus lies that the "
        "depth decides, and average noise of depth over 9 frames where the scene is still; or "
        "each frame for itself.  [default: steady]",
    ),
    Param(
        name="focus-smooth",
        heading="Shot",
        parse=whole_within(2, LONGEST_SMOOTH),
        metavar="N",
        help="Average a focus that the depth decides over N frames, in disparity, like 9.",
    ),
    Param(
        name="motion",
        heading="Shot",
        metavar="LAYER",
        help="Layer of motion vectors, like ViewLayer.Vector of Blender, or forward of Nuke: "
        "what other frames have seen of what is hidden is not invented.",
    ),
)
SHOT_OPTIONS = {row.name: row for row in _SHOT}
_INPUTS = (
    *(
        Param(name=name, only="files", is_path=True)
        for name in ("color", "depth", "hidden-depth", "holdout-depth")
    ),
    Param(
        name="hidden",
        key="hidden-color",
        heading="Files",
        words=2,
        is_path=True,
        metavar="COLOR DEPTH",
        help="Colour and depth of what lies behind, where it is known: depth inf with colour 0 is "
        "unknown, and invented; inf with colour is sky.",
    ),
    Param(
        name="over",
        key="over-color",
        heading="Files",
        is_path=True,
        metavar="PLATE [DEPTH]",
        help="Plate behind the element COLOR, blurred with it as one scene. Without DEPTH it is "
        "the EXR's own, or else infinitely far.",
    ),
    Param(
        name="over-depth",
        heading="Files",
        is_path=True,
        metavar="DEPTH",
        help="Depth of the plate.",
    ),
    Param(
        name="holdout",
        key="holdout-color",
        heading="Files",
        is_path=True,
        metavar="DEEP",
        help="Deep EXR whose samples hide what is behind them and show nothing, like objects that "
        "are composited later: colour and alpha are cut out.",
    ),
    Param(
        name="matte",
        heading="Files",
        is_path=True,
        metavar="FILE",
        help="Coverage of the near subject, 0 to 1, in grey or alpha, as of a portrait mode: its "
        "silhouette is the edge of the depth, and hair is parted from what is behind it.",
    ),
    Param(
        name="frames",
        heading="Shot",
        metavar="LIST",
        help="Frames of patterns like 'shot.####.exr': 1001-1240, 1001-1240x2, 1001,1005; or "
        "keys, those with a key of ‹animate›.  [default: all that are there]",
    ),
    Param(
        name="missing",
        heading="Shot",
        parse=_word(MISSING),
        choices=MISSING,
        help="Frames that have no file: an error, or left out.  [default: error]",
    ),
    Param(name="list", only="files"),
    Param(name="pictures", only="files"),
)
INPUT_OPTIONS = {row.name: row for row in _INPUTS}
INTERPOLATIONS = ("linear", "ease")
_ANIMATE = (
    Param(
        name="animate",
        key="file",
        heading="Lens",
        multiple=True,
        metavar="FILE",
        help="Options of the lens by frame: CSV with columns like frame,focus,fnumber, TOML, or "
        "Nuke's .chan.  ('defocus help shots')",
    ),
    Param(
        name="interpolate",
        key="interpolation",
        heading="Lens",
        parse=_word(INTERPOLATIONS),
        choices=INTERPOLATIONS,
        help="Between keys: evenly, or slow at each key.  [default: linear]",
    ),
)
ANIMATION_OPTIONS = {row.name: row for row in _ANIMATE}
MAX_THREADS = 1024  # more than any machine has cores for one picture
_MAX_TILE = 1 << 14  # px
_MACHINE = (
    Param(
        name="quality",
        heading="Machine",
        parse=_word(QUALITIES),
        choices=QUALITIES,
        help="Accuracy, bought with time; a draft is rendered at half of the size, and what is "
        f"in focus gets its detail back.  [default: {Machine.quality}]",
        is_common=True,
    ),
    Param(
        name="device",
        only="commands",
        heading="Machine",
        parse=_word(DEVICES),
        choices=DEVICES,
        help=f"Where to compute; auto takes a GPU if there is one.  [default: {Machine.device}]",
    ),
    Param(
        name="threads",
        only="commands",
        heading="Machine",
        parse=whole_within(1, MAX_THREADS),
        metavar="N",
        help="Threads to compute with.  [default: one for each core]",
    ),
    Param(
        name="memory",
        only="commands",
        heading="Machine",
        parse=byte_count,
        metavar="SIZE",
        help="Memory a process may take, like 2GB: what is larger goes through scratch files "
        "in TMPDIR.  [default: most of what is free]",
    ),
    Param(
        name="tile",
        only="commands",
        heading="Machine",
        parse=whole_within(MIN_TILE, _MAX_TILE),
        metavar="PX",
        help=f"Side of the tiles to compute in, {MIN_TILE} at least; changes the last digits.",
    ),
)
MACHINE_OPTIONS = {row.name: row for row in _MACHINE}
# The tables of jobs files whose keys these are.
TABLES: Mapping[str, Mapping[str, Param]] = {
    **{"inputs": INPUT_OPTIONS, "animate": ANIMATION_OPTIONS, "shot": SHOT_OPTIONS},
    **{"outputs": OUTPUT_OPTIONS, "machine": MACHINE_OPTIONS},
}


def in_one_file(outputs: Outputs, given: Collection[str]) -> Outputs:
    """The outputs, of one file if their root names one; ``given``: fields that were asked for."""
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

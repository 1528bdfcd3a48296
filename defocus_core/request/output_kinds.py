"""Kinds of output, one row each, and the types of image files.

A kind is written to ``OUT/<name>/<stem>.<ext>``. An image has the channels of the colour file and
the type that ``--format`` names. A map is a float32 EXR, or TIFF, of one channel, which in an EXR
has the kind's name.

A new kind is a new row, and a line of ``help/conventions.md``; the other modules read this table. A
map that is no depth is also named in `NO_DEPTH` of `io.depth_formats.exr_depth_channel`.
"""

from __future__ import annotations

from dataclasses import dataclass

from defocus_core.errors import did_you_mean
from defocus_core.request.quantities import QuantityError, within


@dataclass(frozen=True)
class Kind:
    """A kind of output."""

    name: str  # as ``--outputs`` has it
    help: str  # a line for ``defocus render --help``
    image: bool = False  # whether it is an image; else it is a map
    # Attributes of `defocus_core.Views` that it is made of; none where it is not rendered
    rendered: tuple[str, ...] = ()
    # How it is made, a row of `defocus_core.picture.write`; empty where it is what is rendered
    source: str = ""
    channel: str = ""  # the channel of a map in an EXR, if it is not the kind's name
    title: str = ""  # what a map shows, for ``defocus info``
    unit: str = ""  # the unit of a map's values, empty for a number without one

    @property
    def halves(self) -> bool:
        """Whether it needs the views through the left and the right half of the lens."""
        return not {"left", "right"}.isdisjoint(self.rendered)

    @property
    def views(self) -> tuple[str, ...]:
        """Of an image of several, the kinds that are the views of its one EXR file."""
        return self.rendered if len(self.rendered) > 1 else ()

    @property
    def whole(self) -> bool:
        """Whether all channels are rendered: it is an image, or a part of one."""
        return self.image or bool(self.rendered and self.source)

    @property
    def signed(self) -> bool:
        """Whether its values have a sign; a preview is orange below 0, white at 0, blue above."""
        return self.source in ("radius", "disparity")

    def memory_bytes(self, channels: int, sample_bytes: int) -> int:
        """Bytes that a pixel takes in memory before it is written."""
        if not self.rendered:  # computed from the radii while it is written
            return 0
        sample_bytes = sample_bytes if self.image else 4
        return sample_bytes * len(self.rendered) * (channels if self.whole else 1)

    def suffix(self, image_format: str, map_format: str = "exr") -> str:
        """The suffix of its files where images and maps are of two formats."""
        return ".exr" if self.views else SUFFIXES[image_format if self.image else map_format]


_ROWS = (
    Kind("render", "the defocused picture", image=True, rendered=("render",)),
    Kind(
        "left", "what the left half of the lens sees (dual pixel)", image=True, rendered=("left",)
    ),
    Kind("right", "what the right half of the lens sees", image=True, rendered=("right",)),
    Kind(
        "coc",
        "signed radius of the circle of confusion in px, beyond the focus positive",
        source="radius",
        title="CoC map (signed radius, negative nearer than the focus)",
        unit="px",
    ),
    Kind(
        "disparity",
        "dual-pixel disparity in px, signed alike",
        source="disparity",
        title="disparity map (between left and right, signed like the CoC)",
        unit="px",
    ),
    Kind(
        "trust",
        "share of the lens that saw what the picture holds: 1 is nothing invented",
        rendered=("trust",),
        title="trust map (share of the lens that saw what the picture holds)",
    ),
    Kind(
        "multiview",
        "left and right as the views of one EXR",
        image=True,
        rendered=("left", "right"),
    ),
    Kind(
        "focus",
        "the picture in false colour, sharp green, nearer orange, beyond blue",
        image=True,
        source="focus",
    ),
    Kind("image", "the picture as it was given, in focus", image=True, source="color"),
    Kind(
        "depth",
        "the depth along the axis in metres, as it was given",
        source="depth",
        channel="Z",
        title="depth map",
        unit="m",
    ),
)
KINDS = {kind.name: kind for kind in _ROWS}
MAPS = tuple(kind.name for kind in _ROWS if not kind.image)
INPUTS = tuple(kind.name for kind in _ROWS if kind.source in ("color", "depth"))

PREVIEW = ".preview"  # follows the name of a kind where a preview of it is meant

# Types of image files, and the suffix of each.
SUFFIXES = {"exr": ".exr", "png": ".png", "png16": ".png", "tiff": ".tif"}
SUFFIXES |= {"jpg": ".jpg", "webp": ".webp"}
# Suffixes of pictures and films that are not written: no folder is meant by them.
_UNWRITTEN = (
    "hdr ppm pgm pbm pnm pfm tga bmp gif psd psb heic heif avif jp2 j2k jxl dds dpx cin sgi pic "
    "sxr dng cr2 cr3 nef arw raf ico svg pdf eps npy npz mp4 mov avi mkv webm mxf"
)
UNWRITTEN = frozenset(f".{word}" for word in _UNWRITTEN.split())
PICTURES = frozenset(SUFFIXES.values()) | UNWRITTEN
LOSSY = ("jpg", "webp")  # which have a quality
MAP_FORMATS = ("exr", "tiff")
COLOR_SPACES = ("srgb",)
COMPRESSIONS = ("none", "zips", "zip", "piz", "dwaa", "input")
_MAX_LEVEL = 1e6  # of dwaa; 45 is its own
FORMAT_ALIASES = {"jpeg": "jpg", "tif": "tiff"}


def compression(text: str) -> str:
    """A codec of EXR files like ``zip`` or ``dwaa:100``, or ``input``."""
    name, colon, level = text.strip().lower().partition(":")
    if name not in COMPRESSIONS or (colon and name != "dwaa"):
        remedy = f"choose from {', '.join(COMPRESSIONS)}; or dwaa:LEVEL"
        raise QuantityError(f"'{text}' is not a codec", did_you_mean(name, COMPRESSIONS, remedy))
    if not colon:
        return name
    value = within(0, _MAX_LEVEL, "a level of dwaa", "like dwaa:45")(level)
    return f"dwaa:{value:g}"


def format_of_file(kind: Kind, suffix: str, given: str | None) -> str | None:
    """The format of the one file of a kind, by its suffix; None if it cannot have that suffix.

    `given`: the format that was asked for, None for any.
    """
    word = suffix.lower().removeprefix(".")
    word = FORMAT_ALIASES.get(word, word)
    named = [name for name, end in SUFFIXES.items() if end == SUFFIXES.get(word)]
    known = ("exr",) if kind.views else (*SUFFIXES,) if kind.image else MAP_FORMATS
    fitting = [name for name in named if name in known and given in (None, name)]
    return fitting[0] if fitting else None


def is_picture_name(suffix: str) -> bool:
    """Whether a suffix is one of pictures that are written."""
    word = suffix.lower().removeprefix(".")
    return f".{word}" in SUFFIXES.values() or word in FORMAT_ALIASES

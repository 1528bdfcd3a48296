"""The table of the kinds of output, and the types of image files.

A kind is an image or a map. Images have the channels of the colour file and the file type
``--format``. Maps are float32 EXR or TIFF files of one channel; in an EXR, the channel has the name
of the kind unless its row names another.
"""

from __future__ import annotations

from dataclasses import dataclass

from defocus_core.errors import did_you_mean
from defocus_core.request.quantities import QuantityError, quantity


@dataclass(frozen=True)
class Kind:
    """A kind of output, such as render or coc."""

    name: str  # as in ``--outputs``
    help: str  # a line for ``defocus render --help``
    image: bool = False  # whether it is an image rather than a map
    # attributes of `defocus_core.Views` that it is made of; empty if it is not rendered
    rendered: tuple[str, ...] = ()
    # its row of `defocus_core.picture.write`; empty if it is written as rendered
    source: str = ""
    channel: str = ""  # the channel of a map in an EXR, if other than the kind's name
    title: str = ""  # meaning of a map, for ``defocus info``
    unit: str = ""  # the unit of a map's values, empty for a number without one

    @property
    def halves(self) -> bool:
        """Whether this kind needs the views through the left and the right half of the lens."""
        return not {"left", "right"}.isdisjoint(self.rendered)

    @property
    def views(self) -> tuple[str, ...]:
        """The names of the views in a multi-view EXR of this kind; empty for other files."""
        return self.rendered if len(self.rendered) > 1 else ()

    @property
    def whole(self) -> bool:
        """Whether this kind has all channels of the picture; a map, for one, has a single one."""
        return self.image or bool(self.rendered and self.source)

    @property
    def signed(self) -> bool:
        """Whether values have a sign; previews show negative ones in orange, positive in blue."""
        return self.source in ("radius", "disparity")

    def memory_bytes(self, channels: int, sample_bytes: int) -> int:
        """Bytes per pixel that the output of this kind takes in memory until it is written.

        `channels` is the number of colour channels, `sample_bytes` the bytes of an image sample.
        """
        if not self.rendered:  # computed from the radii while it is written
            return 0
        sample_bytes = sample_bytes if self.image else 4
        return sample_bytes * len(self.rendered) * (channels if self.whole else 1)

    def suffix(self, image_format: str, map_format: str = "exr") -> str:
        """The suffix of files of this kind, like ``.exr``, for given formats of images and maps."""
        return ".exr" if self.views else SUFFIXES[image_format if self.image else map_format]


_ROWS = (
    Kind("render", "the defocused picture", image=True, rendered=("render",)),
    Kind(
        "left",
        "the picture through the left half of the lens (dual pixel)",
        image=True,
        rendered=("left",),
    ),
    Kind(
        "right", "the picture through the right half of the lens", image=True, rendered=("right",)
    ),
    Kind(
        "coc",
        "signed radius of the blur in px: negative nearer than the focus, positive beyond",
        source="radius",
        title="CoC map (signed radius, negative nearer than the focus)",
        unit="px",
    ),
    Kind(
        "disparity",
        "shift between left and right in px, with the sign of coc",
        source="disparity",
        title="disparity map (between left and right, signed like the CoC)",
        unit="px",
    ),
    Kind(
        "trust",
        "share of the lens that saw known content, 0 to 1; 1 where nothing is invented",
        rendered=("trust",),
        title="trust map (share of the lens that saw content of the picture)",
    ),
    Kind(
        "multiview",
        "left and right as two views in one EXR",
        image=True,
        rendered=("left", "right"),
    ),
    Kind(
        "focus",
        "false colours: green in focus, orange nearer, blue beyond",
        image=True,
        source="focus",
    ),
    Kind("image", "the input picture, sharp", image=True, source="color"),
    Kind(
        "depth",
        "the input depth, in metres along the optical axis",
        source="depth",
        channel="Z",
        title="depth map",
        unit="m",
    ),
)
KINDS = {kind.name: kind for kind in _ROWS}
MAPS = tuple(kind.name for kind in _ROWS if not kind.image)
INPUTS = tuple(kind.name for kind in _ROWS if kind.source in ("color", "depth"))

PREVIEW = ".preview"  # suffix of the name of a kind for its preview

# Types of image files, and the suffix of each.
SUFFIXES = {"exr": ".exr", "png": ".png", "png16": ".png", "tiff": ".tif"}
SUFFIXES |= {"jpg": ".jpg", "webp": ".webp"}
# Suffixes of pictures and films that are not written, but do not name folders.
_UNWRITTEN = (
    "hdr ppm pgm pbm pnm pfm tga bmp gif psd psb heic heif avif jp2 j2k jxl dds dpx cin sgi pic "
    "sxr dng cr2 cr3 nef arw raf ico svg pdf eps npy npz mp4 mov avi mkv webm mxf"
)
UNWRITTEN = frozenset(f".{word}" for word in _UNWRITTEN.split())
PICTURES = frozenset(SUFFIXES.values()) | UNWRITTEN
LOSSY = ("jpg", "webp")  # formats with a quality
MAP_FORMATS = ("exr", "tiff")
COLOR_SPACES = ("srgb",)
COMPRESSIONS = ("none", "zips", "zip", "piz", "dwaa", "input")
_MAX_LEVEL = 1e6  # levels of dwaa, by default 45
FORMAT_ALIASES = {"jpeg": "jpg", "tif": "tiff"}


def compression(text: str) -> str:
    """Parse an EXR codec, like ``zip``, ``dwaa:100`` or ``input`` (that of the colour file)."""
    name, colon, level = text.strip().lower().partition(":")
    if name not in COMPRESSIONS or (colon and name != "dwaa"):
        remedy = f"choose from {', '.join(COMPRESSIONS)}; or dwaa:LEVEL"
        raise QuantityError(f"'{text}' is not a codec", did_you_mean(name, COMPRESSIONS, remedy))
    if not colon:
        return name
    value = quantity("a level of dwaa", "like dwaa:45", least=0, most=_MAX_LEVEL)(level)
    return f"dwaa:{value:g}"


def format_of_file(kind: Kind, suffix: str, given: str | None) -> str | None:
    """The format, like png16, of a file with this suffix; None if this kind cannot have it.

    `given` is the format that the user requested, if any; it must have this suffix.
    """
    word = suffix.lower().removeprefix(".")
    word = FORMAT_ALIASES.get(word, word)
    named = [name for name, end in SUFFIXES.items() if end == SUFFIXES.get(word)]
    known = ("exr",) if kind.views else (*SUFFIXES,) if kind.image else MAP_FORMATS
    fitting = [name for name in named if name in known and given in (None, name)]
    return fitting[0] if fitting else None


def is_picture_name(suffix: str) -> bool:
    """Whether a suffix is that of an image format that can be written; such a path names a file."""
    word = suffix.lower().removeprefix(".")
    return f".{word}" in SUFFIXES.values() or word in FORMAT_ALIASES

"""A job: one picture, the lens that takes it, what to write and how to compute it.

Pictures are named by the stem of their colour file; a job writes ``OUT/<kind>/<stem>.<ext>``.
Nothing here opens a file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from defocus_cli.draws import Draw
from defocus_cli.errors import InputError
from defocus_cli.files import missing

IMAGE_KINDS = ("render", "left", "right")
MAP_KINDS = ("coc", "disparity", "trust")
RENDERED_KINDS = (*IMAGE_KINDS, "trust")
KINDS = IMAGE_KINDS + MAP_KINDS
SUFFIXES = {"exr": ".exr", "png": ".png", "png16": ".png", "tiff": ".tif", "jpg": ".jpg"}
COLOR_SUFFIXES = frozenset({".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff"})
DEPTH_SUFFIXES = frozenset({".exr", ".pfm", ".npy", ".png", ".tif", ".tiff"})
SCENE_SUFFIXES = frozenset({".exr"})
PREVIEW = ".preview"


@dataclass(frozen=True)
class Picture:
    """Where colour and depth of one picture are; the same file twice when one EXR holds both.

    `hidden` is a picture of what lies behind the visible surface, where that is known.
    """

    stem: str
    color: Path
    depth: Path
    hidden: Picture | None = None

    @property
    def files(self) -> dict[str, Path]:
        """Its files by role: color, depth; hidden_color, hidden_depth if it has any."""
        files = {"color": self.color, "depth": self.depth}
        if self.hidden is not None:
            files |= {"hidden_color": self.hidden.color, "hidden_depth": self.hidden.depth}
        return files


@dataclass(frozen=True)
class Lens:
    """A thin lens, lengths in mm.

    Its focus is at ``foc_dist``, on what pixel ``focus_at`` shows, or at ``focus_percentile`` of
    the depth; ``engine.focused`` finds the distance.
    """

    foclen: float
    fnum: float
    foc_dist: float | None
    focus_at: tuple[int, int] | None = None
    sensor_width: float = 36.0
    blades: int = 0
    blade_rotation: float = 0.0
    focus_percentile: float | None = None  # 0 is the nearest pixel, 100 the farthest but the sky
    max_coc: float | None = None  # px, the greatest CoC radius with which a picture is taken
    draw: Draw | None = None  # where it is from, if it is random, and where another can be had
    # What errors name before the option of its focus: the file that has it, or dashes.
    focus_source: str = field(default="", compare=False)


@dataclass(frozen=True)
class Reading:
    """What to take from the input files."""

    depth_unit: str | None = None  # None: what the file type implies
    depth_channel: str | None = None
    color_layer: str | None = None
    part: int | None = None


@dataclass(frozen=True)
class Outputs:
    """What to write, and where."""

    root: Path
    kinds: tuple[str, ...] = ("render",)
    format: str = "exr"
    exr_type: str = "half"
    preview: bool = False
    overwrite: bool = False

    def names(self, stem: str) -> dict[str, str]:
        """The files of one picture, relative to the root: of each kind, and of kind.preview."""
        suffix = SUFFIXES[self.format]
        names = {k: f"{k}/{stem}{'.exr' if k in MAP_KINDS else suffix}" for k in self.kinds}
        if self.preview:
            names |= {f"{kind}{PREVIEW}": f"{kind}/{stem}.preview.png" for kind in self.kinds}
        return names


@dataclass(frozen=True)
class Machine:
    """How to compute: what the pictures look like depends on ``quality`` or ``tolerance``.

    Their last digits depend on ``tile`` too, and on nothing else here.
    """

    quality: str = "standard"
    tolerance: float | None = None  # px of CoC radius, instead of a quality
    device: str = "auto"
    threads: int = 1
    memory: int | None = None  # bytes for the process; None: most of what is available
    tile: int | None = None  # px on a side of a tile; None: what the renderer thinks best


@dataclass(frozen=True)
class Job:
    """One picture to render."""

    picture: Picture
    lens: Lens
    reading: Reading
    outputs: Outputs
    machine: Machine
    suffix: str = ""  # what tells this lens from the others that take the same picture

    @property
    def sample_id(self) -> str:
        """The name of what is made, and the stem of its files."""
        return self.picture.stem + self.suffix

    @property
    def names(self) -> dict[str, str]:
        """Every file this job writes, relative to the root: of each kind, and of kind.preview."""
        return self.outputs.names(self.sample_id)

    @property
    def paths(self) -> dict[str, Path]:
        """The file of each kind."""
        names, root = self.names, self.outputs.root
        return {kind: root / names[kind] for kind in self.outputs.kinds}

    @property
    def previews(self) -> dict[str, Path]:
        """The preview of each kind; empty when none are wanted."""
        names = {name: path for name, path in self.names.items() if name.endswith(PREVIEW)}
        return {name.removesuffix(PREVIEW): self.outputs.root / p for name, p in names.items()}

    @property
    def written(self) -> list[Path]:
        """Every file this job writes."""
        return [self.outputs.root / name for name in self.names.values()]


def find_pictures(color: Path, depth: Path | None) -> list[Picture]:
    """The pictures that one or two paths on the command line mean, sorted by stem.

    Args:
        color: a colour file, or a directory of them.
        depth: the depth file or directory; None if each colour EXR holds its own depth.

    Raises:
        InputError: a path is missing or of the wrong sort, or files do not pair up.
    """
    for path in (color, depth):
        if path is not None and not path.exists():
            raise missing(path, "file or directory")
    if depth is None:
        return _scenes(color)
    if color.is_dir() != depth.is_dir():
        folder, file = (color, depth) if color.is_dir() else (depth, color)
        raise InputError(
            folder, f"is a directory but {file} is a file", "give two files or two directories"
        )
    if not color.is_dir():
        return [Picture(color.stem, color, depth)]
    colors, depths = _by_stem(color, COLOR_SUFFIXES), _by_stem(depth, DEPTH_SUFFIXES)
    lone = [sorted(colors.keys() - depths.keys()), sorted(depths.keys() - colors.keys())]
    if lone[0] or lone[1]:
        told = [
            f"nothing in {other} has the stem of {_some([files[stem].name for stem in stems])}"
            for stems, files, other in ((lone[0], colors, depth), (lone[1], depths, color))
            if stems
        ]
        raise InputError(
            color if lone[0] else depth,
            " and ".join(told),
            "name colour and depth files alike or move the unpaired ones away",
        )
    return [Picture(stem, colors[stem], depths[stem]) for stem in sorted(colors)]


def with_hidden(
    pictures: Sequence[Picture], color: Path, hidden: tuple[Path, Path] | None
) -> list[Picture]:
    """The pictures, each with what lies behind it: two files for one, two directories for all.

    Raises:
        InputError: the hidden files do not pair up with the pictures.
    """
    if hidden is None:
        return list(pictures)
    found = find_pictures(*hidden)
    if color.is_dir() != hidden[0].is_dir():
        problem = "is a file, but the pictures are in a directory"
        if hidden[0].is_dir():
            problem = "is a directory, but there is one picture"
        raise InputError(hidden[0], problem, "give --hidden two files for a file, else directories")
    if not color.is_dir():
        return [replace(pictures[0], hidden=found[0])]
    behind = {picture.stem: picture for picture in found}
    lone = [picture.color.name for picture in pictures if picture.stem not in behind]
    if lone:
        problem = f"nothing in it has the stem of {_some(lone)}"
        raise InputError(hidden[0], problem, "name hidden and colour files alike")
    return [replace(picture, hidden=behind[picture.stem]) for picture in pictures]


def _scenes(path: Path) -> list[Picture]:
    if path.is_dir():
        return [Picture(stem, file, file) for stem, file in _by_stem(path, SCENE_SUFFIXES).items()]
    if path.suffix.lower() not in SCENE_SUFFIXES:
        raise InputError(
            path,
            "has no depth, which only EXR holds beside colour",
            "give the depth file as a second argument",
        )
    return [Picture(path.stem, path, path)]


def _by_stem(folder: Path, suffixes: frozenset[str]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.suffix.lower() not in suffixes or path.is_dir():
            continue
        if path.stem in found:
            raise InputError(
                path,
                f"has the same stem as {found[path.stem].name}, so their outputs would clash",
                "rename or move one of them",
            )
        found[path.stem] = path
    if not found:
        known = ", ".join(sorted(suffix[1:] for suffix in suffixes))
        raise InputError(
            folder, "holds no file of a known type", f"give one with files of type {known}"
        )
    return found


def _some(names: Sequence[str], most: int = 3) -> str:
    rest = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + rest

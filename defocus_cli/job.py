"""A job: one picture, the lens that takes it, what to write and how to compute it.

Pictures are named by the stem of their colour file; a job writes ``OUT/<kind>/<stem>.<ext>``.
Nothing here opens a file: what can be refused by looking at names is refused before any work.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from defocus_cli.draws import Draw
from defocus_cli.errors import InputError

IMAGE_KINDS = ("render", "left", "right")
MAP_KINDS = ("coc", "disparity", "trust")
RENDERED_KINDS = (*IMAGE_KINDS, "trust")
KINDS = IMAGE_KINDS + MAP_KINDS
SUFFIXES = {"exr": ".exr", "png": ".png", "png16": ".png", "tiff": ".tif", "jpg": ".jpg"}
COLOR_SUFFIXES = frozenset({".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff"})
DEPTH_SUFFIXES = frozenset({".exr", ".pfm", ".npy", ".png", ".tif", ".tiff"})
SCENE_SUFFIXES = frozenset({".exr"})


@dataclass(frozen=True)
class Picture:
    """Where colour and depth of one picture are; the same file twice when one EXR holds both.

    `hidden` is a picture of what lies behind the visible surface, where that is known.
    """

    stem: str
    color: Path
    depth: Path
    hidden: Picture | None = None


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

    def paths(self, stem: str) -> dict[str, Path]:
        """The file of each kind for one picture."""
        return {
            kind: self.root
            / kind
            / (stem + (".exr" if kind in MAP_KINDS else SUFFIXES[self.format]))
            for kind in self.kinds
        }

    def previews(self, stem: str) -> dict[str, Path]:
        """The preview of each kind for one picture; empty when none are wanted."""
        if not self.preview:
            return {}
        return {kind: self.root / kind / f"{stem}.preview.png" for kind in self.kinds}


@dataclass(frozen=True)
class Machine:
    """How to compute: what the pictures look like depends on ``quality`` alone."""

    quality: str = "standard"
    device: str = "auto"
    threads: int = 1


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
    def paths(self) -> dict[str, Path]:
        """The file of each kind."""
        return self.outputs.paths(self.sample_id)

    @property
    def previews(self) -> dict[str, Path]:
        """The preview of each kind; empty when none are wanted."""
        return self.outputs.previews(self.sample_id)

    @property
    def written(self) -> list[Path]:
        """Every file this job writes."""
        return [*self.paths.values(), *self.previews.values()]


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
            raise InputError(path, "no such file or directory", "check the path")
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


def make_jobs(
    pictures: Sequence[Picture], lens: Lens, *, reading: Reading, outputs: Outputs, machine: Machine
) -> list[Job]:
    """One job for each picture, refused as a whole if any would write where it must not.

    Raises:
        InputError: an output exists already, is an input or another job's output, or lies where
            nothing can be written.
    """
    jobs = [Job(picture, lens, reading, outputs, machine) for picture in pictures]
    written = [path for job in jobs for path in job.written]
    _refuse_clashes(written, pictures, outputs)
    _refuse_unwritable(outputs)
    folder = next((path for path in written if path.is_dir()), None)
    if folder is not None:
        raise InputError(
            folder, "is a directory where a file is to be written", "choose another -o"
        )
    existing = [path for path in written if path.exists()]
    if existing and not outputs.overwrite:
        others = f" (and {len(existing) - 1} more)" if len(existing) > 1 else ""
        raise InputError(
            existing[0],
            f"exists already{others}",
            "choose another -o or add --overwrite to render again",
        )
    return jobs


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


def _refuse_clashes(written: Sequence[Path], pictures: Sequence[Picture], outputs: Outputs) -> None:
    twice = next((path for path, count in Counter(written).items() if count > 1), None)
    if twice is not None:
        raise InputError(twice, "would be written twice", "rename one of the colour files")
    sources = [*pictures, *(picture.hidden for picture in pictures if picture.hidden)]
    named = {path for one in sources for path in (one.color, one.depth)}
    named |= {path.resolve() for path in named if path.is_symlink()}
    places = {folder: folder.resolve() for folder in {path.parent for path in named}}
    own = {(outputs.root / kind).resolve() for kind in outputs.kinds}
    inputs = {place / path.name for path in named if (place := places[path.parent]) in own}
    for path in written if inputs else ():  # a batch has many outputs, and hardly ever such inputs
        if path.parent.resolve() / path.name in inputs:
            raise InputError(path, "is an input and would be overwritten", "choose another -o")


def _refuse_unwritable(outputs: Outputs) -> None:
    for folder in (outputs.root, *(outputs.root / kind for kind in outputs.kinds)):
        existing = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        if not existing.is_dir():
            raise InputError(existing, "is a file where a directory is needed", "choose another -o")
        if not os.access(existing, os.W_OK | os.X_OK):
            raise InputError(existing, "cannot be written to", "choose another -o")


def _some(names: Sequence[str], most: int = 3) -> str:
    rest = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + rest

"""Pictures found in files and directories: colour paired with depth by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from defocus_cli.formats.kinds import PREVIEW
from defocus_cli.jobs.job import Picture
from defocus_cli.system.errors import InputError
from defocus_cli.system.safe_files import missing

COLOR_SUFFIXES = frozenset({".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff"})


PHOTO_SUFFIXES = frozenset({".jpg", ".jpeg"})
DEPTH_SUFFIXES = PHOTO_SUFFIXES | {
    *(".exr", ".pfm", ".npy", ".npz", ".png", ".tif", ".tiff", ".dpt", ".bin", ".h5", ".hdf5"),
    *(".dsp5", ".mat", ".heic", ".heif"),
}


SCENE_SUFFIXES = frozenset({".exr"})


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
    colors, depths = _by_stem(color, COLOR_SUFFIXES), _depths(depth)
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


def _depths(folder: Path) -> dict[str, Path]:
    """Depth files of a directory: photographs are depth where nothing else is in it."""
    suffixes = {path.suffix.lower() for path in folder.iterdir()} & DEPTH_SUFFIXES
    others = DEPTH_SUFFIXES - PHOTO_SUFFIXES
    return _by_stem(folder, others if suffixes & others else DEPTH_SUFFIXES)


def _by_stem(folder: Path, suffixes: frozenset[str]) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.suffix.lower() not in suffixes or path.is_dir():
            continue
        if path.name.endswith(f"{PREVIEW}.png"):  # of what `defocus depth` wrote
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

"""Find pictures in files, directories and patterns: match colour, depth and other files by name.

The name of a file in a directory is its stem. The name of a file that a pattern matches is the text
that the wildcards stand for. If the text before the wildcards is the same in all patterns, the name
includes it: ``s*/rgb.exr`` gives s1, not 1. A single colour file is paired with a single depth file
whatever their names. Files of frame patterns are paired by frame number alone.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from defocus_core.errors import InputError, Place, UsageProblem
from defocus_core.io.depth_formats.reading import PICTURES, XMP_BYTES, own_format
from defocus_core.io.read_files import missing, read_head
from defocus_core.io.shots.frame_patterns import (
    ALL,
    FrameChoice,
    chosen,
    frame_numbers,
    frames_of,
    is_pattern,
)
from defocus_core.io.wildcards import has_wildcard, matching, texts_before
from defocus_core.request.job import OTHERS, PictureFiles
from defocus_core.request.job_options import INPUT_OPTIONS
from defocus_core.request.output_kinds import PREVIEW
from defocus_core.request.resolver import Layer
from defocus_core.system.text import note

COLOR_SUFFIXES = frozenset(
    {*(".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp"), *(".heic", ".heif")}
)
PHOTO_SUFFIXES = frozenset({".jpg", ".jpeg"})
OWN_DEPTH_SUFFIXES = PHOTO_SUFFIXES | {".heic", ".heif"}  # of photographs that may hold their depth
DEPTH_SUFFIXES = PHOTO_SUFFIXES | {
    *(".exr", ".pfm", ".npy", ".npz", ".png", ".tif", ".tiff", ".dpt", ".bin", ".h5", ".hdf5"),
    *(".dsp5", ".mat", ".heic", ".heif"),
}
SCENE_SUFFIXES = frozenset({".exr"})  # suffixes of files that hold colour and depth

_NUMBER = re.compile(r"\d{2,}")

Others = Mapping[str, tuple[Path, Path | None]]  # colour and depth of what belongs to a picture


@dataclass(frozen=True)
class _Files:
    """The files that a path stands for, by name; the name of a single file is empty.

    ``photos`` are photographs in a directory of depth files. They are used as depth only for names
    that have no other depth file.
    """

    path: Path
    kind: str
    by_name: Mapping[str, Path]
    photos: Mapping[str, Path] = field(default_factory=dict)


def find_pictures(color: Path, depth: Path | None) -> list[PictureFiles]:
    """The pictures that the paths of colour and depth stand for, sorted by name or frame number."""
    return find(color, depth, {})[0]


def find(
    color: Path,
    depth: Path | None,  # the depth file or directory; None if each colour EXR holds its own depth
    others: Others,
    *,
    patterns_in: Path | None = None,
    frames: FrameChoice = ALL,
    carried: Mapping[str, Path] | None = None,
) -> tuple[list[PictureFiles], list[PictureFiles]]:
    """Find the pictures that paths stand for: files, directories, patterns or frame patterns.

    `others` are the paths of other pictures of the scene by role, and `carried` those of labels;
    `patterns_in` is the folder to which wildcard patterns are relative, None to refuse them.
    Returns the wanted pictures; and all complete frames of the shot, empty without frame patterns.
    """
    labels = carried or {}
    every = (color, depth, *(path for pair in others.values() for path in pair), *labels.values())
    paths = [path for path in every if path is not None]
    if any(is_pattern((patterns_in or Path()) / path) for path in paths):
        if labels:
            problem = "is not supported for the frames of a shot"
            raise UsageProblem("idle-option", problem, "leave it out", field="carry")
        return _shot(color, depth, others, patterns_in or Path(), frames)
    if frames.numbers is not None:
        problem = "chooses frames, but no path is a pattern of frames"
        remedy = "give patterns like 'shot.####.exr'"
        raise UsageProblem("idle-option", problem, remedy, path=frames.source)
    names = [_NUMBER.sub("#", path.name) for path in (color, depth or color)]
    if depth not in (None, color) and color.parent == depth.parent and names[0] == names[1]:
        problem = f"looks like the next frame of {color.name}, not its depth"
        remedy = f"quote a pattern, like '{names[0].replace('#', '####', 1)}'"
        raise UsageProblem("contradiction", problem, remedy, path=depth)
    with_text = patterns_in is not None and all(
        texts_before(path) == texts_before(color) for path in paths
    )
    skips = frames.missing == "skip"
    colors, pictures = _pair(color, depth, patterns_in, with_text, skips=skips)
    if skips and colors.kind == "file":
        problem = "is for frames, directories and patterns, and this is one picture"
        raise UsageProblem("idle-option", problem, "leave it out", path=frames.source)
    for role, (other_color, other_depth) in others.items():
        # plates and mattes need no depth, and a holdout has its own
        lone = role != "hidden" and other_depth is None
        second = other_color if lone else other_depth
        other_colors, paired = _pair(other_color, second, patterns_in, with_text, skips=skips)
        _check_paired(colors, other_colors, skips=skips)
        pictures = {name: picture for name, picture in pictures.items() if name in paired}
        for name, picture in pictures.items():
            other: dict[str, Any] = {role: paired[name]}
            pictures[name] = replace(picture, **other)
    for role, path in labels.items():
        files = _files(path, COLOR_SUFFIXES | DEPTH_SUFFIXES, patterns_in, with_text)
        _check_paired(colors, files, skips=skips)
        pictures = {name: each for name, each in pictures.items() if name in files.by_name}
        for name, picture in pictures.items():
            with_label = (*picture.carried, (role, files.by_name[name]))
            pictures[name] = replace(picture, carried=with_label)
    if not pictures:
        problem = "has no picture with all of its files"
        raise InputError("empty", problem, "give its files the same names", path=colors.path)
    return list(pictures.values()), []


def choice_of(options: Layer, at: Callable[[str], Place]) -> FrameChoice:
    """The frames that the options ‹frames› and ‹missing› choose; ``at`` gives an option's place."""
    frames, missing = options.get("frames"), options.get("missing")
    return FrameChoice(
        None if frames is None else frame_numbers(frames.text, frames.place),
        ALL.missing if missing is None else missing.value,
        at("missing" if frames is None else "frames"),
    )


def others_of(paths: Mapping[str, Path], where: Place) -> Others:
    """Colour and depth paths of the other pictures of a scene, by role such as hidden or over.

    ``paths`` has the paths by option name; ``where`` is their place, for errors.
    """
    for role in OTHERS:
        if f"{role}-depth" in paths and role not in paths:
            other = f"‹{role}›" if where.path is None else INPUT_OPTIONS[role].key
            raise UsageProblem(
                "missing-option",
                f"needs {other}",
                "add that",
                path=where.with_field(f"{role}-depth"),
            )
    return {role: (paths[role], paths.get(f"{role}-depth")) for role in OTHERS if role in paths}


def _shot(
    color: Path, depth: Path | None, others: Others, root: Path, frames: FrameChoice
) -> tuple[list[PictureFiles], list[PictureFiles]]:
    """The wanted frames of frame patterns; and all complete frames.

    A note tells which frames are left out, as one of their files is missing.
    """
    if depth is None and color.suffix.lower() not in SCENE_SUFFIXES:
        problem = "holds no depth beside its colour"
        remedy = "give the depth frames as a second argument"
        raise InputError("missing-frames", problem, remedy, path=root / color)
    paths = {"color": root / color, "depth": root / (depth or color)}
    for role, (other_color, other_depth) in others.items():
        paths[f"{role}_color"] = root / other_color
        paths[f"{role}_depth"] = root / (other_depth or other_color)
    for path in paths.values():
        if not is_pattern(path):
            problem = "is no pattern of frames, but another path is"
            remedy = "give patterns like 'shot.####.exr' for all of them"
            raise InputError("missing-frames", problem, remedy, path=path)
    files = {role: frames_of(path) for role, path in paths.items()}
    numbers, skipped = chosen({path: files[role] for role, path in paths.items()}, frames)
    if skipped:
        note(f"defocus: {skipped}; left out")
    whole = {n: _frame(files, n) for n in sorted(set.intersection(*map(set, files.values())))}
    return [whole[number] for number in numbers], list(whole.values())


def _frame(files: Mapping[str, Mapping[int, Path]], number: int, prefix: str = "") -> PictureFiles:
    roles = [role for role in OTHERS if not prefix and f"{role}_color" in files]
    others: dict[str, Any] = {role: _frame(files, number, f"{role}_") for role in roles}
    color, depth = (files[prefix + role][number] for role in ("color", "depth"))
    return PictureFiles(files["color"][number].stem, color, depth, **others, frame=number)


def _pair(
    color: Path, depth: Path | None, root: Path | None, with_text: bool, *, skips: bool
) -> tuple[_Files, dict[str, PictureFiles]]:
    """The files that a colour path stands for; and each picture by name, paired with its depth.

    `root` is the folder of patterns. `with_text` adds the text before wildcards to names; `skips`
    leaves unpaired files out instead of refusing them.
    """
    if depth is None:
        colors = depths = _files(color, SCENE_SUFFIXES, root, with_text)
        suffix = colors.path.suffix.lower()
        own = suffix in OWN_DEPTH_SUFFIXES and own_format(colors.path)  # as of photographs
        if colors.kind == "file" and suffix not in SCENE_SUFFIXES and not own:
            problem = "holds no depth beside its colour"
            if suffix in PHOTO_SUFFIXES and PICTURES in read_head(colors.path, XMP_BYTES):
                problem += ": none of the further pictures in it says that it is depth"
            remedy = "give the depth file as a second argument"
            raise InputError("no-depth", problem, remedy, path=colors.path)
    else:
        colors = _files(color, COLOR_SUFFIXES, root, with_text)
        depths = _files(depth, DEPTH_SUFFIXES, root, with_text)
        photos = {n: p for n, p in depths.photos.items() if colors.by_name.get(n, p) != p}
        depths = replace(depths, by_name={**photos, **depths.by_name})
        _check_paired(colors, depths, skips=skips)
        _check_paired(depths, colors, skips=skips)
    return colors, {
        name: PictureFiles(name or path.stem, path, depths.by_name[name])
        for name, path in colors.by_name.items()
        if name in depths.by_name
    }


def _files(path: Path, suffixes: frozenset[str], root: Path | None, with_text: bool) -> _Files:
    if root is not None and has_wildcard(path) and not (root / path).exists():
        kind, named, path = "pattern", matching(root, path, with_text=with_text), root / path
    else:
        path = path if root is None else root / path
        if not path.is_dir():
            if not path.exists() and has_wildcard(path):
                problem = (
                    "matches nothing: such patterns are expanded by the shell, or in jobs files"
                )
                remedy = "leave out the quotes, or write a jobs file"
                raise InputError("not-found", problem, remedy, path=path)
            if not path.exists():
                raise missing(path, "file or directory")
            return _Files(path, "file", {"": path})
        kind, named = "directory", matching(path, "*")
    by_name: dict[str, Path] = {}
    preview = f"{PREVIEW}.png"  # depth, as ``defocus depth`` writes it
    files = ((name, file) for name, file in sorted(named) if not file.name.endswith(preview))
    every = [(name, file, file.suffix.lower()) for name, file in files]
    photos: dict[str, Path] = {}
    held = {suffix for _, _, suffix in every} & suffixes
    if suffixes is DEPTH_SUFFIXES and kind == "directory" and held - PHOTO_SUFFIXES:
        suffixes = suffixes - PHOTO_SUFFIXES
        photos = {name: file for name, file, suffix in every if suffix in PHOTO_SUFFIXES}
    if kind == "pattern" and not every:
        raise InputError("empty", "matches no file", "check the pattern", path=path)
    for name, file, suffix in every:
        if suffix not in suffixes:
            continue
        if name in by_name:
            problem = f"names {by_name[name]} and {file} '{name}', so their outputs would clash"
            remedy = "rename or move one of them, or use a narrower pattern"
            raise InputError("duplicate", problem, remedy, path=path)
        by_name[name] = file
    if not by_name:
        remedy = f"give files of type {', '.join(sorted(suffix[1:] for suffix in suffixes))}"
        raise InputError("empty", "holds no file of a known type", remedy, path=path)
    return _Files(path, kind, by_name, photos)


def _check_paired(files: _Files, others: _Files, *, skips: bool) -> None:
    """Refuse files without a file of the same name in `others`; with `skips`, only write a note."""
    if files.kind != others.kind:
        many, one = sorted((files, others), key=lambda each: each.kind == "file")
        problem = f"is a {many.kind} but {one.path} is a {one.kind}"
        remedy = "give files, or directories, or patterns alone"
        raise InputError("wrong-type", problem, remedy, path=many.path)
    lone = [name for name in files.by_name if name not in others.by_name]
    if lone:
        more = f", and none for {len(lone) - 1} more" if len(lone) > 1 else ""
        problem = f"has no file named '{lone[0]}', as {files.by_name[lone[0]]} is{more}"
        if skips:
            note(f"defocus: {others.path}: {problem}; left out")
            return
        remedy = "name colour and depth files alike, or leave these out by ‹missing› skip"
        raise InputError("empty", problem, remedy, path=others.path)

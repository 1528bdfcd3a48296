"""Pairs of files to compare: two files, or the pictures of two folders by their relative path."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from defocus_core.compare.picture import SUFFIXES
from defocus_core.errors import InputError
from defocus_core.io.safe_files import missing
from defocus_core.io.wildcards import matching

_VIEW = re.compile(r"(?<![A-Za-z])(left|right|L|R|l|r)(?![A-Za-z])", re.I)
_OTHER = {"left": "right", "right": "left", "l": "r", "r": "l"}
_FRAME_NUMBER = re.compile(r"(\d+)(?=\D*$)")


@dataclass(frozen=True)
class FilePair:
    """A file of A and the file of B with the same name."""

    name: str  # the path relative to both folders, or the name of the lone file of B
    a: Path | None  # the reference; None if A has no such file
    b: Path | None  # what is judged; None if B has no such file


def find_pairs(a: Path, b: Path) -> list[FilePair]:
    """The pairs of two files or two folders, sorted by name."""
    for path in (a, b):
        if not path.exists():
            raise missing(path, "file or directory")
    if a.is_dir() != b.is_dir():
        folder, file = (a, b) if a.is_dir() else (b, a)
        problem = f"is a directory but {file} is a file"
        raise InputError("wrong-type", problem, "name two files, or two directories", path=folder)
    if not a.is_dir():
        return [FilePair(b.name, a, b)]
    of_a, of_b = _pictures(a), _pictures(b)
    if not of_a and not of_b:
        known = ", ".join(sorted(suffix[1:] for suffix in SUFFIXES))
        problem = f"holds no picture, nor does {b}"
        raise InputError("empty", problem, f"name directories with files of type {known}", path=a)
    return [FilePair(name, of_a.get(name), of_b.get(name)) for name in sorted(of_a | of_b)]


def _pictures(folder: Path) -> dict[str, Path]:
    """Relative path to path of each picture below a folder, links followed."""
    files = (path for _, path in matching(folder, "**"))
    return {
        path.relative_to(folder).as_posix(): path
        for path in files
        if path.suffix.lower() in SUFFIXES
    }


def partners(path: Path | None) -> Iterator[tuple[str, Path]]:
    """Files that may stand in for another, with the finding that one does.

    These are the other of the left and right view, the views of a render and the reverse, and the
    frames before and after it.
    """
    if path is None:
        return
    view = view_partner(path)
    if view is not None:
        yield "left and right swapped", view
    kinds = ("render", "left", "right")
    if path.parent.name in kinds:
        for kind in kinds:
            other = path.parent.with_name(kind) / path.name
            if kind != path.parent.name and other != view and other.is_file():
                yield f"another view or frame: {kind} in place of {path.parent.name}", other
    match = _FRAME_NUMBER.search(path.stem)
    if match is None:
        return
    for step in (-1, 1):
        number = f"{int(match[1]) + step:0{len(match[1])}d}"
        other = path.with_name(
            path.stem[: match.start()] + number + path.stem[match.end() :] + path.suffix
        )
        if other.is_file():
            yield f"another view or frame: that of {other.name}", other


def view_partner(path: Path) -> Path | None:
    """The file of the other of the left and right view, by its name; None if there is none.

    The last of file name and folder that names a view decides.
    """
    for place in (path.stem, path.parent.name):
        match = list(_VIEW.finditer(place))
        if not match:
            continue
        word = match[-1][0]
        other = _OTHER[word.lower()]
        other = other.upper() if word.isupper() else other
        other = other.capitalize() if word.istitle() and len(word) > 1 else other
        renamed = place[: match[-1].start()] + other + place[match[-1].end() :]
        partner = (
            path.with_name(renamed + path.suffix)
            if place == path.stem
            else path.parent.with_name(renamed) / path.name
        )
        if partner.is_file():
            return partner
    return None

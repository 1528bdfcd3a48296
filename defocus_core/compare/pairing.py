"""Pairs of files to compare: two files, or the pictures of two folders by their relative path."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from defocus_core.compare.picture import SUFFIXES
from defocus_core.errors import InputError
from defocus_core.io.safe_files import missing
from defocus_core.io.wildcards import matching


@dataclass(frozen=True)
class FilePair:
    """A file of A and the file of B with the same name.

    Attributes:
        name: the path relative to both folders, or the name of the lone file of B.
        a: the reference; None if A has no such file.
        b: what is judged; None if B has no such file.
    """

    name: str
    a: Path | None
    b: Path | None


def find_pairs(a: Path, b: Path) -> list[FilePair]:
    """The pairs of two files or two folders, sorted by name.

    Raises:
        InputError: a path is missing, one is a file and the other a folder, or neither folder
            holds a picture.
    """
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
        if path.suffix.lower() in SUFFIXES and not path.is_dir()
    }

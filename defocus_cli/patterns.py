"""Files that a pattern with wildcards names, and the name that the wildcards give each of them.

``frames/*_rgb.png`` names ``frames/07_rgb.png`` by what the star stands for: ``07``. So colour and
depth pair up however their folders and file names are built around that part.
"""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from defocus_cli.errors import InputError

_WILDCARD = re.compile(r"\*\*/|\*\*|\*|\?|\[[^\]]+\]")
_GROUPS = {"**/": "((?:[^/]+/)*)", "**": "(.*)", "*": "([^/]*)"}


def has_wildcard(pattern: str) -> bool:
    """Whether there is anything in it to expand."""
    return _WILDCARD.search(pattern) is not None


def matching(folder: Path, pattern: str, suffixes: frozenset[str]) -> dict[str, Path]:
    """Name to file, sorted by name.

    Args:
        folder: what the pattern is relative to.
        pattern: a path with ``*``, ``?``, ``[…]``, or ``**`` for folders at any depth.
        suffixes: the types of files to take; others are passed over.

    Raises:
        InputError: nothing matches, two files get one name, a folder cannot be looked into, or
            holds a link to itself.
    """
    pattern = os.path.normpath(pattern)  # as glob writes what it finds
    _refuse_closed(folder, pattern)
    expression = re.compile(_expression(pattern), re.S)
    found: dict[str, Path] = {}
    # Path.glob takes no absolute pattern, and the hidden files too.
    for text in glob.iglob(pattern, root_dir=folder, recursive=True):  # noqa: PTH207
        path = folder / text
        if path.suffix.lower() not in suffixes or path.is_dir():
            continue
        if "**" in pattern:
            _refuse_circle(path.parent)
        name = "_".join(_parts(expression, text)) or path.stem
        if name in found:
            problem = f"names both {found[name]} and {path} '{name}'"
            raise InputError(folder / pattern, problem, "use a narrower pattern")
        found[name] = path
    if not found:
        known = ", ".join(sorted(suffix[1:] for suffix in suffixes))
        problem = f"matches no file of type {known}"
        raise InputError(folder / pattern, problem, "check the pattern")
    return {name: found[name] for name in sorted(found)}


def _refuse_closed(folder: Path, pattern: str) -> None:
    """Refuse folders that glob would pass over without a word, for want of permission."""
    parts = Path(pattern).parts
    for depth, part in enumerate(parts):
        listed = has_wildcard(part) or parts[:depth][-1:] == ("**",)
        needed = os.R_OK | os.X_OK if listed else os.X_OK
        above = os.path.join(*parts[:depth], "")  # noqa: PTH118 - Path drops the last slash
        shown = [above]
        if has_wildcard(above):
            shown = glob.glob(above, root_dir=folder, recursive=True)  # noqa: PTH207
        for text in shown:
            path = folder / text
            if path.is_dir() and not os.access(path, needed):
                remedy = "check its permissions, or use a narrower pattern"
                raise InputError(path, "cannot be looked into", remedy)


@lru_cache(maxsize=4096)
def _refuse_circle(folder: Path) -> None:
    """Refuse a folder in which glob would find itself again and again."""
    for place in (folder, *folder.parents):
        if place.is_symlink() and place.parent.resolve().is_relative_to(place.resolve()):
            problem = "is a symbolic link to a folder that it is in"
            raise InputError(place, problem, "remove it, or use a narrower pattern")


def _parts(expression: re.Pattern[str], text: str) -> Iterator[str]:
    """What each wildcard stands for; of the file's own suffix, nothing."""
    match = expression.fullmatch(text)
    if match is None:
        return
    stop = len(text) - len(Path(text).suffix)
    for index in range(1, expression.groups + 1):
        begin, end = match.span(index)
        part = text[begin : min(end, stop)].strip("/")
        if part:
            yield part.replace("/", "_")


def _expression(pattern: str) -> str:
    """The regular expression with a group for each wildcard; what fits in it, glob has decided."""
    pieces, place = [], 0
    for found in _WILDCARD.finditer(pattern):
        pieces.append(re.escape(pattern[place : found.start()]))
        pieces.append(_GROUPS.get(found[0], "([^/])"))
        place = found.end()
    return "".join([*pieces, re.escape(pattern[place:])])

"""Wildcards in paths: the matching files, each named by the text that the wildcards match."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from defocus_core.errors import InputError

_WILDCARD = re.compile(r"(\*+|\?|\[[^\]]+\])")
_NUMBER = re.compile("#+")

# Of one part of a path, the text that its wildcards match, and this with the text before it
_Piece = tuple[str, str]


def has_wildcard(pattern: str | Path) -> bool:
    """Whether a path holds ``*``, ``?`` or ``[…]``."""
    return _WILDCARD.search(str(pattern)) is not None


def texts_before(pattern: str | Path) -> list[str]:
    """The literal text before each wildcard of a pattern, back to a slash or another wildcard."""
    return [text for part in Path(pattern).parts for text in _WILDCARD.split(part)[:-1:2]]


def wild_text(name: str, pattern: str) -> str | None:
    """The texts that a pattern's wildcards match in a name, joined by _; None if it does not match.

    A run of ``#`` matches a whole number of at least as many digits.
    """
    if not fnmatchcase(name, _NUMBER.sub("*", pattern)):
        return None
    expression = _reversed_expression(pattern).replace("\\#", "#")
    digits = _NUMBER.sub(lambda run: f"[0-9]{{{len(run[0])},}}", expression)
    match = re.fullmatch(digits, name[::-1], re.DOTALL)
    return match and "_".join(text[::-1] for text in match.groups()[::-1] if text)


def matching(
    folder: Path, pattern: str | Path, *, with_text: bool = False
) -> Iterator[tuple[str, Path]]:
    """Yield name and path of each file that a pattern matches; hidden files are left out.

    `pattern`: a path with ``*``, ``?``, ``[…]``, or ``**`` for folders at any depth. The name is
    the text that its wildcards match; `with_text`: with the literal text before them, too.
    """
    parts = Path(os.path.normpath(pattern)).parts
    parts += ("*",) * (parts[-1] == "**")
    for path, pieces in _walk(folder, parts):
        names = (piece[with_text] for piece in pieces)
        yield "_".join(filter(None, names)) or path.stem, path


def _walk(folder: Path, parts: Sequence[str]) -> Iterator[tuple[Path, list[_Piece]]]:
    """Yield each file below a folder that matches the components of a path, with its texts.

    There is a `_Piece` of text for each component with wildcards.
    """
    part, rest = parts[0], parts[1:]
    needed = os.R_OK | os.X_OK if has_wildcard(part) else os.X_OK
    if not os.access(folder, needed):
        remedy = "check its permissions, or use a narrower pattern"
        raise InputError("unreadable", "cannot be opened", remedy, path=folder)
    if part == "**":
        yield from _walk(folder, rest)
    for path, pieces, is_folder in _entries(folder, part, last=not rest):
        if not rest and not is_folder:
            yield path, pieces
        elif rest and is_folder:
            if part == "**":
                _refuse_circle(path)
            for below, more in _walk(path, parts if part == "**" else rest):
                yield below, pieces + more


def _entries(folder: Path, part: str, *, last: bool) -> Iterator[tuple[Path, list[_Piece], bool]]:
    """Yield (path, texts, whether it is a folder) of the entries that match a path component.

    There is one `_Piece` of text if the component has wildcards; in the `last` component it ends
    before the suffix.
    """
    if os.path.lexists(folder / part):  # brackets may belong to the name of an existing file
        yield folder / part, [], (folder / part).is_dir()
        return
    if not has_wildcard(part):
        return
    expression = re.compile(_reversed_expression(part), re.DOTALL)
    with os.scandir(folder) as listed:
        entries = [*listed]
    for entry in entries:
        path, name = folder / entry.name, entry.name
        if not fnmatchcase(name, part) or (name.startswith(".") and not part.startswith(".")):
            continue
        match = expression.fullmatch(name[::-1])
        end, size = len(path.stem) if last else len(name), len(name)
        spans = [(size - b, min(size - a, end)) for a, b in match.regs[:0:-1]] if match else []
        text = name[: spans[-1][1]] if spans else ""
        piece = "_".join(name[a:b] for a, b in spans if a < b), text.lstrip(".")
        yield path, [piece], (path if entry.is_symlink() else entry).is_dir()


def _reversed_expression(part: str) -> str:
    """A regular expression that matches reversed names, with a group for each wildcard.

    In names, each ``*`` matches as much as possible, the first before the others; so in reversed
    names, each but the last matches as little as possible, without backtracking.
    """
    groups = {"?": "(.)", "[": "(.)", "*": "(.*)"}
    expression = ""
    for place, piece in enumerate(reversed(_WILDCARD.split(part))):
        expression += groups[piece[0]] if place % 2 else re.escape(piece[::-1])
    first, *others = expression.split("(.*)")
    atomic = "".join(f"(?>(.*?){text})" for text in others[:-1])
    return first + atomic + "".join(f"(.*){text}" for text in others[-1:])


def _refuse_circle(folder: Path) -> None:
    """Refuse a link to a folder that contains the link, as ``**`` would never end there."""
    if not folder.is_symlink():
        return
    real = folder.parent.resolve()
    if folder.resolve() in {real, *real.parents, *(above.resolve() for above in folder.parents)}:
        problem = "is a symbolic link to a folder that contains it"
        remedy = "remove it, or use a narrower pattern"
        raise InputError("circular-link", problem, remedy, path=folder)

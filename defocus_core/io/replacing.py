"""What may be replaced in a folder of a user: what a run of ours wrote, and no input of it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from defocus_core.errors import InputError, reason
from defocus_core.io.below import open_plain

KIND = "defocus:kind"  # the attribute of a picture that says what it is
CONTACT, DIFFERENCE, GOLDEN = "contact sheet", "difference image", "golden"
_HEAD = 2**16  # bytes


def _picture(kind: str) -> re.Pattern[bytes]:
    """A PNG or EXR whose attribute says that it is of a kind."""
    return re.compile(rf"(?:\x89PNG|v/1\x01).*{KIND}\0.{{0,16}}{kind}".encode("latin-1"), re.S)


# By kind: how such a file of ours begins.
_BEGINNINGS = {
    "html": re.compile(
        rb"<!doctype html>.*default-src 'none'; img-src data:; style-src 'sha256-", re.S
    ),
    "markdown": re.compile(b"<!-- defocus compare -->\n"),
    "junit": re.compile(
        rb"<\?xml version='1.0' encoding='utf-8'\?>.*<testsuite name=\"defocus compare\"", re.S
    ),
    CONTACT: _picture(CONTACT),
    DIFFERENCE: _picture(DIFFERENCE),
    GOLDEN: re.compile(b"(?!)"),  # which of them is ours, pairs and recipes say
}


def require_replaceable(
    path: Path,
    kind: str = "",
    *,
    overwrite: bool = False,
    inputs: frozenset[tuple[int, int]] = frozenset(),
) -> None:
    """Refuse to replace a file or folder that must be kept.

    `kind`: of `_BEGINNINGS`, of which a file of ours, or an empty one, may go; `overwrite`: any may
    go, but `inputs`, the `identities` of the files that are read.
    """
    if inputs and not inputs.isdisjoint(identities([path])):
        raise replaces_input(path)
    if overwrite or not path.exists():
        return
    if not kind:
        remedy = "name another output, or add ‹overwrite›"
        raise InputError("exists", "is there already", remedy, path=path)
    try:
        with open_plain(path) as file:
            head = file.read(_HEAD)
    except IsADirectoryError:
        return  # who writes it says what is wrong
    except OSError as error:
        problem = f"cannot be replaced: {reason(error)}"
        raise InputError("unwritable", problem, "name another file", path=path) from None
    if head and not _BEGINNINGS[kind].match(head):
        what = "report" if kind in ("html", "junit", "markdown") else kind
        problem = f"exists already, and is not a {what} that could be replaced"
        raise InputError("exists", problem, "name another file, or move it away", path=path)


def identities(paths: Iterable[Path]) -> frozenset[tuple[int, int]]:
    """Device and number of each file that is there, links followed."""
    found = set()
    for path in paths:
        with suppress(OSError):
            status = path.stat()
            found.add((status.st_dev, status.st_ino))
    return frozenset(found)


def replaces_input(path: Path) -> InputError:
    """The InputError for an output that is an input, too."""
    problem = "is an input and would be overwritten"
    return InputError("replaces-input", problem, "name another output", path=path)

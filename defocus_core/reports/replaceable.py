"""What a report may replace: an empty file, or a report of its kind, known by how it begins."""

from __future__ import annotations

from pathlib import Path

from defocus_core.errors import InputError, UsageProblem, reason
from defocus_core.io.below import open_plain
from defocus_core.request.output_kinds import PICTURES

# By kind: how a report begins, and what is found near its beginning.
_MARKS = {
    "html": (b"<!doctype html>", b"default-src 'none'; img-src data:; style-src 'sha256-"),
    "junit": (b"<?xml version='1.0' encoding='utf-8'?>", b'<testsuite name="defocus compare"'),
}
_HEAD = 1024  # bytes


def refuse_other(path: Path, kind: str) -> None:
    """Refuse to write a report over what is no report, or into a file named as a picture."""
    try:
        with open_plain(path) as file:
            head = file.read(_HEAD)
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        head = b""  # who writes it says what is wrong
    except OSError as error:
        problem = f"cannot be replaced: {reason(error)}"
        raise InputError("unwritable", problem, "name another file", path=path) from None
    begin, mark = _MARKS[kind]
    if head and not (head.startswith(begin) and mark in head):
        problem = "exists already, and is not a report that could be replaced"
        raise InputError("exists", problem, "name another file, or move it away", path=path)
    if path.suffix.lower() in PICTURES:
        remedy = f"end its name in .{'xml' if kind == 'junit' else kind}"
        raise UsageProblem(
            "malformed", "is the name of a picture, not of a report", remedy, path=path
        )

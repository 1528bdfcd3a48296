"""Errors of the user, in one line: ``SUBJECT: problem; remedy``."""

from __future__ import annotations

import re
import unicodedata
from difflib import get_close_matches
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


class UserError(Exception):
    """A mistake with a subject, a problem and a remedy, shown without a traceback.

    Args:
        subject: the file or option concerned.
        problem: what is wrong with it, without a full stop.
        remedy: what to do about it; the empty string if there is nothing to propose.
        code: why a picture is `Rejected`, for programs.
    """

    def __init__(self, subject: str | Path, problem: str, remedy: str = "", code: str = "") -> None:
        self.subject = printable(str(subject))
        self.problem = one_line(problem)
        self.remedy = one_line(remedy)
        self.code = code
        super().__init__(self.subject, self.problem, self.remedy, self.code)

    def __str__(self) -> str:
        line = f"{self.subject}: {self.problem}"
        return f"{line}; {self.remedy}" if self.remedy else line


class UsageProblem(UserError):  # noqa: N818 - click has a UsageError
    """Something is asked for that makes no sense."""


class InputError(UserError):
    """A file cannot be read, understood or written."""


class TooLarge(InputError):  # noqa: N818 - it is said of a file
    """A picture does not fit into memory."""


class Rejected(InputError):  # noqa: N818 - it is no error of the user's
    """A picture that a lens cannot take as asked."""


def one_line(text: object) -> str:
    """``text`` with line breaks, tabs and runs of blanks turned into single blanks, `printable`."""
    return printable(" ".join(str(text).split()))


def printable(text: str) -> str:
    """``text`` with control characters and line breaks written as Python escapes.

    File names may hold anything: line breaks, escapes, bytes that are no UTF-8.
    """
    if text.isprintable():
        return text
    return "".join(
        char
        if char.isprintable() or unicodedata.category(char) == "Zs"
        else char.encode("unicode_escape").decode()
        for char in text
    )


def did_you_mean(word: str, known: Sequence[str], otherwise: str) -> str:
    """The remedy for an unknown name: the nearest known name, or else ``otherwise``."""
    nearest = get_close_matches(word.lower(), known, n=1, cutoff=0.7)
    return f"did you mean {nearest[0]}?" if nearest else otherwise


def reason(error: BaseException) -> str:
    """The message of any exception, as one clause without a full stop."""
    message = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return one_line(message).rstrip(".")


def first_line(path: Path, text: str) -> str:
    """First line of what OpenImageIO says, short enough for a message that names the file."""
    for named in (f' ("{path}")', f" ({path})", f"{path}: ", f": {path}"):
        text = text.replace(named, "")
    lines = text.replace(f'"{path}"', "it").strip().splitlines() or ["no reason given"]
    return one_line(lines[0]).rstrip(".")[:120]


def alike(note: str) -> str:
    """A note without its numbers, so that those of many pictures are alike."""
    return re.sub(r"\d[\d.,]*", "N", note)

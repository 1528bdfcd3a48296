"""Errors of the user, as data: code, path, field, problem and remedy."""

from __future__ import annotations

import re
import unicodedata
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


_OPTION = re.compile("‹([a-z][a-z-]*)›")


class DefocusError(Exception):
    """A mistake of a user, as data: what is wrong, where, and what to do about it.

    Texts name options in angle quotes, like ‹focus›: the command line writes ``--focus``.

    Args:
        code: what kind of mistake it is, a word of `CODES`.
        problem: what is wrong, without a full stop.
        remedy: what to do about it; the empty string if there is nothing to propose.
        path: the file concerned, or what else the mistake is in.
        field: the option or key concerned, in the file if there is one.
        value: what the option is set to, where that is a part of the mistake.
    """

    def __init__(
        self,
        code: str,
        problem: str,
        remedy: str = "",
        *,
        path: str | Path | None = None,
        field: str = "",
        value: str = "",
    ) -> None:
        super().__init__(code, problem)
        self.code = code
        self.problem = one_line(problem)
        self.remedy = one_line(remedy)
        caller = _OPTION.fullmatch(str(path))  # an option that the caller gave himself
        self.path = None if path is None or caller else printable(str(path))
        self.field = caller[1] if caller else field
        self.value = printable(value)

    @property
    def subject(self) -> str:
        """File, option or key that the mistake is in, in words."""
        if self.path is None:
            return f"‹{self.field}› {self.value}".rstrip()
        return f"{self.path}: {self.field}" if self.field else self.path

    def __str__(self) -> str:
        line = f"{self.subject}: {self.problem}"
        return f"{line}; {self.remedy}" if self.remedy else line

    def __reduce__(self) -> tuple[Any, ...]:
        # By default an exception unpickles from its arguments alone; workers send these home.
        return type(self), (self.code, self.problem, self.remedy), self.__dict__


class UsageProblem(DefocusError):  # noqa: N818 - click has a UsageError
    """Something is asked for that makes no sense."""


class InputError(DefocusError):
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


def with_dashes(text: str) -> str:
    """``text`` with the options that it names as they are on a command line."""
    return _OPTION.sub(r"--\1", text)

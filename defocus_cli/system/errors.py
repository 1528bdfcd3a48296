"""Errors of the user, in one line: ``defocus: SUBJECT: problem; remedy``.

Exit codes: 1 if a part of a batch failed, 2 for a command line that makes no sense, 3 for a file
that cannot be used, 130 if interrupted, 143 if ended by SIGTERM.
"""

from __future__ import annotations

import re
import unicodedata
from difflib import get_close_matches
from typing import IO, TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


class UserError(click.ClickException):
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
        line = f"{self.subject}: {self.problem}"
        super().__init__(f"{line}; {self.remedy}" if self.remedy else line)

    def __reduce__(self) -> tuple[type[UserError], tuple[str, str, str, str]]:
        # By default an exception unpickles from its message alone; workers send these home.
        return type(self), (self.subject, self.problem, self.remedy, self.code)

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the line to stderr, or to ``file``."""
        click.echo(f"defocus: {self.format_message()}", file=file, err=file is None)


class Failures:
    """Errors of files that others stand beside: those are done, and the last error ends it."""

    def __init__(self) -> None:
        self._errors: list[UserError] = []

    def __bool__(self) -> bool:
        return bool(self._errors)

    def add(self, error: UserError) -> None:
        """Keep an error; the one before is said now."""
        if self._errors:
            self._errors[-1].show()
        self._errors.append(error)

    def records(self) -> list[dict[str, str]]:
        """The errors for JSON."""
        return [
            {"subject": each.subject, "problem": each.problem, "remedy": each.remedy}
            for each in self._errors
        ]

    def end(self) -> None:
        """Raise the last error, if there is any."""
        if self._errors:
            raise self._errors[-1]


class UsageProblem(UserError):  # noqa: N818 - click already has a UsageError
    """The command line asks for something that makes no sense; exit code 2."""

    exit_code = 2


class InputError(UserError):
    """A file cannot be read, understood or written; exit code 3."""

    exit_code = 3


class TooLarge(InputError):  # noqa: N818 - it is said of a file
    """A picture does not fit into memory."""


class Rejected(InputError):  # noqa: N818 - it is no error of the user's
    """A picture that a lens cannot take as asked."""


class Interrupted(click.ClickException):
    """The user pressed Ctrl-C; exit code 130."""

    exit_code = 130


class SomeFailed(click.ClickException):
    """Not all of a batch could be done; exit code 1."""

    exit_code = 1


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

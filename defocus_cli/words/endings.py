"""How a command ends that could not do all it was asked for: exceptions, and their exit codes.

Exit codes: 1 if a part of a batch failed, 2 for a command line that makes no sense, 3 for a file
that cannot be used, 130 if interrupted, 143 if ended by SIGTERM.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import click

from defocus_cli.words import console
from defocus_core.errors import DefocusError, NotExplained, UsageProblem


def exit_code_of(error: BaseException) -> int:
    """1 for pictures that no lens explains and for faults, 2 for usage, 3 for files."""
    if isinstance(error, UsageProblem):
        return 2
    is_of_files = isinstance(error, (DefocusError, OSError))
    return 3 if is_of_files and not isinstance(error, NotExplained) else 1


class Interrupted(click.ClickException):
    """The user pressed Ctrl-C; exit code 130."""

    exit_code = 130


class SomeFailed(click.ClickException):
    """Not all of a batch could be done; exit code 1."""

    exit_code = 1


class Failures:
    """Errors of files that others stand beside: those are done, and the last error ends it."""

    def __init__(self) -> None:
        self._errors: list[DefocusError] = []

    def __bool__(self) -> bool:
        return bool(self._errors)

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Keep an error of the block, which ends there."""
        try:
            yield
        except DefocusError as error:
            self.add(error)

    def add(self, error: DefocusError) -> None:
        """Keep an error; the one before is said now."""
        if self._errors:
            console.stderr(f"defocus: {self._errors[-1]}")
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

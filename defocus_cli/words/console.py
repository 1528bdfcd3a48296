"""Output of commands: data on stdout, messages on stderr, and the error of a failed command."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from errno import ENOSPC
from logging import Handler, LogRecord, getLogger
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import click

from defocus_core.errors import (
    DefocusError,
    InputError,
    NotExplained,
    UsageProblem,
    printable,
    reason,
    with_dashes,
)
from defocus_core.io.read_files import spoken
from defocus_core.system.text import version

if TYPE_CHECKING:
    from tqdm import tqdm

T = TypeVar("T")


def stderr(line: str) -> None:
    """Print a line on stderr, above a progress bar; if quiet, only warnings and errors."""
    line = with_dashes(printable(line), Due.keys)
    if Due.quiet and not (line.startswith("defocus: ") or "warning: " in line):
        return
    # A closed stderr must not lose the picture.
    with spoken(), suppress(OSError):
        if "tqdm" in sys.modules and sys.stderr is not None:
            sys.modules["tqdm"].tqdm.write(line, file=sys.stderr)
        else:
            click.echo(line, err=True)


def write_stderr(line: str) -> None:
    """Write a whole line on stderr; Python's own stream ignores what a full disk cuts off.

    Raises:
        OSError: the line was not wholly written.
    """
    try:
        number = sys.stderr.fileno()
    except (AttributeError, OSError, ValueError):  # closed, or no file
        click.echo(line, err=True)
        return
    data = f"{line}\n".encode(sys.stderr.encoding, "backslashreplace")
    while data:
        data = data[os.write(number, data) :]


def bar(unit: str, total: int | None = None, of: Iterable[T] | None = None) -> tqdm[T]:
    """A progress bar on stderr, if that is a terminal, which counts the items of an iterable."""
    from tqdm import tqdm

    hidden = not _is_watched()
    tqdm.monitor_interval = 0  # a thread, of which there may be no more, and Python warns
    return tqdm(of, total=total, unit=unit, file=sys.stderr, leave=False, disable=hidden)


def _is_watched() -> bool:
    # None if the parent process closed it
    return sys.stderr is not None and sys.stderr.isatty() and not Due.quiet


class ToStderr(Handler):
    """A handler that prints messages of the library on stderr."""

    def emit(self, record: LogRecord) -> None:
        """Print the message of a record."""
        stderr(record.getMessage())


def log_to_stderr() -> None:
    """Print messages of the library on stderr from now on."""
    logger = getLogger("defocus_core")
    if not any(isinstance(handler, ToStderr) for handler in logger.handlers):
        logger.addHandler(ToStderr())


def stdout(*lines: str) -> None:
    """Print lines on stdout."""
    for line in lines:
        _print(with_dashes(printable(line), Due.keys))


class Due:
    """State of the running command: whether it must still print JSON, and whether it is quiet."""

    json = False
    quiet = False
    keys: ClassVar[Mapping[str, str]] = {}  # names of options by their keys in a jobs file


def name_keys() -> None:
    """Name options by the keys of the jobs file in messages from now on."""
    from defocus_core.request.jobs_file import KEYS

    Due.keys = KEYS


def print_json(**document: Any) -> None:
    """Print a JSON document on stdout, which begins with the version."""
    Due.json = False
    text = json.dumps({"defocus": version(), **document}, indent=1, allow_nan=False)
    _print(with_dashes(text.replace(r"\u2039", "‹").replace(r"\u203a", "›"), Due.keys))


def require_stdout() -> None:
    """Raise an error if stdout is closed."""
    if sys.stdout is None:  # closed by the parent process
        remedy = "send it to a file or to another program"
        raise InputError("unreadable", "is closed", remedy, path="stdout")


def _print(text: str) -> None:
    require_stdout()
    try:
        if _is_watched() and "tqdm" in sys.modules and sys.stdout.isatty():
            sys.modules["tqdm"].tqdm.write(text)  # above the progress bar
        else:
            click.echo(text)
    except BrokenPipeError:
        raise
    except OSError as error:
        remedy = "free some space" if error.errno == ENOSPC else "check where it leads"
        raise InputError(
            "unwritable", f"cannot be written: {reason(error)}", remedy, path="stdout"
        ) from error


def exit_code_of(error: BaseException) -> int:
    """The exit code: 1 for faults or a pair that no lens explains, 2 for usage, 3 for files."""
    if isinstance(error, UsageProblem):
        return 2
    is_of_files = isinstance(error, (DefocusError, OSError))
    return 3 if is_of_files and not isinstance(error, NotExplained) else 1


class Interrupted(click.ClickException):
    """The user pressed Ctrl-C; exit code 130."""

    exit_code = 130


class Failures:
    """Errors of single files: other files are still done, and the last error ends the command."""

    def __init__(self) -> None:
        self._errors: list[DefocusError] = []

    def __bool__(self) -> bool:
        return bool(self._errors)

    @contextmanager
    def kept(self) -> Iterator[None]:
        """A context that keeps the error of its block instead of raising the error."""
        try:
            yield
        except DefocusError as error:
            self.add(error)

    def add(self, error: DefocusError) -> None:
        """Keep an error, and print the error that was kept before."""
        if self._errors:
            stderr(f"defocus: {self._errors[-1]}")
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

"""What is printed: data on stdout, words on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from errno import ENOSPC
from itertools import count
from logging import Handler, LogRecord, getLogger
from typing import TYPE_CHECKING, Any, TypeVar

import click

from defocus_core.errors import InputError, printable, reason, with_dashes
from defocus_core.io.safe_files import spoken
from defocus_core.system.text import version

if TYPE_CHECKING:
    from tqdm import tqdm

T = TypeVar("T")


def stderr(line: str) -> None:
    """One line on stderr, above the progress bar if there is one; if quiet, only of trouble."""
    line = with_dashes(printable(line))
    if Due.quiet and not (line.startswith("defocus: ") or "warning: " in line):
        return
    # A closed stderr is no reason to lose the picture.
    with spoken(), suppress(OSError):
        if "tqdm" in sys.modules and sys.stderr is not None:
            sys.modules["tqdm"].tqdm.write(line, file=sys.stderr)
        else:
            click.echo(line, err=True)


def bar(unit: str, total: int | None = None) -> tqdm[Any]:
    """A progress bar on stderr, if that is a terminal."""
    from tqdm import tqdm

    return tqdm(total=total, unit=unit, file=sys.stderr, leave=False, disable=not _is_watched())


def watch(items: Iterable[T], unit: str, total: int) -> Iterable[T]:
    """Items, counted on a progress bar on stderr, if that is a terminal."""
    if not _is_watched():
        return items
    from tqdm import tqdm

    watched: Iterable[T] = tqdm(items, total=total, unit=unit, file=sys.stderr, leave=False)
    return watched


def _is_watched() -> bool:
    # None: closed by whoever started us.
    return sys.stderr is not None and sys.stderr.isatty() and not Due.quiet


class ToStderr(Handler):
    """Says what the library logs."""

    def emit(self, record: LogRecord) -> None:
        """Say the message of a record."""
        stderr(record.getMessage())


def log_to_stderr() -> None:
    """From now on, what the library logs is said on stderr."""
    logger = getLogger("defocus_core")
    if not any(isinstance(handler, ToStderr) for handler in logger.handlers):
        logger.addHandler(ToStderr())


def stdout(*lines: str) -> None:
    """Lines on stdout."""
    for line in lines:
        _print(with_dashes(printable(line)))


class Due:
    """Whether the command that runs has yet to print a JSON document, and says only trouble."""

    json = False
    quiet = False


def print_json(**document: Any) -> None:
    """One JSON document on stdout, which names the version first."""
    Due.json = False
    document = {"defocus": version(), **document}
    _print(_json(document, indent=1))


def _json(value: Any, indent: int | None = None) -> str:
    text = json.dumps(value, indent=indent, allow_nan=False)
    return with_dashes(text.replace(r"\u2039", "‹").replace(r"\u203a", "›"))


@contextmanager
def json_rows(name: str, **head: Any) -> Iterator[tuple[Callable[[Any], None], dict[str, Any]]]:
    """One JSON document that is printed as it grows: a list, a line for each of its rows.

    Args:
        name: of the list.
        head: what the document says before it.

    Yields:
        What prints a row, and a mapping of what the document is to say at its end; it ends
        whatever happens.
    """
    Due.json = False
    tail: dict[str, Any] = {}
    head = {"defocus": version(), **head}
    _print(f'{_json(head)[:-1]}, "{name}": [')
    rows = count()
    try:
        yield lambda row: _print(f"{',' if next(rows) else ' '}{_json(row)}"), tail
    finally:
        _print(f"], {_json(tail)[1:]}" if tail else "]}")


def _print(text: str) -> None:
    if sys.stdout is None:  # closed by whoever started us
        raise InputError(
            "unreadable", "is closed", "send it to a file or to another program", path="stdout"
        )
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

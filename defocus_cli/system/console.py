"""What is printed: data on stdout, words on stderr; counts and durations in words."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from errno import ENOSPC
from functools import cache
from importlib import metadata
from typing import Any

import click

from defocus_cli.system.errors import InputError, printable, reason
from defocus_cli.system.safe_files import spoken


@cache
def version() -> str:
    """The version of the installed package."""
    try:
        return metadata.version("defocus")
    except metadata.PackageNotFoundError:
        return "unknown"


def say(line: str) -> None:
    """One line on stderr, above the progress bar if there is one."""
    line = printable(line)
    # A closed stderr is no reason to lose the picture.
    with spoken(), suppress(OSError):
        if "tqdm" in sys.modules and sys.stderr is not None:
            sys.modules["tqdm"].tqdm.write(line, file=sys.stderr)
        else:
            click.echo(line, err=True)


def tell(line: str) -> None:
    """One line on stdout.

    Raises:
        InputError: it cannot be written.
        BrokenPipeError: who read it has gone.
    """
    _print(printable(line))


class Due:
    """Whether the command that runs has yet to print a JSON document."""

    json = False


def print_json(**document: Any) -> None:
    """One JSON document on stdout, which names the version first.

    Raises:
        InputError: it cannot be written.
        BrokenPipeError: who read it has gone.
    """
    Due.json = False
    _print(json.dumps({"defocus": version(), **document}, indent=1, allow_nan=False))


def _print(text: str) -> None:
    if sys.stdout is None:  # closed by whoever started us
        raise InputError("stdout", "is closed", "send it to a file or to another program")
    try:
        click.echo(text)
    except BrokenPipeError:
        raise
    except OSError as error:
        remedy = "free some space" if error.errno == ENOSPC else "check where it leads"
        raise InputError("stdout", f"cannot be written: {reason(error)}", remedy) from error


def counted(count: int, one: str, several: str = "") -> str:
    """A number of things: ``1 job``, ``2 jobs``."""
    return f"{count} {one if count == 1 else several or f'{one}s'}"


def duration(seconds: float) -> str:
    """Like ``0.3 s``, ``12 s``, ``3 min 20 s`` or ``2 h 5 min``."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"

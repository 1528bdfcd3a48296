"""TOML files whose every key must be known."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from defocus_cli.jobs.quantities import QuantityError
from defocus_cli.system.errors import InputError, UsageProblem, did_you_mean, reason

T = TypeVar("T")
LARGEST_FILE = 2**20  # bytes


def read_toml(file: Path, *, what: str, remedy: str, largest: int = LARGEST_FILE) -> dict[str, Any]:
    """The tables and values of a TOML file.

    Args:
        file: the file.
        what: what the file should be, like ``lens file``.
        remedy: what to give instead of a file that is none.
        largest: bytes that no such file exceeds.

    Raises:
        InputError: the file cannot be read as TOML.
    """
    try:
        return tomllib.loads(_text(file, what, remedy, largest))
    except (ValueError, RecursionError) as error:  # ValueError: a number of 5000 digits
        raise InputError(file, f"is not TOML: {reason(error)}", "mend that line") from None


@dataclass(frozen=True)
class Table:
    """A table of a TOML file."""

    file: Path
    name: str
    values: Mapping[str, Any] = field(default_factory=dict)

    def place(self, key: str) -> str:
        """File, table and key, for errors."""
        return f"{self.file}: [{self.name}] {key}"

    def refuse_unknown(self, known: Sequence[str]) -> None:
        """Refuse keys other than ``known``.

        Raises:
            UsageProblem: naming the key, and the known one that it resembles.
        """
        for key in self.values:
            if key not in known:
                remedy = did_you_mean(
                    key.replace("_", "-"), known, f"[{self.name}] knows {', '.join(known)}"
                )
                raise UsageProblem(f"{self.file}: [{self.name}]", f"unknown key '{key}'", remedy)

    def text(self, key: str) -> str | None:
        """A text, or None."""
        value = self.values.get(key)
        if value is None:
            return None
        if not isinstance(value, str) or not value or "\0" in value:
            raise UsageProblem(self.place(key), f"{value!r} is not a text", "write it in quotes")
        return value

    def parsed(self, key: str, parse: Callable[[str], T]) -> T | None:
        """A quantity, or None."""
        value = self.text(key)
        if value is None:
            return None
        try:
            return parse(value)
        except QuantityError as error:
            raise UsageProblem(self.place(key), error.problem, error.remedy) from None

    def choice(self, key: str, known: Sequence[str]) -> str | None:
        """One of the ``known`` words, or None."""
        value = self.values.get(key)
        if value is None or value in known:
            return value
        remedy = did_you_mean(str(value), known, f"choose from {', '.join(known)}")
        raise UsageProblem(self.place(key), f"'{value}' is not known", remedy)

    def flag(self, key: str) -> bool | None:
        """True or false, or None."""
        value = self.values.get(key)
        if value is None or isinstance(value, bool):
            return value
        raise UsageProblem(self.place(key), f"{value!r} is neither true nor false", "write true")

    def whole(self, key: str, least: int, most: int | None = None) -> int | None:
        """A whole number of at least ``least`` and at most ``most``, or None."""
        value = self.values.get(key)
        if value is None or (type(value) is int and least <= value <= (most or value)):
            return value
        limits = f"{least} or more" if most is None else f"{least} to {most}"
        problem = f"{value!r} is not a whole number of {limits}"
        raise UsageProblem(self.place(key), problem, f"write it like {max(least, 1)}")


def table(file: Path, tables: Mapping[str, Any], name: str) -> Table:
    """The table of that name; empty if there is none.

    Raises:
        UsageProblem: there is a value of that name that is no table.
    """
    values = tables.get(name, {})
    if not isinstance(values, dict):
        remedy = f"write [{name}] above the keys that belong to it"
        raise UsageProblem(f"{file}: {name}", "is not a table", remedy)
    return Table(file, name, values)


def _text(file: Path, what: str, remedy: str, largest: int) -> str:
    try:
        with file.open("rb") as opened:
            data = opened.read(largest + 1)  # not all of /dev/zero
        text = data.decode("utf-8-sig")
    except OSError as error:
        raise InputError(file, f"cannot be read: {reason(error)}", remedy) from None
    except UnicodeDecodeError:
        raise InputError(file, "is not a text file", remedy) from None
    if "\0" in text or len(data) > largest:
        raise InputError(file, f"is not a {what}", remedy)
    return text

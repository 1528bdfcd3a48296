"""Reading of TOML files in which unknown keys are errors."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from defocus_core.errors import InputError, Place, UsageProblem, cannot_read, did_you_mean, reason
from defocus_core.gone import remedy_of_key
from defocus_core.io.read_files import open_plain
from defocus_core.request.quantities import read_at, text_of

T = TypeVar("T")
LARGEST_FILE = 2**26  # bytes
_MAX_DOTS = 10**8  # greatest sum of squared numbers of dots of lines


def read_toml(file: Path, *, what: str, remedy: str) -> dict[str, Any]:
    """Parse a TOML file; `what` (the kind of file) and `remedy` are for errors."""
    return parsed_toml(read_bytes(file, what, remedy), file, what=what, remedy=remedy)


def parsed_toml(data: bytes, file: Path, *, what: str, remedy: str) -> dict[str, Any]:
    """Parse the bytes of a TOML file; `what` (the kind of file) and `remedy` are for errors."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError("malformed", "is not a text file", remedy, path=file) from None
    if "\0" in text or len(data) > LARGEST_FILE:
        raise InputError("malformed", f"is not a {what}", remedy, path=file)
    try:
        return loads(text)
    except (ValueError, RecursionError) as error:  # ValueError for a number of 5000 digits
        remedy = "mend that line"
        raise InputError("malformed", f"is not TOML: {reason(error)}", remedy, path=file) from None


def loads(text: str) -> dict[str, Any]:
    """Parse TOML text; unlike `tomllib.loads`, it refuses texts that would take much memory."""
    # A key of n parts takes n² bytes of memory; lines of ordinary names stay far below.
    if sum(line.count(".") ** 2 for line in text.split("\n")) > _MAX_DOTS:
        raise ValueError("it has a line of too many dots")
    values = tomllib.loads(text)
    _refuse_huge(values)
    return values


@dataclass(frozen=True)
class Table:
    """A table of a TOML file."""

    file: Path
    name: str
    values: Mapping[str, Any] = field(default_factory=dict)

    def place(self, key: str = "") -> Place:
        """The place of a key, or of the table if `key` is empty, for errors."""
        return Place(self.file, f"[{self.name}]", key)

    def refuse_unknown(self, known: Sequence[str]) -> None:
        """Raise UsageProblem if the table has a key that is not in ``known``."""
        refuse_unknown(self.values, known, self.place(), f"[{self.name}]")

    def text(self, key: str) -> str | None:
        """The string value of a key; None if the key is missing."""
        value = self.values.get(key)
        if value is None:
            return None
        if not isinstance(value, str) or not value or "\0" in value:
            problem = f"{value!r} is not a text"
            raise UsageProblem("malformed", problem, "write it in quotes", path=self.place(key))
        return value

    def texts(self, key: str) -> list[str]:
        """The value of a key, a string or a list of strings, as a list; empty if it is missing."""
        value = self.values.get(key, [])
        names = value if isinstance(value, list) else [value]
        if not all(isinstance(name, str) and name and "\0" not in name for name in names):
            problem, remedy = f"{value!r:.40} does not name files", f'write {key} = "a.csv"'
            raise UsageProblem("malformed", problem, remedy, path=self.place(key))
        return names

    def parsed(self, key: str, parse: Callable[[str], T]) -> T | None:
        """The value of a key, parsed by `parse`; None if the key is missing."""
        if key not in self.values:
            return None
        return read_at(self.place(key), parse, text_of(self.values[key]))

    def flag(self, key: str) -> bool | None:
        """The boolean value of a key; None if the key is missing."""
        value = self.values.get(key)
        if value is None or isinstance(value, bool):
            return value
        problem = f"{value!r} is neither true nor false"
        raise UsageProblem("malformed", problem, "write true", path=self.place(key))


def refuse_unknown(
    keys: Iterable[str], known: Sequence[str], where: Place | Path, owner: str, what: str = "key"
) -> None:
    """Raise UsageProblem for the first of `keys` that is not in `known`.

    `where` is the place for the error, `owner` the table or file, and `what` the word for a key.
    """
    for key in keys:
        if key not in known:
            known_as = f"{owner} knows {', '.join(known)}"
            remedy = did_you_mean(key.replace("_", "-"), known, known_as)
            remedy = remedy_of_key(key, owner, remedy)
            raise UsageProblem("unknown-name", f"unknown {what} '{key}'", remedy, path=where)


def table(file: Path, tables: Mapping[str, Any], name: str) -> Table:
    """The table `name` of a file; an empty one if it is missing."""
    values = tables.get(name, {})
    if not isinstance(values, dict):
        remedy = f"write [{name}] above the keys that belong to it"
        raise UsageProblem("malformed", "is not a table", remedy, path=file, field=name)
    return Table(file, name, values)


def _refuse_huge(value: Any) -> None:
    """Raise ValueError for integers beyond 64 bits, which TOML forbids, at any depth of a value."""
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ValueError("it has a whole number of more than 64 bits")
    for each in value.values() if isinstance(value, dict) else value if type(value) is list else ():
        _refuse_huge(each)


def read_bytes(file: Path, what: str, remedy: str) -> bytes:
    """The bytes of a TOML file, at most `LARGEST_FILE` + 1 of them."""
    try:
        with open_plain(file) as opened:
            return opened.read(LARGEST_FILE + 1)  # bounded, as for /dev/zero
    except OSError as error:
        raise cannot_read(file, error, remedy) from None

"""Mistakes of users as data: code, path, field, problem and remedy."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


# The codes of errors, for programs, and their meaning.
CODES = {
    "ambiguous": "a name or value has several meanings; the remedy names them",
    "changed": "a file changed while it was read",
    "circular-link": "a symbolic link leads to a folder that contains it",
    "contradiction": "two options or values exclude each other",
    "damaged": "a file is truncated, or lacks data that its header promises",
    "deep-data": "an EXR is deep where a flat one is needed, or the reverse",
    "duplicate": "one name is used for two things",
    "empty": "nothing matches, or the input is empty",
    "exists": "an output file exists already",
    "focus-too-near": "the focus is nearer than the focal length",
    "idle-option": "an option has no effect beside the others",
    "in-use": "another process is writing to this place",
    "invalid-depth": "pixels have no depth",
    "link": "a file or folder of OUT is a symbolic link",
    "malformed": "a value or a file has invalid syntax",
    "missing-frames": "frames of a shot are missing",
    "missing-option": "a required option is missing",
    "needs-extra": "an optional package that is needed is not installed",
    "no-color": "a file has no colour",
    "no-depth": "a file has no depth",
    "no-gpu": "a GPU is asked for, and there is none",
    "no-rule": "the meaning of the numbers in a depth file is unknown",
    "no-scene": "the name of a picture does not match the pattern `scene` of `[split]`",
    "no-space": "the disk is full",
    "no-such-channel": "a file has no channel, layer or array of that name",
    "no-such-part": "a file has no part, page or frame of that number",
    "no-such-view": "a file has no view of that name",
    "no-valid-depth": "no pixel has a depth to focus on",
    "not-explained": "`fit`: no blur explains the difference between the pictures",
    "not-finite": "pixels are NaN or infinite",
    "not-found": "a file or folder does not exist",
    "not-numbers": "the values are not real numbers",
    "not-one-channel": "depth has several different channels",
    "not-square": "pixels are not square where they must be",
    "not-utf-8": "a text or a name is not UTF-8",
    "one-file": "one output file is named for several files",
    "other-version": "another process of the batch runs another version of defocus",
    "out-of-memory": "a picture does not fit into memory",
    "out-of-range": "a number is out of range",
    "radii": "a file holds radii of the blur where depth is needed, or the reverse",
    "replaces-input": "an output would replace an input",
    "too-blurred": "the blur of a pixel is larger than any picture",
    "too-large": "a file or a request is larger than defocus handles",
    "unknown-name": "a name is unknown",
    "unknown-unit": "the unit of numbers is unknown",
    "unreachable": "the Dask scheduler cannot be reached",
    "unreadable": "a file cannot be read",
    "unsupported": "a file type is not supported",
    "unwritable": "a file cannot be written",
    "whole-batch": "an option needs the whole batch, and `--shard` names a part",
    "worker-died": "a process that rendered was killed or crashed",
    "wrong-shape": "an array has another number of dimensions",
    "wrong-size": "two things have different sizes",
    "wrong-type": "a file is of the wrong type",
}

_LONGEST_WORD = 200  # characters of a path in a message
_OPTION = re.compile("‹([a-z][a-z-]*)›")
# The parts in which notes of one kind differ: a file, numbers, units of length, "pixel(s)".
_FILE_OR_NUMBER = re.compile(r"^\S+\.\w+: |\d[\d.,]*(?: ?(?:[cmk]?m\b|pixels?\b))?")


@dataclass(frozen=True, slots=True)
class Place:
    """The place of a value: a file and a key in it, or an option of the caller if there is no path.

    Attributes:
        path: the file, or a name if there is no file.
        table: a table of the file, in brackets, or a line of the file.
        field: the option or key.
    """

    path: Path | str | None = None
    table: str = ""
    field: str = ""

    def with_field(self, field: str) -> Place:
        """The place of another key in the same file, table or line."""
        return Place(self.path, self.table, field)

    def __str__(self) -> str:
        if self.path is None:
            return f"‹{self.field}›"
        between = " " if self.table.endswith("]") else ": "
        key = between.join(filter(None, (self.table, self.field)))
        path = shortened(str(self.path))
        return f"{path}: {key}" if key else path


CALLER = Place()


class DefocusError(Exception):
    """A mistake of a user, as data: the problem, its place, and the remedy.

    Texts name options in angle quotes, like ‹focus›: the command line writes ``--focus``.

    Args:
        code: the kind of mistake, a key of `CODES`.
        problem: what is wrong, without a full stop.
        remedy: what to do about it; the empty string if there is nothing to propose.
        path: the file concerned, or a name if there is no file, or a `Place` in a file.
        field: the option or key concerned, in the file if there is one.
        value: the value of the option, if it is a part of the mistake.
    """

    def __init__(
        self,
        code: str,
        problem: str,
        remedy: str = "",
        *,
        path: str | Path | Place | None = None,
        field: str = "",
        value: str = "",
    ) -> None:
        super().__init__(code, problem)
        self.code = code
        self.problem = one_line(problem)
        self.remedy = one_line(remedy)
        place = path if isinstance(path, Place) else Place(path)
        named = None if place.path is None else printable(str(place.path))
        self.place = Place(named, place.table, field or place.field)
        self.value = printable(value)

    @property
    def path(self) -> str | None:
        """The file concerned; None for an option that the caller gave."""
        return None if self.place.path is None else str(self.place.path)

    @property
    def field(self) -> str:
        """The option or key concerned; if there is none, the table or line."""
        return self.place.field or self.place.table

    @property
    def subject(self) -> str:
        """The file, option or key with the mistake, in words that begin the message."""
        return f"{self.place} {self.value}".rstrip() if self.path is None else str(self.place)

    def __str__(self) -> str:
        line = f"{self.subject}: {self.problem}"
        return f"{line}; {self.remedy}" if self.remedy else line

    def __reduce__(self) -> tuple[Any, ...]:
        # Workers return these errors, but by default an exception unpickles from its arguments
        # alone.
        return type(self), (self.code, self.problem, self.remedy), self.__dict__


class UsageProblem(DefocusError):  # noqa: N818 - click has a UsageError
    """Options or values are invalid."""


class InputError(DefocusError):
    """A file cannot be read, understood or written."""


class TooLarge(InputError):  # noqa: N818 - it is said of a file
    """A picture does not fit into memory."""


class NotExplained(DefocusError):  # noqa: N818 - it is said of pictures
    """No lens that was found explains the difference of the pictures."""


def cannot_read(path: Path, error: OSError, remedy: str) -> InputError:
    """The error for a file that does not exist or that the system refuses to read."""
    code = "not-found" if isinstance(error, FileNotFoundError) else "unreadable"
    return InputError(code, f"cannot be read: {reason(error)}", remedy, path=path)


def one_line(text: object) -> str:
    """``text`` as one line: blanks and line breaks become single blanks, long words `shortened`."""
    return printable(" ".join(map(shortened, str(text).split())))


def shortened(text: str) -> str:
    """The word, such as a path, with its middle replaced by … if it is very long."""
    half = _LONGEST_WORD // 2
    return text if len(text) <= _LONGEST_WORD else f"{text[:half]}…{text[1 - half :]}"


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


def lacks_memory(error: BaseException) -> bool:
    """Whether an error means that the system refused memory, also to a C library."""
    return isinstance(error, TooLarge | MemoryError) or any(
        words in str(error) for words in ("can't allocate memory", "failed to map segment")
    )


def reason(error: BaseException) -> str:
    """The message of an exception of any type, as one clause without a full stop."""
    message = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return one_line(message).rstrip(".")


def first_line(path: Path, text: str) -> str:
    """The first line of a message of OpenImageIO, shortened, without the name of the file."""
    for named in (f' ("{path}")', f" ({path})", f"{path}: ", f": {path}"):
        text = text.replace(named, "")
    lines = text.replace(f'"{path}"', "it").strip().splitlines() or ["no reason given"]
    return one_line(lines[0]).rstrip(".")[:120]


def note_kind(note: str) -> str:
    """The kind of a note: its text with N in place of the file, numbers and units."""
    return _FILE_OR_NUMBER.sub("N", note)


class NoteKinds:
    """Notes of many pictures, counted by kind; notes of one kind differ in file, numbers, units."""

    def __init__(self) -> None:
        self._found: dict[str, tuple[str, int]] = {}

    def add(self, *notes: str) -> None:
        """Count the notes of one picture, each kind once."""
        for kind, note in {note_kind(note): note for note in notes}.items():
            example, count = self._found.get(kind, (note, 0))
            # the first in order, so that the example does not depend on which job ended first
            self._found[kind] = min(example, note), count + 1

    @property
    def counts(self) -> dict[str, int]:
        """The number of pictures with each kind of note, by an example; the commonest first."""
        return dict(sorted(self._found.values(), key=lambda found: (-found[1], found[0])))


def with_dashes(text: str, keys: Mapping[str, str] | None = None) -> str:
    """``text`` with options as written on a command line, or as ``keys`` maps their names."""
    return _OPTION.sub(lambda option: (keys or {}).get(option[1], f"--{option[1]}"), text)

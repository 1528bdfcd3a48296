"""The record of a job, a line of a journal: what it was asked, what it was made of, how it ended.

`record_of` makes a `Record` of a line and `values_of` the values of one; `FIELDS` has all fields,
and those of the tables in them: what each may hold, and what it is, for the help, too.
A journal may come from anywhere, so each value is checked: its type, its range, that it is finite.
An output is a file in the folder of its kind in OUT, and no other file: outputs are packed into
shards, and removed when they are replaced. Index and ``--json`` are views of records.
"""

from __future__ import annotations

import errno
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Literal, NamedTuple

from defocus_core.errors import (
    DefocusError,
    InputError,
    TooLarge,
    UsageProblem,
    one_line,
    reason,
)
from defocus_core.io.below import path_fault
from defocus_core.io.safe_files import MALFORMED
from defocus_core.request.job import SPLIT_NAME
from defocus_core.request.lens import lens_record_words
from defocus_core.request.output_kinds import KINDS
from defocus_core.request.parameters import RECORDED

FAILURES = {
    "input-unusable": "an input is missing, damaged, or not what it is said to be",
    "settings-unusable": "the settings make no sense for this picture or machine",
    "out-of-memory": "the picture does not fit into memory",
    "output-unwritable": "an output cannot be written",
    "no-space": "no space is left where the outputs go",
    "worker-died": "the process that computed it died, several times",
    "fault": "a fault of defocus itself",
}
STATUSES = ("ok", "failed")
_REJECTED = "rejected"  # as early versions called some jobs that failed
Stage = Literal["read", "render", "write"]
_FULL = (errno.ENOSPC, errno.EDQUOT)


class Stamp(NamedTuple):
    """A file as it was: what tells whether it is still the same."""

    path: str = ""  # of an output relative to OUT; of an input as given if absolute, else to OUT
    size: int | None = None  # bytes
    mtime_ns: int | None = None  # time of modification; None of a file too new to go by it
    blake2b: str | None = None  # hash of its bytes

    @property
    def values(self) -> dict[str, Any]:
        """What is known of it, for JSON."""
        return {key: value for key, value in self._asdict().items() if value is not None}


Stamps = Mapping[str, Stamp]  # by role of an input, or kind of an output and kind.preview


@dataclass(frozen=True, kw_only=True)
class Taken:
    """A picture that was taken: its outputs are in place."""

    inputs: Stamps
    outputs: Stamps
    lens: Mapping[str, Any]  # what it turned out to be, as `lens_record`
    size: tuple[int, int]
    coc_px: tuple[float, float]
    color_note: str = ""
    depth_note: str
    depth_repair: Mapping[str, Any] | None = None
    device: str
    measures: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...]
    seconds: Mapping[str, float]
    stats: Mapping[str, float] = field(default_factory=dict)  # of the renderer; not in the journal
    status = "ok"
    reason = None
    message = ""


@dataclass(frozen=True)
class Failed:
    """A job that made nothing."""

    reason: str
    message: str
    inputs: Stamps = field(default_factory=dict)
    outputs: Stamps = field(default_factory=dict)
    trace: str = ""  # the traceback of a fault; not in the journal
    error: Exception | None = None  # in the process that raised it; not in the journal
    status = "failed"
    warnings = ()
    seconds: ClassVar[Mapping[str, float]] = {}

    def __getstate__(self) -> dict[str, Any]:
        """What is sent to another process."""
        return {**self.__dict__, "error": None}


End = Taken | Failed


@dataclass(frozen=True, kw_only=True)
class Record:
    """How a job ended."""

    sample_id: str
    split: str = ""  # empty for none
    recipe: str
    settings: Mapping[str, Any]
    quality: str
    version: str
    renderer: int | None = None
    finished: str
    end: End

    def __getitem__(self, name: str) -> Any:
        """A field by its name in the journal, as there."""
        return values_of(self)[name]

    @property
    def status(self) -> str:
        """One of `STATUSES`."""
        return self.end.status

    @property
    def taken(self) -> Taken | None:
        """What was taken; None of a job that made nothing."""
        return self.end if isinstance(self.end, Taken) else None

    @property
    def inputs(self) -> Stamps:
        """Its inputs by role."""
        return self.end.inputs

    @property
    def outputs(self) -> Stamps:
        """Its outputs by kind, or kind.preview; of a job that made nothing the paths alone."""
        return self.end.outputs

    def with_files(self, *, inputs: Stamps | None = None, outputs: Stamps | None = None) -> Record:
        """The record with other inputs or outputs."""
        end = replace(self.end, inputs=inputs or self.inputs, outputs=outputs or self.outputs)
        return replace(self, end=end)


_Check = tuple[Callable[[Any], bool], str]  # whether a value is right, and what is wrong if not


class Field(NamedTuple):
    """A field of records, or of a table within them: what it may hold, and what it is."""

    types: tuple[type, ...]  # in JSON
    help: str = ""
    of: str = ""  # ok: of pictures alone; old: it may be missing, as early versions had it not
    fields: Mapping[str, Field] = MappingProxyType({})  # of a table those that are known
    named: bool = False  # it is a table of such tables, each by its name
    items: tuple[type, ...] = ()  # what a list holds
    check: _Check | None = None  # of what has these types


def now() -> str:
    """The time, UTC, as records have it."""
    return datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="milliseconds")


def is_moment(text: str) -> bool:
    """Whether a text is a time with its zone: one without cannot be compared."""
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


def _is_said(lens: Mapping[str, Any]) -> bool:
    """Whether words can be made of a lens: what its effects hold, their rows know."""
    if len({lens[key] is None for key in _OPTICS}) > 1:
        return False
    if effects := lens.keys() - _LENS.keys():
        if any(type(lens[key]) not in (*_NUMBER, str, bool, _NONE) for key in effects):
            return False
        with suppress(*MALFORMED):
            return bool(lens_record_words(lens))
        return False
    return True


def _are_measures(measures: Mapping[str, Any] | None) -> bool:
    numbers = (v for k, v in (measures or {}).items() if k.endswith(("_px", "_share")))
    return all(type(number) in (*_NUMBER, _NONE) for number in numbers)


_NONE, _NUMBER, _TEXT, _TABLE = type(None), (int, float), (str,), (dict,)
_OPTICS = tuple(key for key, row in RECORDED.items() if row.is_optics)  # none beside radii
_DRAW = {
    **dict.fromkeys(("seed", "index"), Field((int,))),
}
_LENS = {
    **{key: Field((*_NUMBER, *([_NONE] if key in _OPTICS else []))) for key in RECORDED},
    "blades": Field((int,)),
    "focus_mm": Field(
        (*_NUMBER, str, _NONE),
        check=(lambda focus: focus == "inf" or type(focus) is not str, "neither a number nor inf"),
    ),
    "focus_at_px": Field(
        (list,), of="old", check=(lambda place: len(place) == 2, "not two numbers")
    ),
    "focus_percentile": Field(_NUMBER, of="old"),
    "draw": Field(_TABLE, of="old", fields=_DRAW),
}
_SETTINGS = {
    **dict.fromkeys(("stem", "suffix", "quality"), Field(_TEXT, of="old")),
    **dict.fromkeys(("lens", "reading", "outputs", "shot"), Field(_TABLE, of="old")),
}
_STAMP = {
    "path": Field(_TEXT),
    **dict.fromkeys(("size", "mtime_ns"), Field((int,), of="old")),
    "blake2b": Field(_TEXT, of="old"),
}
_SECONDS = {
    "render": Field(_NUMBER, of="ok"),
    **dict.fromkeys(("read", "write", "cpu"), Field(_NUMBER, of="old")),
}
FIELDS: Mapping[str, Field] = {
    "sample_id": Field(
        _TEXT,
        "name of the sample, the stem of its files; `stem` of `--json`",
        check=(lambda name: "/" not in name, "which has a slash"),
    ),
    "split": Field(
        _TEXT,
        "its split, if there are any",
        "old",
        check=(lambda split: not split or bool(SPLIT_NAME.fullmatch(split)), "which is not a name"),
    ),
    "recipe": Field(_TEXT, "hash of all that decides its outputs but the bytes of the inputs"),
    "status": Field(
        _TEXT,
        "`ok` or `failed`",
        check=(
            lambda status: status in (*STATUSES, _REJECTED),
            f"not one of {', '.join(STATUSES)}",
        ),
    ),
    "reason": Field((str, _NONE), "a reason of `defocus help exit-codes`, null if ok"),
    "message": Field((str, _NONE), "the reason for people, empty if ok"),
    "settings": Field(
        _TABLE, "what was asked for: lens, reading, outputs, quality", fields=_SETTINGS
    ),
    "inputs": Field(
        _TABLE,
        "by role path (relative to OUT, or absolute), size, mtime_ns, blake2b",
        fields=_STAMP,
        named=True,
        check=(lambda inputs: "color" in inputs, "among which is no color"),
    ),
    "outputs": Field(
        _TABLE,
        "by kind or kind.preview path in OUT; if ok, size, mtime_ns, blake2b",
        fields=_STAMP,
        named=True,
    ),
    "lens": Field(
        _TABLE,
        "the lens with its focus; lengths in mm, infinity is `inf`",
        "ok",
        fields=_LENS,
        check=(_is_said, "of which no words can be made"),
    ),
    "size": Field(
        (list,),
        "width and height in px",
        "ok",
        items=(int,),
        check=(lambda size: len(size) == 2 and min(size) > 0, "not two numbers above 0"),
    ),
    "coc_px": Field(
        (list,),
        "least and greatest signed radius of the blur, in px",
        "ok",
        items=_NUMBER,
        check=(lambda ends: len(ends) == 2, "not two numbers"),
    ),
    "color_note": Field(_TEXT, "how the colour was read", "old"),
    "depth_note": Field(_TEXT, "how the depth was read and repaired", "ok"),
    "depth_repair": Field(
        (dict, _NONE),
        "what was repaired, in numbers",
        "old",
        fields={"kinds": Field((list,), of="old", items=_TEXT)},
    ),
    "device": Field(_TEXT, "where it was rendered", "ok"),
    "measures": Field(
        (dict, _NONE),
        "radii, and shares of pixels, for the index",
        "old",
        check=(_are_measures, "not all of which are numbers"),
    ),
    "warnings": Field((list,), "what was taken for granted", items=_TEXT),
    "seconds": Field(_TABLE, "of `read`, `render` and `write`; `cpu` of rendering", "", _SECONDS),
    "quality": Field(_TEXT, "of the rendering"),
    "version": Field(_TEXT, "of defocus"),
    "renderer": Field((int, _NONE), "version of the renderer", "old"),
    "finished": Field(
        _TEXT,
        "when, UTC; the order of the lines decides",
        check=(is_moment, "which is not a time with a zone"),
    ),
}


class _Checker:
    """Checks tables of some fields; what keys and types were right is known, and not looked at."""

    _MOST = 10_000

    def __init__(self, fields: Mapping[str, Field], *, is_ok: bool, before: str = "") -> None:
        self.fields = {key: row for key, row in fields.items() if is_ok or row.of != "ok"}
        self.before, self.known = before, set[tuple[Any, ...]]()
        rows = self.fields.items()
        self.checks = [(key, *row.check) for key, row in rows if row.check]
        self.lists = [(key, {*row.items}) for key, row in rows if row.items]
        self.within = [
            (key, row.named, _Checker(row.fields, is_ok=is_ok, before=f"{before}{key}."))
            for key, row in rows
            if row.fields
        ]

    def fault(self, values: Mapping[str, Any], before: str = "") -> str | None:
        """What is wrong with a table, as ``has no lens``; None if nothing is."""
        before, shape = before or self.before, (*values, *map(type, values.values()))
        if shape not in self.known:
            for key, row in self.fields.items():
                if key not in values and row.of != "old":
                    return f"has no {before}{key}"
                if key in values and type(values[key]) not in row.types:
                    return _wrong(before, key, values, "which is of a wrong type")
            if len(self.known) < self._MOST:
                self.known.add(shape)
        for key, types in self.lists:
            if key in values and not types.issuperset(map(type, values[key])):
                return _wrong(before, key, values, "which holds what is of a wrong type")
        for key, is_named, checker in self.within:
            if (tables := values.get(key)) is None:
                continue
            for name, table in tables.items() if is_named else [(key, tables)]:
                if type(table) is not dict:
                    return _wrong("", name, tables, "which is of a wrong type")
                if fault := checker.fault(table, f"{name}." if is_named else ""):
                    return fault
        for key, is_right, words in self.checks:
            if key in values and not is_right(values[key]):
                return _wrong(before, key, values, words)
        return None


def _wrong(before: str, key: str, values: Mapping[str, Any], words: str) -> str:
    return f"has the {before}{key} {values[key]!r:.60}, {words}"


_CHECKERS = {is_ok: _Checker(FIELDS, is_ok=is_ok) for is_ok in (False, True)}


def linked_folders(out: Path) -> frozenset[str]:
    """The kinds whose folder in OUT is a link: OUT may be one, what lies below it may not."""
    return frozenset(kind for kind in KINDS if (out / kind).is_symlink())


def output_fault(path: object) -> str | None:
    """What is wrong with the path of an output, as ``leads upwards``; None if it is one of OUT."""
    fault = path_fault(path)
    if fault is not None:
        return fault
    kind, _, name = str(path).partition("/")
    return None if kind in KINDS and name and "/" not in name else "is not a file of a kind in OUT"


def fault_of(values: object, linked: frozenset[str] = frozenset()) -> str | None:
    """What is wrong with a line of a journal, as ``has no lens``; None if it is a record."""
    if not isinstance(values, dict):
        return "is not a record of a job"
    is_ok = values.get("status") == "ok"
    if fault := _CHECKERS[is_ok].fault(values):
        return fault
    if not is_ok and values["reason"] is None:
        return "has no reason, and made nothing"
    for stamp in values["outputs"].values():
        path = stamp["path"]
        if output_fault(path):
            return f"names the output {path!r}, which is not a file of a kind in OUT"
        if (kind := path.partition("/")[0]) in linked:
            return f"names the output {path!r}, but {kind} is a link, and no folder of OUT"
    return None


def record_of(values: Mapping[str, Any]) -> Record:
    """The record of the values of a line of which `fault_of` tells nothing."""
    made = {name: value for name, value in values.items() if value is not None}
    for of in ("inputs", "outputs"):
        stamps = values[of].items()
        made[of] = {name: Stamp(*map(each.get, Stamp._fields)) for name, each in stamps}
    for name in ("size", "coc_px", "warnings"):
        made[name] = tuple(values.get(name, ()))
    kind = Taken if values["status"] == "ok" else Failed
    made["message"] = values["message"] or ""
    end: End = kind(**{name: made[name] for name in _NAMES[kind] if name in made})
    return Record(**{name: made[name] for name in _NAMES[Record] if name in made}, end=end)


# The fields of each type that are in the journal.
_NAMES: Mapping[type, Sequence[str]] = {
    kind: [each.name for each in fields(kind) if each.name in FIELDS]
    for kind in (Taken, Failed, Record)
}


def values_of(record: Record) -> dict[str, Any]:
    """The values of a record, as a line of the journal has them."""
    found = (
        (name, getattr(owner, name))
        for name in FIELDS
        for owner in (record, record.end)
        if hasattr(owner, name)
    )
    values = dict(found)
    for of in ("inputs", "outputs"):
        values[of] = {name: stamp.values for name, stamp in values[of].items()}
    if not record.split:
        del values["split"]
    return values


def failure(error: Exception, stage: Stage, inputs: Stamps) -> Failed:
    """The end of a job of which an exception ended a stage."""
    reason = _reason(error, stage)
    trace = "".join(traceback.format_exception(error)) if reason == "fault" else ""
    return Failed(reason, error_line(error), inputs, trace=trace, error=error)


def error_line(error: BaseException) -> str:
    """An exception in one line, ``SUBJECT: problem; remedy`` where a user can mend it."""
    if isinstance(error, DefocusError):
        return str(error)
    if isinstance(error, OSError) and error.filename:
        return one_line(f"{error.filename}: {reason(error)}")
    return f"unexpected {type(error).__name__}: {reason(error)}"


def _reason(error: BaseException, stage: Stage) -> str:
    system = error if isinstance(error, OSError) else error.__cause__
    if isinstance(system, OSError) and system.errno in _FULL:
        return "no-space"
    if isinstance(error, TooLarge | MemoryError) or "can't allocate memory" in str(error):
        return "out-of-memory"
    if isinstance(error, UsageProblem):
        return "settings-unusable"
    if isinstance(error, InputError | OSError):
        return "output-unwritable" if stage == "write" else "input-unusable"
    return "fault"

"""The record of a job, a line of a journal: what it was asked, what it was made of, how it ended.

`read` makes a `Record` of a line and `written` a line of a `Record`; nothing else knows the keys.
A journal may come from anywhere, so each value is checked: its type, its range, that it is finite.
An output is a file in the folder of its kind in OUT, and no other file: outputs are packed into
shards, and removed when they are replaced. Index and ``--json`` are views of records; `FIELDS` says
what each field is, for the help, too.
"""

from __future__ import annotations

import errno
import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from operator import itemgetter
from pathlib import Path
from typing import Any, Literal, NamedTuple

from defocus_core.errors import (
    DefocusError,
    InputError,
    Rejected,
    TooLarge,
    UsageProblem,
    one_line,
    reason,
)
from defocus_core.io.below import path_fault
from defocus_core.io.safe_files import MALFORMED
from defocus_core.request.lens import lens_record_words
from defocus_core.request.output_kinds import KINDS
from defocus_core.request.parameters import RECORDED
from defocus_core.request.splits import NAME

REJECTIONS = {
    "coc-too-large": "the blur would be larger than max-coc allows",
    "no-valid-depth": "there is nothing to focus on",
    "focus-too-near": "the depth puts the focus nearer than the focal length",
}
FAILURES = {
    "input-unusable": "an input is missing, damaged, or not what it is said to be",
    "settings-unusable": "the settings make no sense for this picture or machine",
    "out-of-memory": "the picture does not fit into memory",
    "output-unwritable": "an output cannot be written",
    "no-space": "no space is left where the outputs go",
    "worker-died": "the process that computed it died, several times",
    "fault": "a fault of defocus itself",
}
STATUSES = ("ok", "rejected", "failed")
Step = Literal["read", "render", "write"]
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


@dataclass(frozen=True)
class Taken:
    """A picture that was taken: its outputs are in place."""

    inputs: Stamps
    outputs: Stamps
    lens: Mapping[str, Any]  # what it turned out to be, as `lens_record`
    size: tuple[int, int]
    coc_px: tuple[float, float]
    color_note: str
    depth_note: str
    depth_repair: Mapping[str, Any] | None
    device: str
    measures: Mapping[str, Any]
    warnings: tuple[str, ...]
    seconds: Mapping[str, float]
    stats: Mapping[str, float] = field(default_factory=dict)  # of the renderer; not in the journal
    status = "ok"
    reason = None
    message = ""


@dataclass(frozen=True)
class Failed:
    """A job that made nothing: it failed, or was rejected."""

    status: str
    reason: str
    message: str
    inputs: Stamps = field(default_factory=dict)
    outputs: Stamps = field(default_factory=dict)
    trace: str = ""  # the traceback of a fault; not in the journal
    error: Exception | None = None  # in the process that raised it; not in the journal
    warnings = ()


End = Taken | Failed


@dataclass(frozen=True)
class Record:
    """How a job ended."""

    sample_id: str
    split: str  # empty for none
    recipe: str
    settings: Mapping[str, Any]
    quality: str
    version: str
    renderer: int | None
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


class Field(NamedTuple):
    """A field of records: its types in JSON, and what it is."""

    types: tuple[type, ...]
    help: str
    of: str = ""  # ok: of pictures alone; old: of those of early versions not


_NONE, _NUMBER, _TEXT = type(None), (int, float), (str,)
FIELDS: Mapping[str, Field] = {
    "sample_id": Field(_TEXT, "name of the sample, the stem of its files; `stem` of `--json`"),
    "split": Field(_TEXT, "its split, if there are any", "old"),
    "recipe": Field(_TEXT, "hash of all that decides its outputs but the bytes of the inputs"),
    "status": Field(_TEXT, "`ok`, `failed` or `rejected`"),
    "reason": Field((str, _NONE), "a reason of `defocus help exit-codes`, null if ok"),
    "message": Field((str, _NONE), "the reason for people, empty if ok"),
    "settings": Field((dict,), "what was asked for: lens, reading, outputs, quality"),
    "inputs": Field(
        (dict,), "by role path (relative to OUT, or absolute), size, mtime_ns, blake2b"
    ),
    "outputs": Field(
        (dict,), "by kind or kind.preview path in OUT; if ok, size, mtime_ns, blake2b"
    ),
    "lens": Field((dict,), "the lens with its focus; lengths in mm, infinity is `inf`", "ok"),
    "size": Field((list,), "width and height in px", "ok"),
    "coc_px": Field((list,), "least and greatest signed radius of the blur, in px", "ok"),
    "color_note": Field(_TEXT, "how the colour was read", "old"),
    "depth_note": Field(_TEXT, "how the depth was read and repaired", "ok"),
    "depth_repair": Field((dict, _NONE), "what was repaired, in numbers", "old"),
    "device": Field(_TEXT, "where it was rendered", "ok"),
    "measures": Field((dict, _NONE), "radii, and shares of pixels, for cards of data sets", "old"),
    "warnings": Field((list,), "what was taken for granted"),
    "seconds": Field((dict,), "of `read`, `render` and `write`; `cpu` of rendering"),
    "quality": Field(_TEXT, "of the rendering"),
    "version": Field(_TEXT, "of defocus"),
    "renderer": Field((int, _NONE), "version of the renderer", "old"),
    "finished": Field(_TEXT, "when, UTC; the order of the lines decides"),
}


class _Table:
    """Keys of values, and the types that each may have."""

    def __init__(self, types: Mapping[str, tuple[type, ...]], of: str = "") -> None:
        self.types, self.of = types, of
        self._get = itemgetter(*types)
        self._known: set[tuple[type, ...]] = set()  # types of values that were right

    def wrong(self, values: Mapping[str, Any]) -> str | None:
        """What is missing or of a wrong type, as ``has no lens``; None if nothing is."""
        with suppress(KeyError):
            found = tuple(map(type, self._get(values)))
            if found in self._known:
                return None
            if (fault := self.wrong_if_there(values)) is None:
                self._known.add(found)
            return fault
        return next(f"has no {self.of}{key}" for key in self.types if key not in values)

    def wrong_if_there(self, values: Mapping[str, Any]) -> str | None:
        """What is of a wrong type among the keys that values have."""
        for key, kinds in self.types.items():
            if key in values and type(values[key]) not in kinds:
                return f"has the {self.of}{key} {values[key]!r:.60}, which is of a wrong type"
        return None


def _fields(*of: str) -> dict[str, tuple[type, ...]]:
    return {name: row.types for name, row in FIELDS.items() if row.of in of}


_OF_ALL, _OF_PICTURE, _OLD = _Table(_fields("")), _Table(_fields("", "ok")), _Table(_fields("old"))
_OPTICS = tuple(key for key, row in RECORDED.items() if row.is_optics)  # none beside radii
_LENS_TYPES: Mapping[str, tuple[type, ...]] = {
    **dict.fromkeys(RECORDED, _NUMBER),
    **dict.fromkeys(_OPTICS, (*_NUMBER, _NONE)),
    "focus_mm": (*_NUMBER, str, _NONE),
    "blades": (int,),
}
_LENS = _Table(_LENS_TYPES, "lens.")
_CHOSEN = _Table(
    {"focus_at_px": (list,), "focus_percentile": _NUMBER, "max_coc_px": _NUMBER}, "lens."
)
_NUMBERED = frozenset({*_LENS_TYPES, *_CHOSEN.types, "draw"})  # keys of a lens but effects
_EFFECT = (*_NUMBER, str, bool, _NONE)
_STAMP = {"path": (str,), "size": (int,), "mtime_ns": (int,), "blake2b": (str,)}
_DRAW = _Table(dict.fromkeys(("seed", "index", "attempt"), (int,)), "lens.draw.")
_REFUSED = _Table({"refused_px": (*_NUMBER, _NONE)}, "lens.draw.")
_SECONDS = _Table(
    {"render": _NUMBER, **dict.fromkeys(("read", "write", "cpu"), _NUMBER)}, "seconds."
)
_SETTINGS = _Table(
    {
        **dict.fromkeys(("stem", "suffix", "quality"), (str,)),
        **dict.fromkeys(("lens", "reading", "outputs", "shot"), (dict,)),
    },
    "settings.",
)
_MEASURED = ("_px", "_share")  # ends of the names of measures that are numbers


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
    fault = (_OF_PICTURE if is_ok else _OF_ALL).wrong(values) or _OLD.wrong_if_there(values)
    if fault is not None:
        return fault
    if values["status"] not in STATUSES:
        return f"has the status {values['status']!r:.60}, not one of {', '.join(STATUSES)}"
    if not is_moment(values["finished"]):
        return f"finished at {values['finished']!r:.60}, which is not a time with a zone"
    if "/" in values["sample_id"]:
        return "has a sample_id with a slash"
    if not is_ok and values["reason"] is None:
        return "has no reason, and made nothing"
    if (split := values.get("split")) and not NAME.fullmatch(split):
        return f"has the split {split!r:.60}, which is not a name"
    if not all(isinstance(warning, str) for warning in values["warnings"]):
        return "has a warning that is not a text"
    fault = _SETTINGS.wrong_if_there(values["settings"])
    fault = fault or _fault_of_files(values, linked)
    return fault or (_fault_of_picture(values) if is_ok else None)


def is_moment(text: str) -> bool:
    """Whether a text is a time with its zone: one without cannot be compared."""
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


def _fault_of_files(values: Mapping[str, Any], linked: frozenset[str]) -> str | None:
    if "color" not in values["inputs"]:
        return "has no colour among its inputs"
    for files in (values["inputs"], values["outputs"]):
        for role, stamp in files.items():
            if type(stamp) is not dict or "path" not in stamp:
                return f"has no path of {role}"
            for key, part in stamp.items():
                if type(part) not in _STAMP.get(key, ()):
                    return f"has the {role}.{key} {part!r:.60}, which is of a wrong type"
    for kind, stamp in values["outputs"].items():
        path = stamp["path"]
        if output_fault(path):
            return f"names the output {path!r}, which is not a file of a kind in OUT"
        if path.partition("/")[0] in linked:
            return f"names the output {path!r}, but {kind} is a link, and no folder of OUT"
    return None


def _fault_of_picture(values: Mapping[str, Any]) -> str | None:
    lens = values["lens"]
    fault = _LENS.wrong(lens) or _seconds_fault(values["seconds"])
    if fault is not None:
        return fault
    if len({lens[key] is None for key in _OPTICS}) > 1:
        return f"has a lens with some of {', '.join(_OPTICS)}, neither all nor none"
    if isinstance(lens["focus_mm"], str) and lens["focus_mm"] != "inf":
        return f"has the lens.focus_mm {lens['focus_mm']!r:.60}, neither a number nor inf"
    if "draw" in lens:
        draw = lens["draw"]
        if type(draw) is not dict or (fault := _DRAW.wrong(draw) or _REFUSED.wrong_if_there(draw)):
            return fault or "has a lens.draw that names no seed"
    if (fault := _CHOSEN.wrong_if_there(lens)) is not None:
        return fault
    if len(lens.get("focus_at_px", "xy")) != 2 or (lens.keys() - _NUMBERED and not _is_said(lens)):
        return "has a lens that no words can be made of"
    for key, kinds in (("size", (int,)), ("coc_px", _NUMBER)):
        numbers = values[key]
        if len(numbers) != 2 or not all(type(number) in kinds for number in numbers):
            return f"has the {key} {numbers!r:.60}, not two numbers"
    if min(values["size"]) < 1:
        return f"has the size {values['size']!r}, which no picture has"
    kinds = (values.get("depth_repair") or {}).get("kinds", [])
    if not isinstance(kinds, list) or not all(isinstance(kind, str) for kind in kinds):
        return "has a depth_repair of kinds that are not texts"
    for name, value in (values.get("measures") or {}).items():
        if name.endswith(_MEASURED) and type(value) not in (*_NUMBER, _NONE):
            return f"has the measures.{name} {value!r:.60}, which is not a number"
    return None


def _seconds_fault(seconds: Mapping[str, Any]) -> str | None:
    return _SECONDS.wrong_if_there(seconds) if "render" in seconds else "has no seconds.render"


def _is_said(lens: Mapping[str, Any]) -> bool:
    """Whether words can be made of a lens: what its effects hold, their rows know."""
    if any(type(lens[key]) not in _EFFECT for key in lens.keys() - _NUMBERED):
        return False
    with suppress(*MALFORMED):
        return bool(lens_record_words(lens))
    return False


def record_of(values: Mapping[str, Any]) -> Record:
    """The record of the values of a line of which `fault_of` tells nothing."""
    inputs, outputs = (
        {k: Stamp(**v) for k, v in values[of].items()} for of in ("inputs", "outputs")
    )
    end: End
    if values["status"] == "ok":
        (width, height), (near, far) = values["size"], values["coc_px"]
        end = Taken(
            inputs,
            outputs,
            values["lens"],
            (width, height),
            (near, far),
            values.get("color_note", ""),
            values["depth_note"],
            values.get("depth_repair"),
            values["device"],
            values.get("measures") or {},
            tuple(values["warnings"]),
            values["seconds"],
        )
    else:
        end = Failed(values["status"], values["reason"], values["message"] or "", inputs, outputs)
    return Record(
        sample_id=values["sample_id"],
        split=values.get("split", ""),
        recipe=values["recipe"],
        settings=values["settings"],
        quality=values["quality"],
        version=values["version"],
        renderer=values.get("renderer"),
        finished=values["finished"],
        end=end,
    )


def values_of(record: Record) -> dict[str, Any]:
    """The values of a record, as a line of the journal has them."""
    end, taken = record.end, record.taken
    values: dict[str, Any] = {"sample_id": record.sample_id}
    values |= {"split": record.split} if record.split else {}
    values |= {"recipe": record.recipe, "status": end.status, "reason": end.reason}
    values |= {"message": end.message, "settings": record.settings}
    values |= {
        of: {name: stamp.values for name, stamp in files.items()}
        for of, files in (("inputs", end.inputs), ("outputs", end.outputs))
    }
    if taken is not None:
        values |= {name: getattr(taken, name) for name in _OF_PICTURES}
    else:
        values |= {"warnings": [], "seconds": {}}
    return values | {name: getattr(record, name) for name in _LAST}


_OF_PICTURES = (
    *("lens", "size", "coc_px", "color_note", "depth_note", "depth_repair"),
    *("device", "measures", "warnings", "seconds"),
)
_LAST = ("quality", "version", "renderer", "finished")


def failure(error: Exception, step: Step, inputs: Stamps) -> Failed:
    """The end of a job of which an exception ended a step."""
    if isinstance(error, Rejected) and error.code in REJECTIONS:
        return Failed("rejected", error.code, str(error), inputs, error=error)
    reason = _reason(error, step)
    trace = "".join(traceback.format_exception(error)) if reason == "fault" else ""
    return Failed("failed", reason, error_line(error), inputs, trace=trace, error=error)


def error_line(error: BaseException) -> str:
    """An exception in one line, ``SUBJECT: problem; remedy`` where a user can mend it."""
    if isinstance(error, DefocusError):
        return str(error)
    if isinstance(error, OSError) and error.filename:
        return one_line(f"{error.filename}: {reason(error)}")
    return f"unexpected {type(error).__name__}: {reason(error)}"


def _reason(error: BaseException, step: Step) -> str:
    system = error if isinstance(error, OSError) else error.__cause__
    if isinstance(system, OSError) and system.errno in _FULL:
        return "no-space"
    if isinstance(error, TooLarge | MemoryError) or "can't allocate memory" in str(error):
        return "out-of-memory"
    if isinstance(error, UsageProblem):
        return "settings-unusable"
    if isinstance(error, InputError | OSError):
        return "output-unwritable" if step == "write" else "input-unusable"
    return "fault"

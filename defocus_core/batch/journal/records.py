"""What a line of a journal must hold to be a record: a journal may come from anywhere.

An output of a record is a file in the folder of its kind in OUT, and no other file: outputs are
packed into shards, and removed when they are replaced.
"""

from __future__ import annotations

import errno
from collections.abc import Mapping
from datetime import datetime
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
REASONS = REJECTIONS | FAILURES
STATUSES = ("ok", "rejected", "failed")
Step = Literal["read", "render", "write"]
_FULL = (errno.ENOSPC, errno.EDQUOT)


class Verdict(NamedTuple):
    """Status and reason code of a job without outputs, and its message for people."""

    status: str
    reason: str
    message: str


def verdict(error: BaseException, step: Step) -> Verdict:
    """The verdict on a job of which an exception ended a step."""
    if isinstance(error, Rejected) and error.code in REJECTIONS:
        return Verdict("rejected", error.code, str(error))
    return Verdict("failed", _failure(error, step), error_line(error))


def error_line(error: BaseException) -> str:
    """An exception in one line, ``SUBJECT: problem; remedy`` where a user can mend it."""
    if isinstance(error, DefocusError):
        return str(error)
    if isinstance(error, OSError) and error.filename:
        return one_line(f"{error.filename}: {reason(error)}")
    return f"unexpected {type(error).__name__}: {reason(error)}"


def _failure(error: BaseException, step: Step) -> str:
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


Types = Mapping[str, tuple[type, ...]]
_NONE, _NUMBER = type(None), (int, float)
_RECORD_KEYS: Types = {
    "sample_id": (str,),
    "recipe": (str,),
    "status": (str,),
    "reason": (str, _NONE),
    "message": (str, _NONE),
    "settings": (dict,),
    "inputs": (dict,),
    "outputs": (dict,),
    "quality": (str,),
    "version": (str,),
    "warnings": (list,),
    "seconds": (dict,),
    "finished": (str,),
}
_PICTURE_KEYS: Types = {
    "lens": (dict,),
    "size": (list,),
    "coc_px": (list,),
    "device": (str,),
    "depth_note": (str,),
}
_NOTES: Types = {  # of a picture, too, but not of one that an early version took
    "color_note": (str,),
    "depth_repair": (dict, _NONE),
    "measures": (dict, _NONE),
}
_MEASURED = ("_px", "_share")  # ends of the names of measures that are numbers
_OPTICS = tuple(key for key, row in RECORDED.items() if row.is_optics)  # none beside radii
_LENS_KEYS: Types = {
    **dict.fromkeys(RECORDED, _NUMBER),
    **dict.fromkeys(_OPTICS, (*_NUMBER, _NONE)),
    "focus_mm": (*_NUMBER, str, _NONE),
    "blades": (int,),
}


def linked_folders(out: Path) -> frozenset[str]:
    """The kinds whose folder in OUT is a link: OUT may be one, what lies below it may not."""
    return frozenset(kind for kind in KINDS if (out / kind).is_symlink())


def output_fault(path: object) -> str | None:
    """What is wrong with the path of an output, as ``leads upwards``; None if it is one of OUT."""
    fault = path_fault(path)
    if fault is not None:
        return fault
    kind, _, name = str(path).partition("/")
    return None if kind in KINDS and name and "/" not in name else "is no file of a kind in OUT"


def fault_of(record: object, linked: frozenset[str] = frozenset()) -> str | None:
    """What is wrong with a line of a journal, as ``has no lens``; None if it is a record."""
    if not isinstance(record, dict):
        return "is no record of a job"
    fault = wrong_type(record, _RECORD_KEYS) or _fault_of_files(record, linked)
    if fault:
        return fault
    if record["status"] not in STATUSES:
        return f"has the status {record['status']!r}, not one of {', '.join(STATUSES)}"
    if not is_moment(record["finished"]):
        return f"finished at {record['finished']!r}, which is no time with a zone"
    if not _is_split(record.get("split", "")):
        return f"has the split {record['split']!r:.60}, which is no name"
    if not all(isinstance(warning, str) for warning in record["warnings"]):
        return "has a warning that is no text"
    return _fault_of_picture(record) if record["status"] == "ok" else None


def _is_split(name: object) -> bool:
    """Whether it names a split, or none: shards have its name."""
    return isinstance(name, str) and (not name or NAME.fullmatch(name) is not None)


def wrong_type(values: Mapping[str, Any], types: Types) -> str | None:
    """What is missing or of a wrong type among values, as ``has no lens``; None if nothing is."""
    for key, kinds in types.items():
        if type(values.get(key, ...)) not in kinds:
            if key not in values:
                return f"has no {key}"
            return f"has the {key} {values[key]!r:.60}, which is of a wrong type"
    return None


def is_moment(text: str) -> bool:
    """Whether a text is a time with its zone: one without cannot be compared."""
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


def _fault_of_files(record: Mapping[str, Any], linked: frozenset[str]) -> str | None:
    if "/" in record["sample_id"]:
        return "has a sample_id with a slash"
    if "color" not in record["inputs"]:
        return "has no colour among its inputs"
    for files in (record["inputs"], record["outputs"]):
        for role, stamp in files.items():
            if not isinstance(stamp, dict) or not isinstance(stamp.get("path"), str):
                return f"has no path of {role}"
            if not isinstance(stamp.get("blake2b", ""), str):
                return f"has a blake2b of {role} that is no text"
    for stamp in record["outputs"].values():
        path = stamp["path"]
        if output_fault(path):
            return f"names the output {path!r}, which is no file of a kind in OUT"
        if (kind := path.partition("/")[0]) in linked:
            return f"names the output {path!r}, but {kind} is a link, and no folder of OUT"
    return None


def _fault_of_notes(record: Mapping[str, Any]) -> str | None:
    kinds = (record.get("depth_repair") or {}).get("kinds", [])
    if not isinstance(kinds, list) or not all(isinstance(kind, str) for kind in kinds):
        return "has a depth_repair of kinds that are no texts"
    for name, value in (record.get("measures") or {}).items():
        if name.endswith(_MEASURED) and not isinstance(value, (*_NUMBER, _NONE)):
            return f"has the {name} {value!r:.60}, which is no number"
    return None


def _fault_of_picture(record: Mapping[str, Any]) -> str | None:
    notes = {key: kinds for key, kinds in _NOTES.items() if key in record}
    fault = wrong_type(record, {**_PICTURE_KEYS, **notes})
    fault = fault or wrong_type(record["lens"], _LENS_KEYS) or _fault_of_notes(record)
    if fault:
        return fault
    lens = record["lens"]
    if len({lens[key] is None for key in _OPTICS}) > 1:
        return f"has a lens with some of {', '.join(_OPTICS)}, neither all nor none"
    if isinstance(lens["focus_mm"], str) and lens["focus_mm"] != "inf":
        return f"has the focus_mm {lens['focus_mm']!r}, neither a number nor inf"
    if not isinstance(lens.get("draw", {}), dict):
        return "has a draw of its lens that names no seed"
    for key in ("size", "coc_px"):
        if len(record[key]) != 2 or not all(isinstance(one, _NUMBER) for one in record[key]):
            return f"has the {key} {record[key]!r:.60}, not two numbers"
    return wrong_type(record["seconds"], {"render": _NUMBER})

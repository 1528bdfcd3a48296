"""The record of a job, a line of a journal: request, inputs, outputs and outcome.

`record_of` makes a `Record` of a line, and `line_of` the line of one: the fields of `Asked`, and
those of `Completed` or `Failed`, as its status says. ``defocus help batch`` explains them.
Journals are not trusted: type, range and finiteness of each value are checked.
An output must be a file in the folder of its kind in OUT, since outputs are packed into shards, and
removed when replaced. Index and ``--json`` are views of records.
"""

from __future__ import annotations

import errno
import time
import traceback
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta, Struct, ValidationError, convert
from msgspec.json import Decoder, encode
from msgspec.structs import asdict, replace

from defocus_core.errors import (
    DefocusError,
    InputError,
    UsageProblem,
    lacks_memory,
    one_line,
    reason,
)
from defocus_core.io.read_files import MALFORMED
from defocus_core.io.write_files import Folder, path_fault
from defocus_core.request.job import SPLIT_NAME, is_label
from defocus_core.request.lens import lens_record_words
from defocus_core.request.output_kinds import KINDS

Stage = Literal["read", "render", "write"]
_FULL = (errno.ENOSPC, errno.EDQUOT)
Number = float | None
Pixels = Annotated[int, Meta(gt=0)]
Moment = Annotated[datetime, Meta(tz=True)]  # a time without a zone cannot be compared


class Stamp(Struct, frozen=True, omit_defaults=True):
    """The identity of a file, to detect changes."""

    path: str = ""  # an output relative to OUT; an input as given if absolute, else relative to OUT
    size: int | None = None  # bytes
    mtime_ns: int | None = None  # time of modification; None for a file too new to rely on it
    blake2b: str | None = None  # hash of its bytes


Stamps = Mapping[str, Stamp]  # by role of an input, or kind of an output and kind.preview


class Completed(Struct, frozen=True, kw_only=True):
    """A rendered picture, whose outputs are in place."""

    inputs: dict[str, Stamp]
    outputs: dict[str, Stamp]
    lens: dict[str, Any]  # the lens with its focus, as of `lens_record`
    size: tuple[Pixels, Pixels]
    coc_px: tuple[float, float]
    color_note: str = ""
    depth_note: str
    depth_repair: dict[str, Number | list[str]] | None = None  # as of `repair_record`
    device: str
    back: str = "torch"  # the back that rendered it
    software: str = ""  # the libraries that computed; empty in early records
    measures: dict[str, Number] = {}
    warnings: tuple[str, ...]
    seconds: dict[str, float]  # read, render, write, and the CPU time of rendering
    stats: dict[str, float] = {}
    status: ClassVar[Literal["ok"]] = "ok"
    reason: ClassVar[None] = None
    message: ClassVar[str] = ""


class Failed(Struct, frozen=True):
    """A job without outputs."""

    reason: str
    message: str
    inputs: dict[str, Stamp] = {}
    outputs: dict[str, Stamp] = {}
    trace: str = ""  # the traceback of a fault; not in the journal
    error: Any = None  # the exception, in the process that raised it; not in the journal
    back: ClassVar[str] = ""
    status: ClassVar[Literal["failed"]] = "failed"
    warnings: ClassVar[tuple[str, ...]] = ()
    seconds: ClassVar[Mapping[str, float]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """The state for other processes, without the exception, which may not pickle."""
        return Failed, (self.reason, self.message, self.inputs, self.outputs, self.trace)


End = Completed | Failed
_UNKEPT = ("end", "stats", "trace", "error")


class Asked(Struct, frozen=True, kw_only=True):
    """The request of a job."""

    sample_id: Annotated[str, Meta(pattern="^[^/]*$")]
    split: Annotated[str, Meta(pattern=rf"^(?:{SPLIT_NAME.pattern})?\Z")] = ""  # empty for none
    recipe: str
    status: Literal["ok", "failed", "rejected"]  # rejected means failed, in early versions
    settings: dict[str, Any]
    quality: str
    version: str
    renderer: int | None = None
    finished: Moment


class Record(Asked, frozen=True, kw_only=True):
    """The request and outcome of a job."""

    end: End

    @property
    def completed(self) -> Completed | None:
        """The picture; None for a failed job."""
        return self.end if isinstance(self.end, Completed) else None

    @property
    def inputs(self) -> Stamps:
        """The inputs by role."""
        return self.end.inputs

    @property
    def outputs(self) -> Stamps:
        """The outputs by kind, or kind.preview; for a failed job only the paths."""
        return self.end.outputs

    def with_files(self, *, inputs: Stamps | None = None, outputs: Stamps | None = None) -> Record:
        """The record with other inputs or outputs."""
        end = replace(self.end, inputs=inputs or self.inputs, outputs=outputs or self.outputs)
        return replace(self, end=end)


class _Lens(Struct):
    """The fields of `lens_record` except effects; None with a file of radii."""

    focal_length_mm: Number
    fnumber: Number
    sensor_width_mm: Number
    focus_mm: float | Literal["inf"] | None
    blades: int
    blade_rotation_deg: float
    focus_at_px: tuple[float, float] | None = None
    focus_percentile: Number = None
    draw: dict[Literal["seed", "index"], int] = {}


class _Settings(Struct):
    """The settings that are read; others are only compared."""

    stem: str = ""
    lens: dict[str, Any] | None = None
    reading: dict[str, Any] | None = None


_ASKED, _COMPLETED, _FAILED = Decoder(Asked), Decoder(Completed), Decoder(Failed)


def record_of(line: bytes, linked: frozenset[str] = frozenset()) -> Record:
    """The record of a line; refuses outputs below `linked`, the names of links in OUT.

    Raises:
        ValidationError: It is JSON, but not a record.
        DecodeError, UnicodeDecodeError, RecursionError: It is not JSON.
    """
    asked = _ASKED.decode(line)
    end: End = _COMPLETED.decode(line) if asked.status == "ok" else _FAILED.decode(line)
    convert(asked.settings, _Settings)
    if "color" not in end.inputs:
        raise ValidationError("Object has no color among its inputs")
    for stamp in end.outputs.values():
        if output_fault(stamp.path, end.inputs):
            raise ValidationError(f"output {stamp.path!r} is not a file of a kind in OUT")
        if (kind := stamp.path.partition("/")[0]) in linked:
            raise ValidationError(f"output {stamp.path!r}, but {kind} is a link, and no folder")
    if isinstance(end, Completed):
        _require_lens(end.lens)
    return Record(**{**asdict(asked), "status": end.status}, end=end)


def output_fault(path: object, inputs: Mapping[str, object]) -> str | None:
    """The fault of the path of an output in OUT, which may be of a label in `inputs`; or None."""
    fault = path_fault(path)
    if fault is not None:
        return fault
    kind, _, name = str(path).partition("/")
    is_folder = kind in KINDS or (kind in inputs and is_label(kind))
    return None if is_folder and name and "/" not in name else "is not a file of a kind in OUT"


def linked_folders(out: Path) -> frozenset[str]:
    """The names of links in OUT, which are not accepted as folders of outputs."""
    return frozenset(name for name in Folder(out).names() if (out / name).is_symlink())


def _require_lens(lens: dict[str, Any]) -> None:
    """Refuse a lens that cannot be put into words; effects are checked by their rows."""
    convert(lens, _Lens)
    effects = (value for key, value in lens.items() if key not in _Lens.__struct_fields__)
    try:
        if lens_record_words(lens) and not any(isinstance(each, list | dict) for each in effects):
            return
    except MALFORMED:
        pass
    raise ValidationError("no words can be made of the lens")


def line_of(record: Record) -> bytes:
    """The line of a record."""
    values = {**asdict(record), **asdict(record.end)}
    return encode({k: v for k, v in values.items() if k not in _UNKEPT}) + b"\n"


def now() -> datetime:
    """The time in UTC, as in records."""
    moment = datetime.fromtimestamp(time.time(), UTC)
    return moment.replace(microsecond=moment.microsecond // 1000 * 1000)


def failure(error: Exception, stage: Stage, inputs: Stamps) -> Failed:
    """The end of a job with an exception in a stage."""
    reason = _reason(error, stage)
    trace = "".join(traceback.format_exception(error)) if reason == "fault" else ""
    return Failed(reason, error_line(error), dict(inputs), trace=trace, error=error)


def error_line(error: BaseException) -> str:
    """An exception in one line, ``SUBJECT: problem; remedy`` for mistakes of users."""
    if isinstance(error, DefocusError):
        return str(error)
    if isinstance(error, OSError) and error.filename:
        return one_line(f"{error.filename}: {reason(error)}")
    return f"unexpected {type(error).__name__}: {reason(error)}"


def _reason(error: BaseException, stage: Stage) -> str:
    system = error if isinstance(error, OSError) else error.__cause__
    if isinstance(system, OSError) and system.errno in _FULL:
        return "no-space"
    if lacks_memory(error):
        return "out-of-memory"
    if isinstance(error, UsageProblem):
        return "settings-unusable"
    if isinstance(error, InputError | OSError):
        return "output-unwritable" if stage == "write" else "input-unusable"
    return "fault"

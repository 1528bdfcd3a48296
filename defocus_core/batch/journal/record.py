"""The record of a job, which is a line of the journal: request, inputs, outputs and outcome.

`record_of` parses a line, `line_of` writes one. A line has the fields of `Asked` and, depending on
its status, those of `Completed` or `Failed`, as described in ``defocus help batch``. The index of a
data set and ``--json`` take their values from records.

Journals may come from other people, so types and ranges of all values are checked. The path of an
output must be a file in the folder of its kind in OUT, as outputs may be removed or packed.
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
    """Path, size, time and hash of a file, by which changes of it are detected."""

    path: str = ""  # an output relative to OUT; an input as given if absolute, else relative to OUT
    size: int | None = None  # bytes
    mtime_ns: int | None = None  # time of modification; None for a file too new to rely on it
    blake2b: str | None = None  # hash of its bytes


Stamps = Mapping[str, Stamp]  # by role of an input, or kind of an output and kind.preview


class Completed(Struct, frozen=True, kw_only=True):
    """The outcome of a job whose outputs were written."""

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
    """The outcome of a job that failed and wrote no outputs."""

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
        """Pickle without the exception, which other processes may not be able to load."""
        return Failed, (self.reason, self.message, self.inputs, self.outputs, self.trace)


End = Completed | Failed
_UNKEPT = ("end", "stats", "trace", "error")


class Asked(Struct, frozen=True, kw_only=True):
    """The request of a job: its settings, and the version of the program."""

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
    """The request and the outcome of a job."""

    end: End

    @property
    def completed(self) -> Completed | None:
        """The outcome if the job is ok, else None."""
        return self.end if isinstance(self.end, Completed) else None

    @property
    def inputs(self) -> Stamps:
        """The stamps of the inputs (path, size, time and hash) by role."""
        return self.end.inputs

    @property
    def outputs(self) -> Stamps:
        """The stamps of the outputs by kind or ``<kind>.preview``; only paths if the job failed."""
        return self.end.outputs

    def with_files(self, *, inputs: Stamps | None = None, outputs: Stamps | None = None) -> Record:
        """The record with its inputs or outputs replaced."""
        end = replace(self.end, inputs=inputs or self.inputs, outputs=outputs or self.outputs)
        return replace(self, end=end)


class _Lens(Struct):
    """The types of the fields of `lens_record`, without optional effects.

    Optical values are None if radii came from a file.
    """

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
    """The types of those settings in a record that are read; the others are only compared."""

    stem: str = ""
    lens: dict[str, Any] | None = None
    reading: dict[str, Any] | None = None


_ASKED, _COMPLETED, _FAILED = Decoder(Asked), Decoder(Completed), Decoder(Failed)


def record_of(line: bytes, linked: frozenset[str] = frozenset()) -> Record:
    """Parse and check a line of a journal.

    `linked` are names of symbolic links in OUT; outputs in such folders are refused.

    Raises:
        ValidationError: It is JSON, but not a valid record.
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
    """What is wrong with the path of an output, relative to OUT; None if it is valid.

    It must be ``<kind>/<name>``, or ``<label>/<name>`` with a label that is among the `inputs`.
    """
    fault = path_fault(path)
    if fault is not None:
        return fault
    kind, _, name = str(path).partition("/")
    is_folder = kind in KINDS or (kind in inputs and is_label(kind))
    return None if is_folder and name and "/" not in name else "is not a file of a kind in OUT"


def linked_folders(out: Path) -> frozenset[str]:
    """The names of symbolic links in `out`, which are not accepted as folders of outputs."""
    return frozenset(name for name in Folder(out).names() if (out / name).is_symlink())


def _require_lens(lens: dict[str, Any]) -> None:
    """Raise ValidationError if a lens in a record has wrong types, or cannot be shown as text."""
    convert(lens, _Lens)
    effects = (value for key, value in lens.items() if key not in _Lens.__struct_fields__)
    try:
        if lens_record_words(lens) and not any(isinstance(each, list | dict) for each in effects):
            return
    except MALFORMED:
        pass
    raise ValidationError("no words can be made of the lens")


def line_of(record: Record) -> bytes:
    """A record as a line of a journal."""
    values = {**asdict(record), **asdict(record.end)}
    return encode({k: v for k, v in values.items() if k not in _UNKEPT}) + b"\n"


def now() -> datetime:
    """The present time in UTC, in whole milliseconds."""
    moment = datetime.fromtimestamp(time.time(), UTC)
    return moment.replace(microsecond=moment.microsecond // 1000 * 1000)


def failure(error: Exception, stage: Stage, inputs: Stamps) -> Failed:
    """The outcome of a job that raised an exception in `stage`; `inputs` are stamps by role."""
    reason = _reason(error, stage)
    trace = "".join(traceback.format_exception(error)) if reason == "fault" else ""
    return Failed(reason, error_line(error), dict(inputs), trace=trace, error=error)


def error_line(error: BaseException) -> str:
    """An exception as one line; for users' mistakes, ``SUBJECT: problem; remedy``."""
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

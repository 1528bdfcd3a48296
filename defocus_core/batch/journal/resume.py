"""Reasons to do a job again: changed settings, inputs, outputs or renderer.

A job is done again if it failed, if its request changed, if an input has other bytes, if an output
is not as it was written, or if the version of the renderer changed; `AGAIN` has the words.

The recipe is the hash of everything that decides its outputs except the contents of the inputs:
lens, reading, kinds and types of outputs, quality, the names of its files, and the version of the
renderer. Device, threads, the path of OUT and the time are not part of it.

A file counts as unchanged if its size and time of modification are those recorded, or if only its
time differs and its bytes have the recorded hash, so that a copied data set is not rendered again.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, lru_cache, partial
from hashlib import blake2b, file_digest
from pathlib import Path
from typing import Any, NamedTuple

from msgspec.structs import replace

from defocus_core.batch.journal.journal import Ledger, input_path
from defocus_core.batch.journal.record import Record, Stamp, Stamps
from defocus_core.errors import InputError
from defocus_core.io.below import Folder, open_plain
from defocus_core.renderer_version import RENDERER_VERSION
from defocus_core.request.job import Job, Outputs, Reading, Shot
from defocus_core.request.lens import LensValues, lens_record_words
from defocus_core.request.parameters import LENS_FILES
from defocus_core.system.text import version

DIGEST = 16  # bytes of a hash
CLOCK_TICK = 50_000_000  # ns, more than the resolution of times of any file system
_ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False)
# Where OUT is, and where a lens stands, not what it is; labels are among the inputs.
_PLACES = ("root", "overwrite", "labels", "focus_source", *LENS_FILES)
_PLAIN = frozenset({str, int, bool, type(None)})


@lru_cache(maxsize=4096)  # jobs share their lenses, readings and outputs
def _plain(value: LensValues | Reading | Outputs) -> dict[str, Any]:
    """A part of a job as plain values, without places."""
    return {k: v for k, v in plain(value).items() if k not in _PLACES}


def settings(job: Job) -> dict[str, Any]:
    """The settings of a job as plain values, without its inputs, OUT and the machine."""
    return {
        "stem": job.picture.stem,
        "suffix": job.suffix,
        "lens": _plain(job.lens),
        "reading": _plain(job.reading),
        "outputs": _plain(job.outputs),
        "quality": job.machine.quality,
        **({} if job.machine.tile is None else {"tile": job.machine.tile}),
        **({} if job.shot is None else {"shot": _shot_settings(job.shot, job.picture.frame)}),
    }


def _shot_settings(shot: Shot, frame: int | None) -> dict[str, Any]:
    """The settings that a job takes from its shot, by frame; files of frames are inputs."""
    sample = [[each.picture.frame, _plain(each.lens)] for each in shot.sample]
    return {"frame": frame, "sample": sample, "shares_focus": shot.shares_focus}


def changed_settings(
    old: Mapping[str, Any], new: Mapping[str, Any]
) -> Iterator[tuple[str, object, object]]:
    """The differing settings, by names like lens.fnum: old and new value."""
    was, now = _flat(old), _flat(new)
    for key in sorted({*was, *now}):
        if was.get(key) != now.get(key):
            yield key, was.get(key, "the default"), now.get(key, "the default")


def _flat(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested settings by dotted names."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{before}{key}.")
        else:
            flat[f"{before}{key}"] = value
    return flat


def recipe(job: Job, renderer: int | None = RENDERER_VERSION) -> str:
    """The hash of everything that decides the outputs of a job but the bytes of its inputs."""
    names = {role: path.name for role, path in job.files.items()}
    return digest({"settings": settings(job), "names": names, "renderer": renderer})


def digest(value: object) -> str:
    """The hash of a plain value."""
    return blake2b(_ENCODER.encode(value).encode(), digest_size=DIGEST).hexdigest()


def versions() -> dict[str, Any]:
    """The versions of the package and of the renderer, as records have them."""
    return {"version": version(), "renderer": RENDERER_VERSION}


def stamp(path: Path, root: Path | None = None) -> Stamp:
    """Size, time of modification and hash of a file, without its path.

    `root`: the folder above it, below which links are not followed; None for a file that the user
    named.
    """
    below = root and path.relative_to(root).as_posix()
    with Folder(root).open(below) if root and below else open_plain(path) as file:
        hashed = file_digest(file, partial(blake2b, digest_size=DIGEST))  # type: ignore[arg-type]  # it has readinto
        status = os.fstat(file.fileno())
    return Stamp("", status.st_size, status.st_mtime_ns, hashed.hexdigest())


def settled_stamp(path: Path) -> Stamp:
    """The `stamp` of a file, without a time so recent that a later change could share it."""
    status = path.stat()
    if abs(time.time_ns() - status.st_mtime_ns) < CLOCK_TICK:
        return replace(stamp(path), mtime_ns=None)
    return _stamped(path, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)


@lru_cache(maxsize=256)  # frames of a shot share files
def _stamped(path: Path, *_status: int) -> Stamp:
    return stamp(path)


def unchanged(path: Path | str, recorded: Stamp, *, read: bool = False) -> bool:
    """Whether a file is unchanged since it was recorded.

    `read`: compare the bytes even if size and time are those recorded.
    """
    try:
        status = os.stat(path)  # noqa: PTH116 - it is asked of each file of all jobs
        if status.st_size != recorded.size:
            return False
        if status.st_mtime_ns == recorded.mtime_ns and not read:
            return True
        return recorded.blake2b is not None and stamp(Path(path)).blake2b == recorded.blake2b
    except OSError:
        return False


def plain(value: Any) -> Any:
    """A value without classes: dataclasses become dictionaries, tuples lists, paths text."""
    if type(value) in _PLAIN:  # most are
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts: dict[str, Any] = {}
        for name, default in _fields(type(value)):  # a lens has many, and a batch many lenses
            part = getattr(value, name)
            if part is not default and part != default:
                parts[name] = plain(part)
        return parts
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    return value


@cache
def _fields(kind: type) -> tuple[tuple[str, object], ...]:
    return tuple((each.name, each.default) for each in dataclasses.fields(kind))


# The words of the reasons, in the order of the checks.
AGAIN = {
    "failed": "failed before",
    "settings": "settings",
    "inputs": "inputs",
    "outputs": "outputs gone or changed",
    "renderer": "renderer {old} → {new}",
}


class Decision(NamedTuple):
    """Whether a job is done."""

    is_done: bool
    again: str = ""  # reason to do it again, in words; empty if it is done, or new
    moved: Stamps | None = None  # new inputs of its record, if they have moved


def decided(job: Job, ledger: Ledger, *, read_inputs: bool) -> Decision:
    """Whether a job is done, with the reason to do it again if not.

    If the sample has moved to another split, its record is updated, too.

    `read_inputs`: compare the bytes of the inputs, not only size and time.
    """
    names = job.names
    number = ledger.number_of(names.values())
    if number is None:
        is_known = any(map(ledger.is_known, names.values()))
        return Decision(False, AGAIN["settings"] if is_known else "")
    record = ledger.record(number)
    if why := _changed(job, record):
        return Decision(False, AGAIN[why])
    moved = _moved(job, record, ledger.out, read_inputs=read_inputs)
    if moved is None:
        return Decision(False, AGAIN["inputs"])
    if record.completed is not None:
        stamps = record.outputs.values()
        there = all(unchanged(f"{ledger.out}/{stamp.path}", stamp) for stamp in stamps)
        if not there or record.outputs.keys() != names.keys():
            return Decision(False, AGAIN["outputs"])
    if record.renderer != RENDERER_VERSION:
        words = AGAIN["renderer"].format(old=record.renderer, new=RENDERER_VERSION)
        return Decision(False, words)
    return Decision(True, moved=moved if moved or record.split != job.split.name else None)


def moved_record(job: Job, ledger: Ledger, moved: Stamps) -> Record:
    """The record of a finished job, updated with its inputs that have moved, and its split."""
    record = ledger.record_of(job.names.values())
    record = record.with_files(inputs={**record.inputs, **moved})
    return replace(record, split=job.split.name)


def _changed(job: Job, record: Record) -> str:
    """The reason to do a job again regardless of its files, a key of `AGAIN`, or empty."""
    if record.status == "failed":
        return "failed"
    if record.recipe == recipe(job):
        return ""
    if any(changed_settings(record.settings, settings(job))):
        return "settings"
    names = {role: path.name for role, path in job.files.items()}
    was = {role: Path(stamp.path).name for role, stamp in record.inputs.items()}
    return "settings" if names == was else "inputs"


def _moved(job: Job, record: Record, out: Path, *, read_inputs: bool) -> dict[str, Stamp] | None:
    """The inputs of a record that have moved; None if one has changed."""
    moved = {}
    for role, path in job.files.items():
        stamp = record.inputs.get(role, Stamp())
        # Size and time do not identify a moved file: archives may give all files one time.
        elsewhere = stamp.path != (place := input_path(path, out))
        if not unchanged(path, stamp, read=read_inputs or elsewhere):
            if not path.exists() and record.completed is not None:
                continue  # a missing input cannot change the outputs
            return None
        if elsewhere:
            moved[role] = replace(stamp, path=place)
    return moved


def refuse_others(jobs: Iterable[Job], ledger: Ledger, *, keep_lenses: bool) -> None:
    """Refuse to replace outputs of another picture and, with ``keep_lenses``, of another lens."""

    def lens_and_view(asked: Mapping[str, Any]) -> tuple[Any, Any]:
        return asked.get("lens") or {}, (asked.get("reading") or {}).get("view")

    for job in jobs if ledger.last else ():
        for name in () if job.outputs.overwrite else job.names.values():
            path, number = ledger.out / name, ledger.last.get(name)
            if number is None or not path.exists():
                continue
            now = lens_and_view(settings(job))
            record = ledger.record(number)
            before = ledger.out.resolve() / record.inputs["color"].path
            was = lens_and_view(record.settings)
            if before.exists() and before.resolve() != job.picture.color.resolve():
                other = f"made of another picture, {before.resolve()}"
            elif keep_lenses and record.completed is not None and was != now:
                view = f", view {was[1]}" if was[1] != now[1] else ""
                other = f"taken otherwise: {lens_record_words(record.completed.lens)}{view}"
            else:
                continue
            remedy = "choose another -o, or add ‹overwrite› to replace it"
            raise InputError("exists", f"exists already, {other}", remedy, path=path)

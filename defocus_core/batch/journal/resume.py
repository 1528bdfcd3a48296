"""Why a job is done again: its settings, its inputs, its outputs or the renderer changed.

A job is done once. It is done again if what was asked for changed, if an input has other bytes, if
an output is not as it was written, if it failed, or if the renderer makes other pictures by now;
`AGAIN` has the words.

The recipe is the hash of all that decides its outputs but the inputs' contents: lens, reading,
kinds and types of outputs, quality, the names of its files, and the version of the renderer. Where
it computes (device, threads), where OUT is and what time it is are no part of it.

A file is taken for unchanged if its size and its time of modification are those recorded, and as
well if only its time differs and its bytes hash to what was recorded: a copied data set is not
rendered again.
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
CLOCK_TICK = 50_000_000  # ns, more than the step of any file system's times
_ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False)
# Where OUT is, and where a lens stands, not what it is.
_PLACES = ("root", "overwrite", "focus_source", *LENS_FILES)
_PLAIN = frozenset({str, int, bool, type(None)})


@lru_cache(maxsize=4096)  # jobs share their lenses, readings and outputs
def _plain(value: LensValues | Reading | Outputs) -> dict[str, Any]:
    """A part of a job as plain values, but where it stands."""
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
    """What a job takes of its shot, by frame; the files of the frames are inputs."""
    sample = [[each.picture.frame, _plain(each.lens)] for each in shot.sample]
    return {"frame": frame, "sample": sample, "shares_focus": shot.shares_focus}


def changed_settings(
    old: Mapping[str, Any], new: Mapping[str, Any]
) -> Iterator[tuple[str, object, object]]:
    """The settings that differ, by names like lens.fnum: what each was, and what it is."""
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

    `root`: the folder that it lies below, no link of which is followed; None for a file that the
    user named.
    """
    below = root and path.relative_to(root).as_posix()
    with Folder(root).open(below) if root and below else open_plain(path) as file:
        hashed = file_digest(file, partial(blake2b, digest_size=DIGEST))  # type: ignore[arg-type]  # it has readinto
        status = os.fstat(file.fileno())
    return Stamp("", status.st_size, status.st_mtime_ns, hashed.hexdigest())


def settled_stamp(path: Path) -> Stamp:
    """The `stamp` of a file, without a time so recent that a later change could have the same."""
    status = path.stat()
    if abs(time.time_ns() - status.st_mtime_ns) < CLOCK_TICK:
        return replace(stamp(path), mtime_ns=None)
    return _stamped(path, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)


@lru_cache(maxsize=256)  # frames of a shot share files
def _stamped(path: Path, *_status: int) -> Stamp:
    return stamp(path)


def unchanged(path: Path | str, recorded: Stamp, *, read: bool = False) -> bool:
    """Whether a file is as it was recorded.

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


# Words of the reasons, in the order in which they are looked for.
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
    again: str = ""  # why it is done again, in words; empty if it is done, or new
    moved: Stamps | None = None  # what its record is to say: inputs that lie elsewhere by now


def decided(job: Job, ledger: Ledger, *, read_inputs: bool) -> Decision:
    """Whether a job is done: an ``ok`` or a rejection that would be the same again.

    If the sample is of another split, its record is to say so, too.

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
    if record.taken is not None:
        stamps = record.outputs.values()
        there = all(unchanged(f"{ledger.out}/{stamp.path}", stamp) for stamp in stamps)
        if not there or record.outputs.keys() != names.keys():
            return Decision(False, AGAIN["outputs"])
    if record.renderer != RENDERER_VERSION:
        words = AGAIN["renderer"].format(old=record.renderer, new=RENDERER_VERSION)
        return Decision(False, words)
    return Decision(True, moved=moved if moved or record.split != job.split.name else None)


def moved_record(job: Job, ledger: Ledger, moved: Stamps) -> Record:
    """The record of a job that is done, as it is now: where its inputs lie, and its split."""
    record = ledger.record_of(job.names.values())
    record = record.with_files(inputs={**record.inputs, **moved})
    return replace(record, split=job.split.name)


def _changed(job: Job, record: Record) -> str:
    """Why a job is done again whatever its files hold: a key of `AGAIN`; empty if it is not."""
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
    """The inputs of a record that lie elsewhere by now; None if one is another."""
    moved = {}
    for role, path in job.files.items():
        stamp = record.inputs.get(role, Stamp())
        # Size and time say nothing of a file that was elsewhere: archives give all one time.
        elsewhere = stamp.path != (place := input_path(path, out))
        if not unchanged(path, stamp, read=read_inputs or elsewhere):
            if not path.exists() and record.taken is not None:
                continue  # an input that is gone cannot change the outputs
            return None
        if elsewhere:
            moved[role] = replace(stamp, path=place)
    return moved


def refuse_others(jobs: Iterable[Job], ledger: Ledger, *, keep_lenses: bool) -> None:
    """Refuse to replace outputs of another picture, and, if asked, those of another lens."""

    def taken(asked: Mapping[str, Any]) -> tuple[Any, Any]:
        return asked.get("lens") or {}, (asked.get("reading") or {}).get("view")

    for job in jobs if ledger.last else ():
        for name in () if job.outputs.overwrite else job.names.values():
            path, number = ledger.out / name, ledger.last.get(name)
            if number is None or not path.exists():
                continue
            now = taken(settings(job))
            record = ledger.record(number)
            before = ledger.out.resolve() / record.inputs["color"].path
            was = taken(record.settings)
            if before.exists() and before.resolve() != job.picture.color.resolve():
                other = f"made of another picture, {before.resolve()}"
            elif keep_lenses and record.taken is not None and was != now:
                view = f", view {was[1]}" if was[1] != now[1] else ""
                other = f"taken otherwise: {lens_record_words(record.taken.lens)}{view}"
            else:
                continue
            remedy = "choose another -o, or add ‹overwrite› to replace it"
            raise InputError("exists", f"exists already, {other}", remedy, path=path)

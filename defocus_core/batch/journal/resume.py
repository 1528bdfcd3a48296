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
from collections.abc import Iterator, Mapping
from functools import cache, lru_cache, partial
from hashlib import blake2b, file_digest
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from defocus_core.batch.journal.journal import Ledger, input_path
from defocus_core.batch.journal.record import Record, Stamp, Stamps
from defocus_core.io.read_files import open_plain
from defocus_core.io.write_files import Folder
from defocus_core.renderer_version import RENDERER_VERSION
from defocus_core.request.job import Job, Outputs, Reading
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
    found: dict[str, Any] = {
        "stem": job.picture.stem,
        "suffix": job.suffix,
        "lens": _plain(job.lens),
        "reading": _plain(job.reading),
        "outputs": _plain(job.outputs),
        "quality": job.machine.quality,
    }
    if job.machine.tile is not None:
        found["tile"] = job.machine.tile
    if (shot := job.shot) is not None:  # files of its frames are inputs
        sample = [[each.picture.frame, _plain(each.lens)] for each in shot.sample]
        own = {"frame": job.picture.frame, "sample": sample, "shares_focus": shot.shares_focus}
        found["shot"] = own
    return found


def changed_settings(
    old: Mapping[str, Any], new: Mapping[str, Any]
) -> Iterator[tuple[str, object, object]]:
    """The name, like lens.fnum, the old and the new value of each setting that differs."""
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
    text = _ENCODER.encode({"settings": settings(job), "names": names, "renderer": renderer})
    return blake2b(text.encode(), digest_size=DIGEST).hexdigest()


def versions() -> dict[str, Any]:
    """The versions of the package and of the renderer, as records have them."""
    return {"version": version(), "renderer": RENDERER_VERSION}


def stamp(path: Path, root: Path | None = None) -> Stamp:
    """Size, time of modification and hash of a file; no link is followed below `root`, if given."""
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
    """Whether a file is as it was recorded; `read` compares its bytes in any case."""
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
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    fields = _fields(value.__class__)
    parts = ((name, getattr(value, name), default) for name, default in fields)
    # a lens has many fields, and a batch many lenses
    return {name: plain(it) for name, it, default in parts if it is not default and it != default}


@cache
def _fields(kind: type) -> tuple[tuple[str, object], ...]:
    return tuple((each.name, each.default) for each in dataclasses.fields(kind))


# The words of the reasons, in the order of the checks.
AGAIN = {
    "failed": "failed before",
    "settings": "settings changed",
    "inputs": "inputs changed",
    "outputs": "outputs gone or changed",
    "renderer": "renderer {old} → {new}",
}


def decided(job: Job, ledger: Ledger, *, read_inputs: bool) -> tuple[str | None, Stamps | None]:
    """The reason to do a job again, in words, empty if it is new; None if it is done.

    The second value has the moved inputs of a finished job whose record must be updated (empty if
    only the split changed), else it is None.
    `read_inputs`: compare the bytes of the inputs, not only size and time.
    """
    names = job.names
    number = ledger.number_of(names.values())
    if number is None:
        is_known = any(map(ledger.is_known, names.values()))
        return AGAIN["settings"] if is_known else "", None
    record = ledger.record(number)
    if why := _changed(job, record):
        return AGAIN[why], None
    moved = _moved(job, record, ledger.out, read_inputs=read_inputs)
    if moved is None:
        return AGAIN["inputs"], None
    if record.completed is not None:
        stamps = record.outputs.values()
        there = all(unchanged(f"{ledger.out}/{stamp.path}", stamp) for stamp in stamps)
        if not there or record.outputs.keys() != names.keys():
            return AGAIN["outputs"], None
    if record.renderer != RENDERER_VERSION:
        return AGAIN["renderer"].format(old=record.renderer, new=RENDERER_VERSION), None
    return None, moved if moved or record.split != job.split.name else None


def _changed(job: Job, record: Record) -> str:
    """The reason to do a job again regardless of its files, a key of `AGAIN`, or empty."""
    if record.status == "failed":
        return "failed"
    if record.recipe == recipe(job):
        return ""
    names = {role: path.name for role, path in job.files.items()}
    was = {role: Path(stamp.path).name for role, stamp in record.inputs.items()}
    is_other = any(changed_settings(record.settings, settings(job)))
    return "settings" if is_other or names == was else "inputs"


def _moved(job: Job, record: Record, out: Path, *, read_inputs: bool) -> dict[str, Stamp] | None:
    """The stamps of the inputs that have moved, by role; None if an input has changed."""
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


def other_words(job: Job, record: Record, out: Path, *, keep_lenses: bool) -> str:
    """Words on the other picture or, with ``keep_lenses``, lens of a record; empty if the same."""
    before = out.resolve() / record.inputs["color"].path
    if before.exists() and before.resolve() != job.picture.color.resolve():
        return f"made of another picture, {before.resolve()}"
    (was, old), (now, new) = (
        (asked.get("lens") or {}, (asked.get("reading") or {}).get("view"))
        for asked in (record.settings, settings(job))
    )
    if not keep_lenses or record.completed is None or (was, old) == (now, new):
        return ""
    view = f", view {old}" if old != new else ""
    return f"taken otherwise: {lens_record_words(record.completed.lens)}{view}"

"""Whether a job must be done again, because settings, inputs, outputs or renderer changed.

A job is done again if it failed, if its settings changed, if the content of an input changed, if an
output is missing or was changed, or if the version of the renderer changed. `AGAIN` has the
messages.

The recipe of a job is the hash of all that determines its outputs, except the content of the
inputs: lens, options of reading, kinds and formats of outputs, quality, file names, and the version
of the renderer. It does not depend on device, threads, time or the path of OUT.

A file is unchanged if it has the recorded size and modification time. If only the time differs, its
hash is compared, so that a data set may be copied without being rendered again.
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
# Fields that are only places of files and options, or, like labels, are known from the inputs.
_PLACES = ("root", "overwrite", "labels", "focus_source", *LENS_FILES)
_PLAIN = frozenset({str, int, bool, type(None)})


@lru_cache(maxsize=4096)  # jobs share their lenses, readings and outputs
def _plain(value: LensValues | Reading | Outputs) -> dict[str, Any]:
    """Lens, reading or outputs of a job as a dictionary for JSON, without the fields `_PLACES`."""
    return {k: v for k, v in plain(value).items() if k not in _PLACES}


def settings(job: Job) -> dict[str, Any]:
    """The settings of a job as a dictionary for JSON, without inputs, output folder and machine."""
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
    """Yield name, like lens.fnum, old value and new value of each setting that differs."""
    was, now = _flat(old), _flat(new)
    for key in sorted({*was, *now}):
        if was.get(key) != now.get(key):
            yield key, was.get(key, "the default"), now.get(key, "the default")


def _flat(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Flatten nested settings; keys are joined by dots, after the prefix `before`."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{before}{key}.")
        else:
            flat[f"{before}{key}"] = value
    return flat


def recipe(job: Job, renderer: int | None = RENDERER_VERSION) -> str:
    """The hash of all that determines the outputs of a job, except the content of its inputs."""
    names = {role: path.name for role, path in job.files.items()}
    text = _ENCODER.encode({"settings": settings(job), "names": names, "renderer": renderer})
    return blake2b(text.encode(), digest_size=DIGEST).hexdigest()


def versions() -> dict[str, Any]:
    """The versions of the package and of the renderer, as fields of a record."""
    return {"version": version(), "renderer": RENDERER_VERSION}


def stamp(path: Path, root: Path | None = None) -> Stamp:
    """The stamp of a file: size, modification time and hash.

    With `root`, a folder that contains the file, symbolic links below it are not followed.
    """
    below = root and path.relative_to(root).as_posix()
    with Folder(root).open(below) if root and below else open_plain(path) as file:
        hashed = file_digest(file, partial(blake2b, digest_size=DIGEST))  # type: ignore[arg-type]  # it has readinto
        status = os.fstat(file.fileno())
    return Stamp("", status.st_size, status.st_mtime_ns, hashed.hexdigest())


def settled_stamp(path: Path) -> Stamp:
    """The stamp of a file, without its modification time if that is very recent.

    A change of the file in the same tick of the clock would not change that time.
    """
    status = path.stat()
    if abs(time.time_ns() - status.st_mtime_ns) < CLOCK_TICK:
        return replace(stamp(path), mtime_ns=None)
    return _stamped(path, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)


@lru_cache(maxsize=256)  # frames of a shot share files
def _stamped(path: Path, *_status: int) -> Stamp:
    return stamp(path)


def unchanged(path: Path | str, recorded: Stamp, *, read: bool = False) -> bool:
    """Whether a file is as recorded; `read` compares its hash even if size and time agree."""
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
    """Convert a value for JSON; dataclasses become dictionaries without the default values."""
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
    """Decide whether a job must be done, and whether its record must be updated.

    Args:
        job: The job.
        ledger: The records in its output folder.
        read_inputs: Whether to compare the content of inputs, even if size and time agree.

    Returns:
        The reason to do it, as text, empty for a new job; None if it is finished. Then, for a
        finished job whose record must be updated, the stamps of inputs that were moved (empty if
        only the split changed); else None.
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
    """Why a job must be done again, if its record alone tells: a key of `AGAIN`; else empty."""
    if record.status == "failed":
        return "failed"
    if record.recipe == recipe(job):
        return ""
    names = {role: path.name for role, path in job.files.items()}
    was = {role: Path(stamp.path).name for role, stamp in record.inputs.items()}
    is_other = any(changed_settings(record.settings, settings(job)))
    return "settings" if is_other or names == was else "inputs"


def _moved(job: Job, record: Record, out: Path, *, read_inputs: bool) -> dict[str, Stamp] | None:
    """The stamps of inputs that are now at another path, by role; None if an input has changed."""
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
    """How the picture in a record differs from that of a job, as text; empty if it does not.

    It differs if another colour file was used or, with ``keep_lenses``, another lens or view.
    """
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

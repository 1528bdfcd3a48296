"""The identity of a job: its settings, their hash, and stamps of its files.

The recipe is the hash of all that decides its outputs but the inputs' contents: lens, reading,
kinds and types of outputs, quality, the names of its files, and the version of the renderer. Where
it computes (device, threads), where OUT is and what time it is are no part of it. What a run does
again is decided in `resume`.

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
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, lru_cache
from hashlib import blake2b
from pathlib import Path
from typing import Any

from defocus_core.batch.journal.record import Stamp
from defocus_core.io.below import Folder, open_plain
from defocus_core.renderer_version import RENDERER_VERSION
from defocus_core.request.job import FrameLens, Job, Outputs, Reading, Shot
from defocus_core.request.lens import Lens
from defocus_core.request.parameters import LENS_FILES
from defocus_core.system.text import version

DIGEST = 16  # bytes of a hash
CLOCK_TICK = 50_000_000  # ns, more than the step of any file system's times
_ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False)
# Where OUT is, and where a lens stands, not what it is.
_PLACES = ("root", "overwrite", "focus_source", *LENS_FILES)
_MAX_STAMPS = 256
_PLAIN = frozenset({str, int, bool, type(None)})
_STAMPS: dict[tuple[object, ...], Stamp] = {}


@lru_cache(maxsize=4096)  # jobs share their lenses, readings and outputs
def _plain(value: Lens | Reading | Outputs) -> dict[str, Any]:
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

    def taken(frames: Sequence[FrameLens]) -> list[Any]:
        return [[frame.picture.frame, _plain(frame.lens)] for frame in frames]

    return {
        "frame": frame,
        "sample": taken(shot.sample),
        "window": [picture.frame for picture in shot.neighbours],
        "focus": taken(shot.focus),
        **({} if shot.motion is None else {"motion": shot.motion}),
    }


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
    """The hash of everything that decides the outputs of a job but the bytes of its inputs.

    A ``max-coc`` decides which lens is drawn, and that alone: `resume` asks if it still does.
    """
    asked = settings(job)
    if "max_coc" in asked["lens"]:
        lens = {key: value for key, value in asked["lens"].items() if key != "max_coc"}
        asked = {**asked, "lens": lens}
    names = {role: path.name for role, path in job.files.items()}
    return digest({"settings": asked, "names": names, "renderer": renderer})


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
        hashed = blake2b(digest_size=DIGEST)
        while block := file.read(2**20):
            hashed.update(block)
        status = os.fstat(file.fileno())
    return Stamp("", status.st_size, status.st_mtime_ns, hashed.hexdigest())


def settled_stamp(path: Path) -> Stamp:
    """The `stamp` of a file, without a time so recent that a later change could have the same."""
    status = path.stat()
    key = (str(path), status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
    if key in _STAMPS:  # frames of a shot share files
        return _STAMPS[key]
    found = stamp(path)
    if abs(time.time_ns() - (found.mtime_ns or 0)) < CLOCK_TICK:
        return found._replace(mtime_ns=None)
    if found.mtime_ns == status.st_mtime_ns:
        _STAMPS[key] = found
        while len(_STAMPS) > _MAX_STAMPS:
            _STAMPS.pop(next(iter(_STAMPS)))
    return found


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

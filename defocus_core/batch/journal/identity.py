"""The identity of a job: the hash of its settings and of the bytes of its inputs.

The recipe is the hash of all that decides its outputs but the inputs' contents: lens, reading,
kinds and types of outputs, quality, the names of its files, and the version of the renderer. Where
it computes (device, threads), where OUT is and what time it is are no part of it. The job itself is
the hash of its recipe and its inputs. What a run does again is decided in `resume`.

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
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, lru_cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, TypeVar

from defocus_core.io.below import Folder, open_plain
from defocus_core.renderer_version import RENDERER_VERSION
from defocus_core.request.job import FrameLens, Job, Outputs, Reading, Shot
from defocus_core.request.lens import Lens
from defocus_core.request.parameters import LENS_FILES
from defocus_core.system.text import version

DIGEST = 16  # bytes of a hash
CLOCK_TICK = 50_000_000  # ns, more than the step of any file system's times
Stamp = Mapping[str, Any]
_ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), allow_nan=False)
# Where OUT is, and where a lens stands, not what it is.
_PLACES = ("root", "overwrite", "focus_source", *LENS_FILES)
_MAX_STAMPS = 256
_STAMPS: dict[tuple[object, ...], dict[str, Any]] = {}


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
        **({} if job.shot is None else {"shot": shot_settings(job.shot, job.picture.frame)}),
    }


def shot_settings(shot: Shot, frame: int | None) -> dict[str, Any]:
    """What a job takes of its shot, by frame; the files of the frames are inputs."""

    def taken(frames: Sequence[FrameLens]) -> list[Any]:
        return [[frame.picture.frame, _plain(frame.lens)] for frame in frames]

    return {
        "frame": frame,
        "sample": taken(shot.sample),
        "window": [picture.frame for picture in shot.window],
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


def recipe(job: Job) -> str:
    """The hash of everything that decides the outputs of a job but the bytes of its inputs."""
    names = {role: path.name for role, path in job.files.items()}
    return digest({"settings": settings(job), "names": names, "renderer": RENDERER_VERSION})


def name(recipe: str, inputs: Mapping[str, Stamp]) -> str:
    """The name of a job: the hash of its recipe and the bytes of its inputs."""
    return digest([recipe, {role: stamp.get("blake2b") for role, stamp in inputs.items()}])


def digest(value: object) -> str:
    """The hash of a plain value."""
    return blake2b(_ENCODER.encode(value).encode(), digest_size=DIGEST).hexdigest()


def versions() -> dict[str, Any]:
    """The versions of the package and of the renderer, as records have them."""
    return {"version": version(), "renderer": RENDERER_VERSION}


def stamp(path: Path, root: Path | None = None) -> dict[str, Any]:
    """Size, time of modification and hash of a file.

    `root`: the folder that it lies below, no link of which is followed; None for a file that the
    user named.
    """
    below = root and path.relative_to(root).as_posix()
    with Folder(root).open(below) if root and below else open_plain(path) as file:
        hashed = blake2b(digest_size=DIGEST)
        while block := file.read(2**20):
            hashed.update(block)
        status = os.fstat(file.fileno())
    return {"size": status.st_size, "mtime_ns": status.st_mtime_ns, "blake2b": hashed.hexdigest()}


def settled_stamp(path: Path) -> dict[str, Any]:
    """The `stamp` of a file, without a time so recent that a later change could have the same."""
    status = path.stat()
    key = (str(path), status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
    if key in _STAMPS:  # frames of a shot share files
        return dict(_STAMPS[key])
    settled = stamp(path)
    if abs(time.time_ns() - settled["mtime_ns"]) < CLOCK_TICK:
        del settled["mtime_ns"]
    elif settled["mtime_ns"] == status.st_mtime_ns:
        _STAMPS[key] = dict(settled)
        while len(_STAMPS) > _MAX_STAMPS:
            _STAMPS.pop(next(iter(_STAMPS)))
    return settled


def unchanged(path: Path | str, recorded: Stamp, *, read: bool = False) -> bool:
    """Whether a file is as it was recorded.

    `read`: compare the bytes even if size and time are those recorded.
    """
    try:
        status = os.stat(path)  # noqa: PTH116 - it is asked of each file of all jobs
        if status.st_size != recorded.get("size"):
            return False
        if status.st_mtime_ns == recorded.get("mtime_ns") and not read:
            return True
        return "blake2b" in recorded and stamp(Path(path))["blake2b"] == recorded["blake2b"]
    except OSError:
        return False


T = TypeVar("T")


def plain(value: Any, *, absolute: bool = False) -> Any:
    """A value without classes: dataclasses become dictionaries, tuples lists, paths text."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = ((field, getattr(value, field.name)) for field in dataclasses.fields(value))
        return {f.name: plain(v, absolute=absolute) for f, v in fields if v != f.default}
    if isinstance(value, list | tuple):
        return [plain(item, absolute=absolute) for item in value]
    if isinstance(value, Path):
        return str(value.absolute() if absolute else value)
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def typed(kind: type[T], value: Any) -> T:
    """The dataclass of a kind that `plain` made a dictionary of."""
    try:
        result: T = _typed(kind, value)
    except (TypeError, KeyError, AttributeError, IndexError) as error:
        raise ValueError(f"is no {kind.__name__}: {error}") from None
    return result


def _typed(kind: Any, value: Any) -> Any:
    origin = typing.get_origin(kind)
    if origin in (typing.Union, types.UnionType):
        options = [option for option in typing.get_args(kind) if option is not type(None)]
        return None if value is None else _typed(options[0], value)
    if origin is tuple:
        kinds = typing.get_args(kind)
        if kinds[-1] is Ellipsis:
            return tuple(_typed(kinds[0], item) for item in value)
        return tuple(_typed(*pair) for pair in zip(kinds, value, strict=True))
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        hints = _hints(kind)
        return kind(**{name: _typed(hints[name], item) for name, item in value.items()})
    return kind(value)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    return typing.get_type_hints(kind)

"""The memory budget of a process, and its share for the arrays of pictures. All in MB.

What a process may take beyond itself is shared by the arrays of pictures and by what is computed.
A picture whose arrays fit into half of that is held as it is read and made. Two more, the one that
is read and the one that is written meanwhile, are held beside it as long as all take a quarter at
most. A larger picture is kept in scratch files, and the process has no other meanwhile.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from defocus_cli.jobs.job import Job, Machine, Picture
from defocus_cli.system import memory
from defocus_cli.system.arrays import Keeping
from defocus_cli.system.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

# Of what is available, what a process takes unless it is told.
SHARE = 0.8
# Of what it may take beyond itself, what the arrays of one picture may take, and of some together;
# how many these are.
_FOR_ARRAYS, _FOR_PICTURES, _PICTURES = 0.5, 0.25, 3
# What strips take at most.
_STRIPS_MB = 168.0
# By which what one process takes for itself differs from what the next does.
_SPARE_MB = 4.0
_FLOAT = 4  # bytes
_BYTES = {"uint8": 1, "uint16": 2, "half": 2, "float16": 2, "uint": 4, "uint32": 4}


@dataclass(frozen=True)
class Holding:
    """What a picture takes beside what is computed.

    Attributes:
        arrays_mb: its inputs and outputs.
        whole_mb: files that can only be decoded at once.
        scratch: whether its arrays lie in scratch files.
        files_mb: what is held of its files and of those of the pictures beside it.
        room_mb: what is left to compute in.
    """

    arrays_mb: float
    whole_mb: float
    scratch: bool
    files_mb: float
    room_mb: float

    @property
    def keeping(self) -> Keeping:
        """Where its arrays are kept."""
        return Keeping(self.scratch)


def holding(job: Job) -> Holding:
    """What the picture of a job takes, from the headers of its files."""
    return _held(*_sizes(job), capacity_mb(job.machine))


def _held(arrays_mb: float, whole_mb: float, room_mb: float) -> Holding:
    """What a picture takes of the room that a process has beyond itself."""
    scratch = arrays_mb > _FOR_ARRAYS * room_mb
    strips = min(_STRIPS_MB, 2 * arrays_mb)
    files = strips if scratch else _beside_each_other_mb(arrays_mb, room_mb)
    return Holding(arrays_mb, whole_mb, scratch, files, max(room_mb - files, 0.0))


def _beside_each_other_mb(arrays_mb: float, room_mb: float) -> float:
    """What the arrays of pictures may take that are read, computed and written at one time."""
    return min(max(arrays_mb, _FOR_PICTURES * room_mb), _PICTURES * arrays_mb)


def enough_mb(job: Job, needed_mb: float) -> float:
    """A limit with which there is so much to compute in; the least one, within a few percent."""
    sizes, room = _sizes(job), max(capacity_mb(job.machine), 1.0)
    # Rounded up, it must still be one: arrays in memory leave less room than those in scratch.
    while min(_held(*sizes, mb).room_mb for mb in (room, 1.05 * room + 20)) < needed_mb:
        room *= 1.01
    return base_mb() + room + _SPARE_MB


def capacity_mb(machine: Machine) -> float:
    """What the process may take beyond what it takes anyway."""
    return max(limit_mb(machine) - base_mb(), 0.0)


def limit_mb(machine: Machine) -> float:
    """What the process may take."""
    return _usual_limit_mb() if machine.memory is None else machine.memory / memory.MB


@cache
def _usual_limit_mb() -> float:
    available = memory.available_mb()
    return math.inf if available is None else SHARE * available + memory.held_mb()


@cache
def base_mb() -> float:
    """What the process took when this was first asked for, which is before any picture."""
    return memory.held_mb()


def _sizes(job: Job) -> tuple[float, float]:
    """MB of the arrays of a job, and of its files that can only be decoded at once."""
    pixels, per_pixel, whole, channels = _inputs(job.picture)
    outputs, sample = job.outputs, 2 if _half(job) else _FLOAT
    if outputs.need_rendering:
        if job.picture.hidden is not None:
            _, behind, whole_behind, _ = _inputs(job.picture.hidden)
            per_pixel, whole = per_pixel + behind + _FLOAT + 1, max(whole, whole_behind)
        per_pixel += sum(kind.memory_bytes(channels, sample) for kind in outputs.rows)
    return pixels * (per_pixel + _FLOAT) / memory.MB, pixels * whole / memory.MB


def _inputs(picture: Picture) -> tuple[int, float, float, int]:
    """Pixels; bytes of each as arrays, and of those decoded at once; channels of the colour."""
    from defocus_cli.formats.describe import describe
    from defocus_cli.formats.exr_header import is_exr
    from defocus_cli.system.safe_files import read_head

    def told(path: Path) -> tuple[int, float, float, int]:
        info = describe(path)
        parts = info.parts
        if not is_exr(read_head(path)):  # of several pages, one is read
            parts = (max(parts, key=lambda part: len(part.channels)),)
        kinds = [kind for part in parts for _, kind in part.channels]
        native = sum(_BYTES.get(kind, _FLOAT) for kind in kinds)
        return info.width * info.height, native, native if info.at_once else 0.0, len(kinds)

    try:
        pixels, native, color_whole, count = told(picture.color)
        _, _, depth_whole, _ = told(picture.depth)
        arrays = native if is_exr(read_head(picture.color)) else _FLOAT * count
    except InputError:  # who decodes it says it better
        return 0, 0.0, 0.0, 0
    return pixels, arrays + _FLOAT, max(color_whole, depth_whole), min(count, 4)


def _half(job: Job) -> bool:
    """Whether the images of a job need be kept in half only."""
    outputs = job.outputs
    return (outputs.format, outputs.exr_type, outputs.preview) == ("exr", "half", False)


def image_type(job: Job) -> str:
    """The type in which the images of a job are kept until they are written."""
    return "float16" if _half(job) else "float32"


class Gate:
    """Lets pictures in as long as they fit beside each other, and one in any case."""

    def __init__(self) -> None:
        self._held: dict[int, float] = {}
        self._opened = False
        self._changed = threading.Condition()

    def enter(self, number: int, job: Job) -> None:
        """Wait until there is room for the picture of a job."""
        arrays, room = _sizes(job)[0], capacity_mb(job.machine)
        limit = _beside_each_other_mb(arrays, room)
        need = limit if arrays > _FOR_ARRAYS * room else arrays  # in scratch, it is alone
        with self._changed:
            self._changed.wait_for(
                lambda: self._opened or not self._held or sum(self._held.values()) + need <= limit
            )
            self._held[number] = need

    def open(self) -> None:
        """Let nobody wait any longer."""
        with self._changed:
            self._opened = True
            self._changed.notify_all()

    def leave(self, number: int) -> None:
        """The picture of a job is let go."""
        with self._changed:
            self._held.pop(number, None)
            self._changed.notify_all()

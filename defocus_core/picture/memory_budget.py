"""Memory of a process in MB: whether a picture fits, alone and while others are read or written.

  limit     memory that the process may take in total
  base      memory of the program itself, before any picture
  capacity  limit minus base
  arrays    decoded inputs and outputs of a picture
  bound     upper bound of the memory that rendering takes in addition to the arrays

A picture is rendered if its arrays and its bound fit into the capacity. Other pictures are read or
written at the same time as long as they fit, too.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import cache
from typing import TYPE_CHECKING

from defocus_core.errors import InputError, TooLarge
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.images.describe import SAMPLE_BYTES, describe
from defocus_core.io.read_files import read_head
from defocus_core.request.job import Job, Machine, PictureFiles
from defocus_core.system import memory
from defocus_core.system.process import is_torch_loaded

if TYPE_CHECKING:
    from defocus_core.renderer.engine.renderer import Renderer

# Share of the available memory that a process takes without --memory.
SHARE = 0.8
# Memory for the smallest picture; and for others, as a multiple of their arrays.
_LEAST_MB, _USUAL = 160.0, 4.0
# Memory of the code of libraries, which is loaded on first use.
_OF_CALLS_MB = 32.0
# Memory of torch and of the modules that use it, which are loaded where compiled loops do not do.
_OF_TORCH_MB = 200.0
# Greatest difference of base memory between two processes.
_SPARE_MB = 4.0
_FLOAT = 4  # bytes
_TILES = (512, 256, 128)  # sides of tiles in px that errors propose


def arrays_mb(job: Job) -> float:
    """Memory in MB of the input and output arrays of a job, estimated from file headers."""
    return _sizes(job)[0]


def enough_mb(arrays: float, needed: float) -> float:
    """The least memory limit in MB that is sufficient for arrays and further needs, both in MB."""
    return base_mb() + arrays + needed + _SPARE_MB


def require_room(job: Job) -> None:
    """Raise TooLarge if the arrays of a job do not fit; its files are not decoded for this."""
    arrays, whole = _sizes(job)
    if arrays + whole <= (left := capacity_mb(job.machine)):
        return
    problem = f"takes {arrays + whole:.0f} MB decoded, {left:.0f} MB are left"
    enough = enough_mb(arrays, _USUAL * max(arrays, whole) + _LEAST_MB)
    remedy = _remedy(job, enough, "", "cpu")
    raise TooLarge("out-of-memory", problem, remedy, path=job.picture.color)


def capacity_mb(machine: Machine) -> float:
    """Memory in MB that the process may take for pictures."""
    return max(limit_mb(machine) - base_mb(), 0.0)


def limit_mb(machine: Machine) -> float:
    """Memory in MB that the process may take in total."""
    return _usual_limit_mb() if machine.memory is None else machine.memory / memory.MB


@cache
def _usual_limit_mb() -> float:
    available = memory.available_mb()
    return math.inf if available is None else SHARE * available + memory.held_mb()


def base_mb() -> float:
    """Memory in MB of the program with its libraries, without pictures."""
    mb, with_torch = _first_mb()
    return mb + (_OF_TORCH_MB if is_torch_loaded() and not with_torch else 0.0)


@cache
def _first_mb() -> tuple[float, bool]:
    """The base memory in MB, measured at the first call; and whether torch was loaded then."""
    return memory.held_mb() + _OF_CALLS_MB, is_torch_loaded()


def _sizes(job: Job) -> tuple[float, float]:
    """Memory in MB of the arrays of a job; and that of decoding files that are decoded whole."""
    pixels, per_pixel, whole, channels = _inputs(job.picture, job.reading.blur_channels)
    outputs, sample = job.outputs, 2 if image_type(job) == "float16" else _FLOAT
    if outputs.need_rendering:
        for other in job.picture.others.values():
            _, behind, whole_behind, _ = _inputs(other)
            per_pixel, whole = per_pixel + behind + _FLOAT + 1, max(whole, whole_behind)
        per_pixel += sum(kind.memory_bytes(channels, sample) for kind in outputs.rows)
    return pixels * (per_pixel + _FLOAT) / memory.MB, pixels * whole / memory.MB


def _inputs(picture: PictureFiles, passes: Sequence[str] = ()) -> tuple[int, float, float, int]:
    """Estimate the memory of an input picture; `passes` are patterns of further channels to blur.

    Returns:
        The number of pixels; bytes per pixel of the decoded arrays; bytes per pixel that decoding
        takes besides, in formats that are decoded as a whole; and the number of rendered channels.
    """
    pixels, count, arrays, whole = 0, 0, 0.0, 0.0
    for path in dict.fromkeys((picture.depth, picture.color)):
        try:
            info = describe(path)
        except InputError:  # the decoder reports the problem, or the file has no header
            continue
        is_part = is_exr(read_head(path))
        # of several pages one is read
        parts = info.parts if is_part else (max(info.parts, key=lambda part: len(part.channels)),)
        channels = [channel for part in parts for channel in part.channels]
        native: float = sum(SAMPLE_BYTES.get(channel.type, 8) for channel in channels)
        if any(part.deep for part in parts):
            # the picture in focus in floats; of each layer its channels, metres and radius; and
            # samples as they are decoded and sorted: their channels twice, place, order and rank
            from defocus_core.io.exr.deep_layers import MAX_LAYERS
            from defocus_core.io.exr.deep_samples import count_samples

            counts = [count_samples(path, header) for header in read_headers(path) if header.deep]
            layers = min(MAX_LAYERS, max(most for most, _ in counts))
            samples = max(every for _, every in counts)
            held = samples / info.pixels * _FLOAT * (2 * len(channels) + 6)
            native = _FLOAT * len(channels) + layers * (native + 2 * _FLOAT) + held
        if not is_part:
            whole = max(whole, native)
        if path == picture.color:
            light = sum(any(fnmatchcase(c.name, each) for each in passes) for c in channels)
            pixels, count = info.pixels, min(len(channels), 4) + light
            arrays = (native if is_part else _FLOAT * count) + _FLOAT
    return pixels, arrays, whole if pixels else 0.0, count


def image_type(job: Job) -> str:
    """The NumPy type of rendered images in memory: float16 if written as half EXR, else float32."""
    outputs = job.outputs
    is_half = (outputs.format, outputs.exr_type, outputs.preview) == ("exr", "half", False)
    return "float16" if is_half else "float32"


def bound_of(job: Job, renderer: Renderer, arrays: float, device: str) -> float:
    """An upper bound in MB of the memory that rendering takes besides `arrays`, in MB.

    TooLarge is raised if it does not fit; the remedy names options with which it does.
    """
    from defocus_core.renderer.engine.memory_bound import memory_bound

    threads, room = job.machine.threads, memory.available_mb(device)
    room = math.inf if room is None else room
    if device == "cpu":
        room = max(min(room, capacity_mb(job.machine) - arrays), 0.0)

    def needed(threads: int, tile: int | None = None) -> float:
        return memory_bound(renderer.with_tile(tile), threads) / memory.MB

    if (bound := needed(threads)) <= room:
        return bound
    mb = [math.ceil(part) for part in (base_mb(), arrays, bound)]
    one = "‹threads› 1 " if threads > 1 else ""
    ways: dict[str, tuple[int, int | None]] = {one.strip(): (1, None)} if one else {}
    ways |= {f"{one}‹tile› {tile}": (1, tile) for tile in _TILES}
    fits = next((way for way, (count, tile) in ways.items() if needed(count, tile) <= room), "")
    raise TooLarge(
        "out-of-memory",
        f"needs {sum(mb)} MB to render ({mb[0]} for the program, {mb[1]} for its "
        f"files, {mb[2]} for the picture), "
        f"but {min(limit_mb(job.machine), base_mb() + arrays + room):.0f} MB are allowed",
        _remedy(job, enough_mb(arrays, bound), fits, device),
        path=job.picture.color,
    )


def _remedy(job: Job, enough: float, fits: str, device: str) -> str:
    """The remedy for lack of memory: options that fit, or a memory limit of `enough` MB."""
    machine = memory.available_mb(device)
    ways = [fits] if fits else []
    if device == "cpu" and (machine is None or enough < machine + base_mb()):
        ways.append(f"‹memory› {_size(enough)}")
    return f"use {' or '.join(ways)}" if ways else "use a smaller picture or a machine with more"


def _size(mb: float) -> str:
    """A size in MB as a value of ‹memory›, rounded up."""
    tens = math.ceil(mb * memory.MB / 10**7)
    return f"{10 * tens}MB" if tens < 1000 else f"{math.ceil(tens / 10) / 10:.1f}GB"


class Gate:
    """Lets pictures of a pipeline be read only if they fit into memory beside the others.

    The first picture may always be read. Others may be read once a picture was rendered, so that
    the memory of rendering can be estimated, in proportion to the arrays of a picture.
    """

    def __init__(self) -> None:
        self._held: dict[int, float] = {}
        self._work = math.inf  # MB to render per MB of arrays
        self._opened = False
        self._changed = threading.Condition()

    def enter(self, number: int, job: Job) -> None:
        """Wait until the picture of a job may be read; `number` identifies it."""
        need, capacity = sum(_sizes(job)), capacity_mb(job.machine)

        def fits() -> bool:
            every = [need, *self._held.values()]
            return sum(every) + self._work * max(every) <= capacity

        with self._changed:
            self._changed.wait_for(lambda: self._opened or not self._held or fits())
            self._held[number] = need

    def rendered(self, number: int, bound: float) -> None:
        """Note that a picture was rendered, with an upper bound in MB of what it took."""
        with self._changed:
            work = bound / (self._held[number] or 1.0)
            self._work = work if math.isinf(self._work) else max(self._work, work)
            self._changed.notify_all()

    def open(self) -> None:
        """Let all pictures be read from now on."""
        with self._changed:
            self._opened = True
            self._changed.notify_all()

    def leave(self, number: int) -> None:
        """Note that the arrays of a picture were freed."""
        with self._changed:
            self._held.pop(number, None)
            self._changed.notify_all()

"""Execution of jobs in this process, by a pipeline that reads, renders and writes at the same time.

While a picture is rendered, the next one is decoded and the previous one is encoded, if memory
allows. At most one picture waits to be rendered, and one to be written. Small pictures are read,
rendered and written one after the other, as threads would only wait for each other.

Results may be sent to other processes. So they have no arrays; paths of outputs are relative to the
output folder, and those of inputs are left out. Exceptions are not sent.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

from msgspec.structs import replace as copy

from defocus_core.batch.journal import resume
from defocus_core.batch.journal.record import Completed, Failed, Stamp, failure
from defocus_core.batch.workers.run import Chunk, Done
from defocus_core.io.read_files import read_head
from defocus_core.picture import plain_path
from defocus_core.picture.memory_budget import Gate
from defocus_core.picture.take import Inputs, Take, measures, repair_record
from defocus_core.request.job import Job
from defocus_core.request.lens import lens_record
from defocus_core.request.parameters import LENS_FILES
from defocus_core.system.process import delayed_signals, settings_kept
from defocus_core.system.text import software

TileCount = Callable[[int, int], None]
_Read = tuple[int, Job, Inputs | Failed]
_DIGITS = 6  # decimals of radii and measures
_SMALL = 1 << 16  # greatest number of pixels of a small picture


class Reader:
    """Decodes the inputs of jobs, only once for consecutive jobs of the same picture."""

    def __init__(self) -> None:
        self._last: tuple[object, Inputs] | None = None

    def read(self, job: Job) -> Inputs | Failed:
        """The decoded inputs of a job, or its failure."""
        files = job.files
        key = (job.picture, job.reading, job.lens_focal, job.outputs.need_rendering)
        if self._last is not None and self._last[0] == key:
            inputs = self._last[1]
            shared = {role: stamp for role, stamp in inputs.stamps.items() if role in files}
            own = _stamps({role: path for role, path in files.items() if role in LENS_FILES})
            return replace(inputs, stamps=shared | own, seconds=0.0)
        self._last = None  # free a picture before the next is decoded
        start, stamps = time.perf_counter(), _stamps(files)
        try:
            for _, label in job.picture.carried:
                read_head(label)
            inputs = plain_path.read(job)
        except Exception as error:
            return failure(error, "read", stamps)
        inputs = replace(inputs, stamps=stamps, seconds=time.perf_counter() - start)
        self._last = key, inputs
        return inputs


def _stamps(files: Mapping[str, Path]) -> dict[str, Stamp]:
    """The stamps of files by role. Unreadable files are left out, as decoding reports them."""
    stamps: dict[str, Stamp] = {}
    for role, path in files.items():
        with suppress(OSError):
            stamps[role] = resume.settled_stamp(path)
    return stamps


def write(take: Take | Failed) -> Completed | Failed:
    """Write the outputs of a job, safe on disk when this returns; returns a failure as it is."""
    if isinstance(take, Failed):
        return take
    start = time.perf_counter()
    job, inputs = take.job, take.inputs.stamps
    try:
        take = plain_path.write(take)
        root = job.outputs.root
        outputs = {
            name: copy(resume.stamp(root / path, root), path=path)
            for name, path in job.names.items()
        }
    except Exception as error:
        return failure(error, "write", inputs)
    writing = time.perf_counter() - start
    seconds = {"read": take.inputs.seconds, "render": take.seconds}
    seconds |= {"write": writing, "cpu": take.cpu_seconds}
    numbers = measures(take).items()
    return Completed(
        inputs=dict(inputs),
        outputs=outputs,
        lens=lens_record(take.lens),
        size=take.size,
        coc_px=take.limits,
        color_note=take.color_note,
        depth_note=take.depth_words(),
        depth_repair=repair_record(take.repair),
        device=take.device,
        back=take.back,
        software=software(),
        measures={k: None if v is None else float(f"{v:.{_DIGITS}g}") for k, v in numbers},
        warnings=tuple(take.warnings),
        seconds={k: round(v, 4) for k, v in seconds.items()},
        stats=dict(take.stats),
    )


def execute(
    chunks: Iterator[Chunk],
    done: Done,
    stopped: Callable[[], bool],
    progress: TileCount | None = None,
) -> None:
    """Do the jobs of a batch in this process, without threads if there is only one.

    ``done`` is called with number and outcome of each job; `stopped` tells whether to begin no
    more. With only one job, `progress` is called with the numbers of finished and of all tiles.
    """
    plain_path.load()
    jobs = chain.from_iterable(chunks)
    first = [*islice(jobs, 2)]
    with settings_kept():
        if len(first) > 1:
            run(chain(first, jobs), done, stopped=stopped)
        for number, job in first if len(first) == 1 else ():
            take = _computed(job, Reader().read(job), progress)
            with delayed_signals():  # no file stays half-written, or written without a record
                done(number, write(take))


def _computed(
    job: Job, inputs: Inputs | Failed, progress: TileCount | None = None
) -> Take | Failed:
    """Render a job; returns its take (inputs, lens and rendered planes) or its failure."""
    if isinstance(inputs, Failed):
        return inputs
    try:
        return plain_path.compute(plain_path.prepare(job, inputs), progress)
    except Exception as error:
        return failure(error, "render", inputs.stamps)


def run(
    jobs: Iterable[tuple[int, Job]], done: Done, stopped: Callable[[], bool] = lambda: False
) -> None:
    """Do numbered jobs in order; ``done`` is called with number and outcome of each.

    It may be called in another thread, but not twice at the same time.
    """
    gate, reader, numbered = Gate(), Reader(), iter(jobs)
    decoding, ended = threading.Lock(), threading.Event()

    def decode() -> _Read | None:
        for number, job in numbered:
            gate.enter(number, job)
            with decoding:
                return None if ended.is_set() else (number, job, reader.read(job))
        return None

    def finish(number: int, take: Take | Failed) -> None:
        try:
            done(number, write(take))
        finally:
            gate.leave(number)

    ahead, behind = ThreadPoolExecutor(1, "reader"), ThreadPoolExecutor(1, "writer")
    behind.submit(int).result()  # a pool loses a thread if a signal interrupts its start
    following: Callable[[], _Read | None] = ahead.submit(decode).result
    last: Future[None] | None = None
    try:
        while (item := following()) is not None:
            number, job, inputs = item
            is_small = isinstance(inputs, Inputs) and math.prod(inputs.color.shape[:2]) <= _SMALL
            following = decode if is_small else ahead.submit(decode).result
            if stopped():
                break
            take = _computed(job, inputs)
            if not isinstance(take, Failed):
                gate.rendered(number, take.bound_mb)
            del item, inputs
            if last is not None:
                last.result()
            if is_small:
                with delayed_signals():
                    finish(number, take)
                last = None
            else:
                last = behind.submit(finish, number, take)
            del take
    finally:
        try:
            ended.set()
            gate.open()
            with decoding:  # a C decoder that outlives Python would abort the process
                ahead.shutdown(wait=False)
        finally:
            _wait_for(behind)
            behind.shutdown(wait=False)
    if last is not None:
        last.result()


def _wait_for(pool: ThreadPoolExecutor) -> None:
    """Wait for the tasks of a pool, even if a signal interrupts once, to leave complete files."""
    try:
        wait([pool.submit(int)])  # which comes after it
    except BaseException:
        wait([pool.submit(int)])
        raise

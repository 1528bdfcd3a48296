"""A worker process that does jobs for the coordinator of a batch.

It is sent (number, job), and None when no further one is to be begun: what it has not begun to
compute by then it lets go. It sends ``ready`` when it can start, then (number, record) for each
that it did. It ends when the coordinator is gone, and leaves Ctrl-C to it.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from queue import SimpleQueue
from typing import TYPE_CHECKING

from defocus_core.batch.jobs.job import Job
from defocus_core.batch.journal.journal import Record
from defocus_core.batch.rendering import job_steps
from defocus_core.batch.workers import pipeline

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

READY = "ready"


def serve(connection: Connection) -> None:
    """Do the jobs that come through the connection."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    stopped = threading.Event()
    jobs = _received(connection, stopped)
    job_steps.load()

    def send(number: int, record: Record) -> None:
        connection.send((number, {key: value for key, value in record.items() if key != "error"}))

    connection.send(READY)
    pipeline.run(jobs, send, stopped=stopped.is_set)
    connection.close()
    os._exit(0)  # all results are sent; PyTorch would take a second to end


def _received(connection: Connection, stopped: threading.Event) -> Iterator[tuple[int, Job]]:
    """The jobs that are sent; ``stopped`` is set when no further one is to be begun.

    When the coordinator is gone, this process ends, whatever it is at: the next coordinator does
    the same jobs, and writes to the same files.
    """
    queue: SimpleQueue[tuple[int, Job] | None] = SimpleQueue()

    def listen() -> None:  # even while libraries are imported, and while a job waits to be read
        try:
            while (numbered := connection.recv()) is not None:
                queue.put(numbered)
        except (EOFError, OSError):
            os._exit(1)
        stopped.set()
        queue.put(None)

    threading.Thread(target=listen, name="listener", daemon=True).start()
    return iter(queue.get, None)

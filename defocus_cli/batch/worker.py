"""A worker process that does jobs for the coordinator of a batch.

It is sent (number, job), and None when no further one is to be begun: what it has not begun to
compute by then it lets go. It sends ``ready`` when it can start, then (number, result) for each
that it did. It ends when the coordinator is gone, and leaves Ctrl-C to it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from queue import SimpleQueue
from typing import TYPE_CHECKING

from defocus_cli.batch import pipeline
from defocus_cli.batch.job_result import Result
from defocus_cli.jobs.job import Job
from defocus_cli.rendering import job_steps

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

READY = "ready"


def serve(connection: Connection) -> None:
    """Do what comes through the connection."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_coordinator()
    job_steps.load()

    def send(number: int, result: Result) -> None:
        connection.send((number, {key: value for key, value in result.items() if key != "error"}))

    connection.send(READY)
    stopped = threading.Event()
    pipeline.run(_received(connection, stopped), send, stopped=stopped.is_set)
    connection.close()
    os._exit(0)  # all is told and written; taking PyTorch down takes a second


def _received(connection: Connection, stopped: threading.Event) -> Iterator[tuple[int, Job]]:
    """The jobs that are sent; ``stopped`` is set when no further one is to be begun."""
    queue: SimpleQueue[tuple[int, Job] | None] = SimpleQueue()

    def listen() -> None:  # even while a job waits to be read
        try:
            while (numbered := connection.recv()) is not None:
                queue.put(numbered)
        except (EOFError, OSError):
            os._exit(1)  # nobody wants what is being rendered
        stopped.set()
        queue.put(None)

    threading.Thread(target=listen, name="listener", daemon=True).start()
    while (numbered := queue.get()) is not None:
        yield numbered


def end_with_coordinator() -> None:
    """See to it that this process ends when the coordinator does, whatever it is at.

    Who follows the coordinator does the same jobs, and writes where this process would.
    """

    def watch() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, name="watch", daemon=True).start()

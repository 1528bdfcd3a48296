"""A process that does jobs for the coordinator of a batch.

It is sent (number, job), and None when there are no more; it sends ``ready`` when it can start,
then (number, result) for each. It ends when the coordinator is gone, and leaves Ctrl-C to it.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING

from defocus_cli import engine, pipeline
from defocus_cli.job import Job
from defocus_cli.work import Result

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

READY = "ready"


def serve(connection: Connection) -> None:
    """Do what comes through the connection."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    engine.load()

    def send(number: int, result: Result) -> None:
        connection.send((number, {key: value for key, value in result.items() if key != "error"}))

    connection.send(READY)
    pipeline.run(_received(connection), send)


def _received(connection: Connection) -> Iterator[tuple[int, Job]]:
    while True:
        try:
            numbered = connection.recv()
        except (EOFError, OSError):
            os._exit(1)  # nobody wants what is being rendered
        if numbered is None:
            return
        yield numbered

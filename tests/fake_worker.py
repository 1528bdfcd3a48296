"""Workers that render nothing and start at once; some jobs are bad for them."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from defocus_cli.job import Job
from defocus_cli.worker import READY


def result_of(job: Job) -> dict[str, Any]:
    """What became of a job: who did it."""
    name = job.sample_id
    if name.startswith("deadly"):
        os.kill(os.getpid(), signal.SIGKILL)
    if name.startswith("once"):
        mark = Path(job.picture.color)
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    if name.startswith("slow"):
        time.sleep(0.05)
    return {"status": "ok", "reason": None, "by": os.getpid(), "name": name}


def serve(connection: Connection) -> None:
    """Do what comes through the connection."""
    connection.send(READY)
    while (numbered := connection.recv()) is not None:
        number, job = numbered
        connection.send((number, result_of(job)))


def serve_nobody(connection: Connection) -> None:
    """Die before any work."""
    os._exit(7)

"""Workers that render nothing and start at once; some jobs are bad for them."""

import os
import signal
import time
from pathlib import Path
from types import SimpleNamespace

from defocus_core.batch.journal.record import Failed
from defocus_core.batch.journal.resume import versions
from defocus_core.batch.workers import pipeline, pool
from defocus_core.batch.workers.pool import READY
from defocus_core.picture import plain_path


def result_of(job):
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
    return SimpleNamespace(status="ok", by=os.getpid(), name=name)


def serve(connection):
    """Do what comes through the connection."""
    connection.send(READY)
    while (numbered := connection.recv()) is not None:
        number, job = numbered
        connection.send((number, result_of(job)))


def serve_slowly(connection):
    """Do what comes as a real worker does, whose steps take their time and make nothing."""

    def read(job):
        time.sleep(0.5)
        return Failed("fault", "makes nothing")

    pipeline.Reader = lambda: SimpleNamespace(read=read)
    plain_path.load = lambda: None
    pool.serve(connection)


def serve_on(connection):
    """Import something that takes a minute."""
    connection.send(READY)
    plain_path.load = lambda: time.sleep(60)
    pool.serve(connection)


def serve_mask(connection):
    """Say whether Ctrl-C is kept from this process."""
    connection.send(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))


def serve_nobody(connection):
    """Die before any work."""
    os._exit(7)


def do(jobs, threads):
    """What a Dask worker does."""
    results = [result_of(job) for job in jobs]
    return {"versions": versions(), "results": results}


def do_in_another_version(jobs, threads):
    """What a Dask worker does that has not been updated."""
    return {**do(jobs, threads), "versions": {"version": "0.0.1", "renderer": 1}}


def cannot_do(jobs, threads):
    """What a Dask worker does that lacks something."""
    raise ModuleNotFoundError("No module named 'torch'")

"""Workers that render nothing and start at once; some jobs are bad for them."""

import os
import signal
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

from defocus_core.batch.journal.record import Failed
from defocus_core.batch.journal.resume import versions
from defocus_core.batch.workers import dask_pool, pipeline, pool
from defocus_core.picture import plain_path

REAL_DO = dask_pool.do


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
    connection.send(pool.READY)
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
    connection.send(pool.READY)
    plain_path.load = lambda: time.sleep(60)
    pool.serve(connection)


def serve_mask(connection):
    """Say whether Ctrl-C is kept from this process."""
    connection.send(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))


def serve_nobody(connection):
    """Die before any work."""
    os._exit(7)


def do(jobs, threads, leader):
    """What a Dask worker does."""
    results = [result_of(job) for job in jobs]
    return {"versions": versions(), "results": results, "worker": "one"}


def do_in_another_version(jobs, threads, leader):
    """What a Dask worker does that has not been updated."""
    return {**do(jobs, threads, leader), "versions": {"version": "0.0.1", "renderer": 1}}


def cannot_do(jobs, threads, leader):
    """What a Dask worker does that lacks something."""
    raise ModuleNotFoundError("No module named 'torch'")


def do_elsewhere(jobs, threads, leader):
    """What a Dask worker does that has another folder under the name of OUT."""
    return REAL_DO([_elsewhere(job) for job in jobs], threads, leader)


def do_elsewhere_beside_a_copy(jobs, threads, leader):
    """The same where OUT is a copy of that of the leader, its lock included."""
    moved = [_elsewhere(job) for job in jobs]
    there, root = jobs[0].outputs.root, moved[0].outputs.root
    root.mkdir(exist_ok=True)
    for lock in there.glob(".journal*.lock"):
        (root / lock.name).write_bytes(lock.read_bytes())
    return REAL_DO(moved, threads, leader)


def _elsewhere(job):
    root = job.outputs.root
    return replace(job, outputs=replace(job.outputs, root=root.with_name(f"{root.name}-there")))

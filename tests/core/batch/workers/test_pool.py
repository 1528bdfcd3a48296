"""Processes do all jobs, whatever becomes of some of them."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import fake_worker
import pytest
from jobs_files import chunks_of

from defocus_core import InputError
from defocus_core.batch.workers.pool import Processes, dispatch


def results_of(chunks, processes=2, stopped=lambda done: False, serve=fake_worker.serve):
    results = {}

    def done(number, result):
        assert number not in results, "told twice"
        results[number] = result

    dispatch(Processes(processes, serve), chunks, done, lambda: stopped(results))
    return results


def test_each_job_is_done_once_and_all_processes_help(tmp_path):
    names = [f"slow{i}" for i in range(24)]
    results = results_of(chunks_of(tmp_path, *names, size=3))
    assert [results[i].name for i in range(24)] == names
    workers = {result.by for result in results.values()}
    assert len(workers) == 2
    assert os.getpid() not in workers
    assert all(not Path(f"/proc/{pid}").exists() for pid in workers), "they are gone"


def test_no_more_processes_than_work(tmp_path):
    results = results_of(chunks_of(tmp_path, "slow1", "slow2", size=2), processes=8)
    assert len({result.by for result in results.values()}) == 1


def test_jobs_of_a_process_that_was_killed_are_done_by_another(tmp_path):
    names = ["a", "once", "b", "c", "d"]
    results = results_of(chunks_of(tmp_path, *names), processes=1)
    assert [results[i].status for i in range(5)] == ["ok"] * 5
    assert len({result.by for result in results.values()}) > 1


def test_a_job_that_kills_its_processes_has_failed_and_no_other_has(tmp_path):
    names = [*"abc", "deadly1", *"def", "deadly2", *"ghi"]
    results = results_of(chunks_of(tmp_path, *names, size=2))
    failed = {names[n] for n, result in results.items() if result.status == "failed"}
    assert failed == {"deadly1", "deadly2"}
    assert len(results) == len(names)
    deadly = results[names.index("deadly1")]
    assert deadly.reason == "worker-died"
    assert "2 processes that worked on it died, the last by SIGKILL" in deadly.message


def test_processes_end_with_their_coordinator(tmp_path):
    script = (
        "import multiprocessing, os, signal, sys; sys.path.insert(0, sys.argv[1])\n"
        "import fake_worker; context = multiprocessing.get_context('spawn')\n"
        "ours, theirs = context.Pipe()\n"
        "started = context.Process(target=fake_worker.serve_on, args=(theirs,)); started.start()\n"
        "print(ours.recv(), started.pid, flush=True); os.kill(os.getpid(), signal.SIGKILL)"
    )
    words = [sys.executable, "-c", script, str(Path(__file__).parents[3] / "support")]
    ran = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=False)
    assert ran.returncode == -signal.SIGKILL
    ready, pid = ran.stdout.split()
    assert ready == "ready"
    while Path(f"/proc/{pid}").exists():
        time.sleep(0.01)


def test_ctrl_c_is_kept_from_the_first_process_too(tmp_path):
    """Python starts a process of its own before the first, and then lets SIGINT through."""
    script = (
        "import sys; sys.path.insert(0, sys.argv[1]); import fake_worker\n"
        "from defocus_core.batch.workers.pool import _Worker\n"
        "print(_Worker(fake_worker.serve_mask).connection.recv())"
    )
    words = [sys.executable, "-c", script, str(Path(__file__).parents[3] / "support")]
    ran = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
    assert ran.stdout == "True\n"


def test_nothing_new_is_begun_when_stopped(tmp_path):
    names = [f"slow{i}" for i in range(50)]
    taken = []

    def chunks():
        for chunk in chunks_of(tmp_path, *names, size=8):
            taken.append(chunk)
            yield chunk

    results = results_of(chunks(), stopped=lambda done: len(done) >= 4)
    assert 4 <= len(results) <= 8 * len(taken)
    assert len(taken) <= 4


def test_what_processes_have_read_ahead_is_let_go_when_stopped(tmp_path):
    """Of the jobs that a process has, it ends the one that it is at when it is told."""
    how = {"processes": 1, "stopped": lambda done: len(done) >= 1}
    results = results_of(chunks_of(tmp_path, *"abcdef"), serve=fake_worker.serve_slowly, **how)
    assert list(results) in ([0], [0, 1])


def test_processes_that_cannot_start_are_told_of(tmp_path):
    with pytest.raises(InputError, match=r"worker processes: die when they start \(exit code 7\)"):
        results_of(chunks_of(tmp_path, "a", "b"), serve=fake_worker.serve_nobody)


def test_what_cannot_be_recorded_stops_all(tmp_path):
    def done(number, result):
        raise InputError("", "is full", path="disk")

    pool = Processes(2, fake_worker.serve)
    with pytest.raises(InputError, match="is full"):
        dispatch(pool, chunks_of(tmp_path, *"abcdef"), done, lambda: False)
    assert all(each.process.exitcode is not None for each in pool.workers)

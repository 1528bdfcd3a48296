"""One writer: whoever comes second is told who is first, and a lock without a holder is none."""

from __future__ import annotations

import errno
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from typing import Any

import pytest
from refusals import refuses

from defocus_core.batch.journal import lock
from defocus_core.batch.journal.journal import Shard
from defocus_core.batch.journal.lock import LockLost, holder, lock_path, locked

HOLD = (
    "import sys, time; from pathlib import Path\n"
    "from defocus_core.batch.journal.lock import locked\n"
    "with locked(Path(sys.argv[1]), say=print): print('held', flush=True); time.sleep(60)"
)


@contextmanager
def held_elsewhere(out):
    """Another process that holds the lock."""
    words = [sys.executable, "-c", HOLD, str(out)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def try_lock(out, shard=None):
    """Hold the lock for a moment; the lines that were said."""
    said: list[str] = []
    with locked(out, shard, say=said.append):
        assert holder(out, shard) is not None
    return said


@pytest.fixture
def short_lease(monkeypatch):
    """A holder that has not touched its lock for a second has lost it."""
    monkeypatch.setattr(lock, "BEAT", 0.2)
    monkeypatch.setattr(lock, "LEASE", 1.0)
    monkeypatch.setattr(lock, "GLANCE", 0.5)


def leave(out):
    """The lock of a process of another machine, which nobody touches."""
    lines = ("filelock/2", "pid=1", "host=elsewhere", "mode=lease", "token=1f")
    path = lock_path(out)
    path.write_text("".join(f"{line}\n" for line in (*lines, f"duration={lock.LEASE}")))
    return path


def test_a_second_writer_is_told_who_is_first(tmp_path, monkeypatch):
    monkeypatch.setattr(lock, "GLANCE", 1e6)  # it need not wait until the lock seems forgotten
    with held_elsewhere(tmp_path) as first:
        name = f"process {first.pid} on {socket.gethostname()}"
        with refuses("in-use", name):
            try_lock(tmp_path)
        assert holder(tmp_path) == name


def test_a_lock_that_is_given_back_can_be_taken_and_leaves_no_file(tmp_path):
    assert try_lock(tmp_path) == try_lock(tmp_path) == []
    assert list(tmp_path.iterdir()) == []
    assert holder(tmp_path) is None


def test_the_lock_of_a_process_that_was_killed_is_taken_over_and_it_is_said(tmp_path):
    with held_elsewhere(tmp_path) as first:
        first.send_signal(signal.SIGKILL)
        first.wait()
        assert lock_path(tmp_path).exists()
        (said,) = try_lock(tmp_path)
    assert f"left behind by process {first.pid}" in said


def test_a_lock_of_a_process_that_was_killed_has_no_holder_and_asking_does_not_take_it(tmp_path):
    with held_elsewhere(tmp_path) as first:
        assert holder(tmp_path) is not None
        first.kill()
        first.wait()
        before = lock_path(tmp_path).read_bytes()
        assert holder(tmp_path) is None
        assert lock_path(tmp_path).read_bytes() == before


@pytest.mark.usefixtures("short_lease")
@pytest.mark.parametrize("ahead", [-1e6, 0.0, 1e6])
def test_a_lock_that_nobody_touches_is_taken_over_whatever_its_clock_says(ahead, tmp_path):
    path = leave(tmp_path)
    os.utime(path, (time.time() + ahead,) * 2)
    assert holder(tmp_path) == "process 1 on elsewhere"
    waiting, taken = try_lock(tmp_path)
    assert "process 1 on elsewhere has not touched it for 0.5 s; waiting 1 s in all" in waiting
    assert "left behind by process 1 on elsewhere" in taken
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("short_lease")
def test_a_holder_that_was_suspended_learns_that_it_lost_the_lock(tmp_path):
    """As `kill -STOP` does, which suspends the thread that touches the lock, too."""
    script = (
        "import sys; from pathlib import Path; from defocus_core.batch.journal import lock\n"
        "lock.BEAT, lock.LEASE, lock.GLANCE = 0.2, 1.0, 0.5\n"
        "with lock.locked(Path(sys.argv[1]), say=print) as require_held:\n"
        "    require_held(); print('held', flush=True); sys.stdin.readline()\n"
        "    try: require_held()\n"
        "    except lock.LockLost as error: print(str(error), flush=True)\n"
    )
    words = [sys.executable, "-c", script, str(tmp_path)]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(words, text=True, **pipes) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        first.send_signal(signal.SIGSTOP)
        with locked(tmp_path, say=print) as require_held:
            first.send_signal(signal.SIGCONT)
            told, _ = first.communicate("go on\n")
            assert f"was taken over by process {os.getpid()}" in told
            assert "run the same command again" in told
            require_held()


def test_a_holder_whose_lock_was_removed_learns_it(tmp_path):
    with locked(tmp_path, say=print) as require_held:
        require_held()
        lock_path(tmp_path).unlink()
        with refuses("unwritable", kind=LockLost):
            require_held()


def test_a_lock_that_is_a_link_is_never_written_through(tmp_path):
    (tmp_path / "mine").write_text("mine")
    lock_path(tmp_path).symlink_to("mine")
    try_lock(tmp_path)
    assert (tmp_path / "mine").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_full_disk_leaves_no_lock(tmp_path, monkeypatch):
    def full(number, data):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(os, "write", full)
        with refuses("unwritable", "No space left"):
            try_lock(tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert try_lock(tmp_path) == []


@pytest.mark.usefixtures("short_lease")
def test_an_empty_lock_is_refused_with_the_remedy(tmp_path):
    """A process was killed between making it and signing it."""
    lock_path(tmp_path).touch()
    assert holder(tmp_path) is None
    with refuses("empty"):
        try_lock(tmp_path)


def test_a_lock_that_is_just_being_made_is_waited_for(tmp_path):
    """Of two commands that begin at once, one sees the other's lock before it is signed."""
    path = lock_path(tmp_path)
    path.touch()

    def made_and_given_back():
        time.sleep(0.2)
        os.utime(path, ns=(1, 1))
        time.sleep(0.3)
        path.unlink()

    other = threading.Thread(target=made_and_given_back)
    other.start()
    assert try_lock(tmp_path) == []
    other.join()


def test_shards_of_one_division_go_together_and_with_nothing_else(tmp_path):
    with locked(tmp_path, Shard(1, 2), say=print):
        try_lock(tmp_path, Shard(2, 2))
        for other in (Shard(1, 2), Shard(2, 3), None):
            with refuses("in-use"):
                try_lock(tmp_path, other)
    with locked(tmp_path, say=print), refuses("in-use"):
        try_lock(tmp_path, Shard(1, 2))

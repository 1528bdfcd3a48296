"""One writer: whoever comes second is told who is first, and a lock without a holder is none."""

import os
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager

import pytest
from refusals import files_end_at, refuses

from defocus_core.batch.journal.journal import Shard
from defocus_core.batch.journal.runs import holder, lock_path, locked

HOLD = (
    "import sys, time; from pathlib import Path\n"
    "from defocus_core.batch.journal.runs import locked\n"
    "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
)


@contextmanager
def held_elsewhere(out):
    """Another process that holds the lock."""
    words = [sys.executable, "-c", HOLD, str(out)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def try_lock(out, shard=None):
    """Hold the lock for a moment."""
    with locked(out, shard):
        assert holder(lock_path(out, shard)) == f"process {os.getpid()} on {socket.gethostname()}"


def test_a_second_writer_is_told_who_is_first_till_that_is_killed(tmp_path):
    path = lock_path(tmp_path)
    with held_elsewhere(tmp_path) as first:
        name = f"process {first.pid} on {socket.gethostname()}"
        first.send_signal(signal.SIGSTOP)  # it holds it, whatever time it takes
        with refuses("in-use", name):
            try_lock(tmp_path)
        assert holder(path) == name
        first.kill()
        first.wait()
        before = path.read_bytes()
        assert holder(path) is None
        assert path.read_bytes() == before, "to ask is not to take"
        try_lock(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_is_given_back_can_be_taken_and_leaves_no_file(tmp_path):
    for _ in range(2):
        try_lock(tmp_path)
        assert list(tmp_path.iterdir()) == []
    assert holder(lock_path(tmp_path)) is None


def test_a_holder_whose_lock_was_removed_learns_it_and_leaves_another_s(tmp_path):
    with locked(tmp_path) as require_held:
        require_held()
        lock_path(tmp_path).unlink()
        with locked(tmp_path) as held_by_the_other:
            with refuses("unwritable"):
                require_held()
            held_by_the_other()
    assert list(tmp_path.iterdir()) == []


def test_a_lock_that_is_a_link_is_never_written_through(tmp_path):
    (tmp_path / "mine").write_text("mine")
    lock_path(tmp_path).symlink_to("mine")
    with refuses("unwritable"):
        try_lock(tmp_path)
    assert (tmp_path / "mine").read_text() == "mine"


def test_a_file_that_cannot_grow_leaves_no_lock(tmp_path):
    with files_end_at(0), refuses("unwritable", "File too large"):
        try_lock(tmp_path)
    assert list(tmp_path.iterdir()) == []
    try_lock(tmp_path)


@pytest.mark.parametrize("text", [b"", b"filelock/2\npid=1", b"process 1 on \x1b[2J", bytes(999)])
def test_what_stands_in_a_lock_file_is_no_holder(text, tmp_path):
    lock_path(tmp_path).write_bytes(text)
    assert holder(lock_path(tmp_path)) is None
    with locked(tmp_path):
        lock_path(tmp_path).write_bytes(text)
        assert holder(lock_path(tmp_path)) == "another process"


def test_shards_of_one_division_go_together_and_with_nothing_else(tmp_path):
    with locked(tmp_path, Shard(1, 2)):
        try_lock(tmp_path, Shard(2, 2))
        for other in (Shard(1, 2), Shard(2, 3), None):
            with refuses("in-use"):
                try_lock(tmp_path, other)
    with locked(tmp_path), refuses("in-use"):
        try_lock(tmp_path, Shard(1, 2))

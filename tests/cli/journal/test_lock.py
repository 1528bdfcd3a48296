"""One writer: whoever comes second is told who is first, and a lock without a holder is none."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from defocus_cli.journal import lock
from defocus_cli.journal.journal import Shard
from defocus_cli.journal.lock import holder, lock_path, locked
from defocus_cli.system.errors import InputError

HOLD = (
    "import sys, time; from pathlib import Path; from defocus_cli.journal.lock import locked\n"
    "with locked(Path(sys.argv[1]), say=print): print('held', flush=True); time.sleep(60)"
)


@contextmanager
def held_elsewhere(out: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lock."""
    words = [sys.executable, "-c", HOLD, str(out)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def try_lock(out: Path, shard: Shard | None = None) -> list[str]:
    """Hold the lock for a moment; what was said."""
    said: list[str] = []
    with locked(out, shard, say=said.append):
        assert holder(out, shard) is not None
    return said


def leave(out: Path, **told: object) -> Path:
    """A lock file that nobody holds by the system's lock."""
    path = lock_path(out)
    path.write_text(json.dumps({"since": "yesterday", **told}))
    return path


def test_a_second_writer_is_told_who_is_first(tmp_path: Path) -> None:
    with held_elsewhere(tmp_path) as first:
        with pytest.raises(InputError, match=f"process {first.pid} on {socket.gethostname()}"):
            try_lock(tmp_path)
        assert str(first.pid) in str(holder(tmp_path))


def test_what_is_given_back_can_be_taken_and_leaves_no_file(tmp_path: Path) -> None:
    assert try_lock(tmp_path) == try_lock(tmp_path) == []
    assert list(tmp_path.iterdir()) == []
    assert holder(tmp_path) is None


def test_the_lock_of_a_process_that_was_killed_is_taken_over_and_it_is_said(tmp_path: Path) -> None:
    with held_elsewhere(tmp_path) as first:
        first.send_signal(signal.SIGKILL)
        first.wait()
        assert lock_path(tmp_path).exists()
        assert holder(tmp_path) is None
        (said,) = try_lock(tmp_path)
    assert f"left behind by process {first.pid}" in said


def test_where_the_system_cannot_lock_the_process_is_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lock, "_system_lock", lambda number: None)
    host, parent = socket.gethostname(), os.getppid()
    started = lock._started(parent)
    leave(tmp_path, host=host, pid=parent, started=started)
    with pytest.raises(InputError, match=f"process {parent}"):
        try_lock(tmp_path)
    leave(tmp_path, host=host, pid=parent, started="another that had its number")
    assert "taken over" in try_lock(tmp_path)[0]
    with subprocess.Popen(["true"]) as dead:
        dead.wait()
    leave(tmp_path, host=host, pid=dead.pid, started=started)
    assert "taken over" in try_lock(tmp_path)[0]


def test_the_lock_of_another_machine_holds_as_long_as_it_is_touched(tmp_path: Path) -> None:
    path = leave(tmp_path, host="elsewhere", pid=1)
    with pytest.raises(InputError, match="process 1 on elsewhere"):
        try_lock(tmp_path)
    long_ago = path.stat().st_mtime - 2 * lock.STALE
    os.utime(path, (long_ago, long_ago))
    assert "process 1 on elsewhere" in try_lock(tmp_path)[0]
    assert list(tmp_path.iterdir()) == []


def test_a_holder_touches_its_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "BEAT", 0.01)
    with locked(tmp_path, say=print):
        path = lock_path(tmp_path)
        os.utime(path, (0, 0))
        for _ in range(200):
            if path.stat().st_mtime > 0:
                break
            signal.sigtimedwait([], 0.02)
        assert path.stat().st_mtime > 0


def test_shards_of_one_division_go_together_and_with_nothing_else(tmp_path: Path) -> None:
    with locked(tmp_path, Shard(1, 2), say=print):
        try_lock(tmp_path, Shard(2, 2))
        for other in (Shard(1, 2), Shard(2, 3), None):
            with pytest.raises(InputError, match="is being written"):
                try_lock(tmp_path, other)
    with locked(tmp_path, say=print), pytest.raises(InputError, match="is being written"):
        try_lock(tmp_path, Shard(1, 2))

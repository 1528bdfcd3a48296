"""One writer for a journal: a lock file beside it that says who holds it.

The system's own lock on that file decides among processes of one machine, and ends with its holder,
however that ends. Other machines may not see it, so the holder touches the file every now and then:
what one of another machine has not touched for minutes is stale. ``.journal.lock`` is for all of
OUT, ``.journal-2of8.lock`` for a shard of a batch; shards of one division go together, all else
does not.
"""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from defocus_cli.journal.journal import Shard
from defocus_cli.system.errors import InputError
from defocus_cli.system.safe_files import is_at, unwritable

BEAT = 20.0  # seconds between two touches
STALE = 300.0  # seconds without a touch
PATIENCE = 10  # further attempts
Say = Callable[[str], object]


def lock_path(out: Path, shard: Shard | None = None) -> Path:
    """The lock file of OUT, or of a shard."""
    return out / (f".journal-{shard.number}of{shard.of}.lock" if shard else ".journal.lock")


@contextmanager
def locked(out: Path, shard: Shard | None = None, *, say: Say) -> Iterator[None]:
    """Hold the lock of an existing OUT, or of a shard, while the block runs.

    Args:
        out: the directory.
        shard: which part of a batch; None for all of it.
        say: called with a line about a stale lock.

    Raises:
        InputError: someone else holds it, or one that excludes it; or it cannot be written.
    """
    path = lock_path(out, shard)
    number = _acquired(path, say)
    ended = threading.Event()
    threading.Thread(target=_beat, args=(path, ended), daemon=True).start()
    try:
        _refuse_others(out, path, shard)
        yield
    finally:
        ended.set()
        with suppress(OSError):
            if is_at(path, number):  # else it is another's: OUT was removed, and made anew
                path.unlink()
        os.close(number)


def refuse_held(out: Path) -> None:
    """Refuse an OUT that somebody writes to, before anything is said about what is in it.

    Raises:
        InputError: someone holds a lock.
    """
    _refuse_others(out, None, None)


def holder(out: Path, shard: Shard | None = None) -> str | None:
    """Who holds a lock, in words; None if nobody does."""
    return _holder(lock_path(out, shard))


def _refuse_others(out: Path, own: Path | None, shard: Shard | None) -> None:
    for other in sorted(out.glob(".journal*.lock")):
        who = None if other == own or _of_same_division(other, shard) else _holder(other)
        if who is not None:
            raise _held(other, who)


def _holder(path: Path) -> str | None:
    try:
        number = os.open(path, os.O_RDWR)
    except OSError:
        return None
    try:
        free, told = _try(path, number)
        return None if free else _words(told)
    finally:
        os.close(number)


def _acquired(path: Path, say: Say) -> int:
    """The open lock file, locked and ours."""
    for patience in range(PATIENCE, -1, -1):
        try:
            number = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise unwritable(path, error) from error
        free, told = _try(path, number)
        if free and is_at(path, number):
            if told:
                say(f"{path}: left behind by {_words(told)}, which runs no more; taken over")
            return _signed(path, number)
        os.close(number)
        if not free and not patience:
            raise _held(path, _words(told))
        time.sleep(0.05)  # someone may just be looking who holds it, or be giving it back
    raise _held(path, "several processes that start and stop")


def _signed(path: Path, number: int) -> int:
    text = json.dumps({**_self(), "since": _now()}).encode()
    try:
        os.ftruncate(number, 0)
        os.pwrite(number, text, 0)
    except OSError as error:
        os.close(number)
        raise unwritable(path, error) from error
    return number


def _held(path: Path, who: str) -> InputError:
    problem = f"{path.parent} is being written by {who}"
    return InputError(path, problem, "wait for it, stop it, or choose another -o")


def _try(path: Path, number: int) -> tuple[bool, dict[str, Any]]:
    """Whether nobody holds an open lock file, and who held it last.

    If nobody does we do from here on, where the system can lock files.
    """
    seen = _system_lock(number)
    told = _read(number)
    if seen is False:
        return False, told
    if not told:
        return True, told
    if told.get("host") == socket.gethostname() and (seen or os.name == "posix"):
        return bool(seen) or not _runs(told), told
    try:
        return _age(path) > STALE, told
    except FileNotFoundError:
        return True, told


def _system_lock(number: int) -> bool | None:
    """Whether the system gave us its lock on a file; None if it has none to give."""
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return None
    return True


def _runs(told: Mapping[str, Any]) -> bool:
    """Whether the process that a lock names still runs, and is not another of its number."""
    if told.get("pid") is None:
        return False
    try:
        os.kill(int(told["pid"]), 0)
    except PermissionError:
        pass
    except OSError:
        return False
    return _started(int(told["pid"])) in (None, told.get("started"))


def _started(pid: int) -> str | None:
    """When a process of this machine started, in the words of the system; None if untold."""
    with suppress(OSError, IndexError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[19]}"
    return None


def _age(path: Path) -> float:
    """Seconds since a lock was touched, by the clock of its file system."""
    probe = path.with_name(f"{path.name}.{socket.gethostname()}.{os.getpid()}.tmp")
    probe.touch()
    try:
        return probe.stat().st_mtime - path.stat().st_mtime
    finally:
        probe.unlink()


def _beat(path: Path, ended: threading.Event) -> None:
    while not ended.wait(BEAT):
        with suppress(OSError):
            os.utime(path)


def _self() -> dict[str, Any]:
    pid = os.getpid()
    return {"host": socket.gethostname(), "pid": pid, "started": _started(pid)}


def _read(number: int) -> dict[str, Any]:
    with suppress(ValueError):
        told = json.loads(os.pread(number, 2**16, 0))
        if isinstance(told, dict):
            return told
    return {}


def _words(told: Mapping[str, Any]) -> str:
    if not told:
        return "a process that has just started"
    return f"process {told.get('pid')} on {told.get('host')}, since {told.get('since')}"


def _of_same_division(path: Path, shard: Shard | None) -> bool:
    return shard is not None and path.name.endswith(f"of{shard.of}.lock")


def _now() -> str:
    return datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="seconds")

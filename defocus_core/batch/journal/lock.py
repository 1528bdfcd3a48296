"""The lock of a journal: one writer at a time, named in a file beside it.

The system holds the lock on the file, and lets go of it when the process ends, however that ends.
``.journal.lock`` is for all of OUT, ``.journal-2of8.lock`` for a shard of a batch. Shards of one
division run side by side; nothing else does.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from defocus_core.batch.journal.journal import Shard
from defocus_core.errors import InputError
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import is_at, unwritable
from defocus_core.system.text import note

PATIENCE = 0.2  # seconds in which a holder may be gone that only looked whether there is one
_HOLDER = re.compile(r"process \d{1,10} on [\w.-]{1,100}")
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)  # of file systems without
Check = Callable[[], None]


def lock_path(out: Path, shard: Shard | None = None) -> Path:
    """The lock file of OUT, or of a shard."""
    return out / (f".journal-{shard.number}of{shard.of}.lock" if shard else ".journal.lock")


@contextmanager
def locked(out: Path, shard: Shard | None = None) -> Iterator[Check]:
    """Hold the lock of an existing OUT, or of a shard, while the block runs.

    `shard`: which part of a batch; None for all of it.
    """
    path = lock_path(out, shard)

    def require_held() -> None:
        if not is_at(path, number):
            problem, remedy = "was removed while jobs were done", "run the same command again"
            raise InputError("unwritable", problem, remedy, path=path)

    with _held(path) as number:
        for other in sorted(out.glob(".journal*.lock")):  # those of killed ones go
            of_same_division = shard is not None and other.name.endswith(f"of{shard.of}.lock")
            if other != path and not of_same_division:
                with _held(other):
                    pass
        yield require_held


def holder(path: Path) -> str | None:
    """Who holds the lock of a file, in words; None if nobody does."""
    with suppress(OSError), Folder(path.parent).open(path.name) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            words = file.read(200).decode(errors="replace")
            return words if _HOLDER.fullmatch(words) else "another process"
    return None


@contextmanager
def _held(path: Path) -> Iterator[int]:
    """Hold a lock, whose file is gone after the block; an error names who else holds it."""
    end = time.monotonic() + PATIENCE
    try:
        while (number := _taken(path)) is None:
            if time.monotonic() > end:
                problem = f"{path.parent} is being written by {holder(path) or 'another process'}"
                remedy = "wait for it, stop it, or choose another -o"
                raise InputError("in-use", problem, remedy, path=path)
            time.sleep(0.02)
    except OSError as error:
        raise unwritable(path, error) from error
    try:
        try:
            os.ftruncate(number, 0)
            os.write(number, f"process {os.getpid()} on {socket.gethostname()}".encode())
        except OSError as error:
            raise unwritable(path, error) from error
        yield number
    finally:
        with suppress(OSError):  # OUT may be gone, and the lock another's
            if is_at(path, number):
                path.unlink()
        os.close(number)


def _taken(path: Path) -> int | None:
    """The open file of a lock that is taken; None if another holds it."""
    number = Folder(path.parent).append(path.name)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            os.close(number)
            if isinstance(error, BlockingIOError):
                return None
            raise
        note(f"{path.parent}: warning: its file system has no locks; let no other run write there")
    if is_at(path, number):
        return number
    os.close(number)  # its holder has just removed it
    return None

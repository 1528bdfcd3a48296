"""The lock of a journal: one writer at a time, named in a file beside it.

The lock is a lease of `filelock`. Its holder touches the file every second. A holder on this
machine that runs no more loses the lock at once; any other loses it when it has not touched the
file for a minute, by the clock of the process that waits. ``.journal.lock`` is for all of OUT,
``.journal-2of8.lock`` for a shard of a batch. Shards of one division run side by side; nothing else
does.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from defocus_core.batch.journal.journal import Shard
from defocus_core.errors import InputError
from defocus_core.io.safe_files import unwritable

if TYPE_CHECKING:
    from filelock import SoftFileLease  # its import takes 25 ms

BEAT = 1.0  # seconds between two touches
LEASE = 60.0  # seconds without a touch, after which another may take the lock
GLANCE = 3.0  # seconds to wait for a touch before a line reports that there is none
Say = Callable[[str], object]
Check = Callable[[], None]


class LockLost(InputError):  # noqa: N818 - no mistake
    """Another process has taken the lock while this one did not run."""


def lock_path(out: Path, shard: Shard | None = None) -> Path:
    """The lock file of OUT, or of a shard."""
    return out / (f".journal-{shard.number}of{shard.of}.lock" if shard else ".journal.lock")


@contextmanager
def locked(out: Path, shard: Shard | None = None, *, say: Say) -> Iterator[Check]:
    """Hold the lock of an existing OUT, or of a shard, while the block runs.

    `shard`: which part of a batch; None for all of it.
    """
    path = lock_path(out, shard)
    lease = _acquired(path, say)

    def require_held() -> None:
        owner = lease.owner
        if owner is None or owner.token != lease.token:
            name = _holder(lease)
            problem = f"was taken over by {name}" if name else "was removed while jobs were done"
            raise LockLost(
                "unwritable", problem, "run the same command again, to go on or anew", path=path
            )

    try:
        _refuse_others(out, path, shard, say)
        yield require_held
    finally:
        with suppress(OSError):  # OUT may be gone
            lease.release()


def refuse_held(out: Path, *, say: Say) -> None:
    """Refuse an OUT that somebody writes to, before its records are read."""
    _refuse_others(out, None, None, say)


def holder(out: Path, shard: Shard | None = None) -> str | None:
    """Who holds a lock, in words; None if nobody does."""
    from filelock import LeaseSettingsMismatch

    path = lock_path(out, shard)
    name = _holder(_lease(path))
    if name is None:
        return None
    # To take the lock itself, if only for a moment, would refuse a batch that starts just then.
    with TemporaryDirectory() as folder:
        try:
            copy = _lease(Path(shutil.copy(path, folder)))
        except FileNotFoundError:  # given back by now
            return None
        try:
            copy.acquire(blocking=False)  # which succeeds if the holder runs no more
        except (OSError, LeaseSettingsMismatch):
            return name
        copy.release()
    return None


def _refuse_others(out: Path, own: Path | None, shard: Shard | None, say: Say) -> None:
    for other in sorted(out.glob(".journal*.lock")):
        of_same_division = shard is not None and other.name.endswith(f"of{shard.of}.lock")
        if other != own and not of_same_division:
            _acquired(other, say).release()


def _lease(path: Path) -> SoftFileLease:
    from filelock import SoftFileLease

    # Any thread may ask whether the lock is still held.
    return SoftFileLease(path, lease_duration=LEASE, heartbeat_interval=BEAT, thread_local=False)


def _acquired(path: Path, say: Say) -> SoftFileLease:
    """The lock, held; or an error that names its holder as soon as the holder touches it."""
    from filelock import LeaseSettingsMismatch, Timeout

    lease, touched = _lease(path), _touched(path)
    before = _holder(lease)

    def is_touched() -> bool:  # a lock that is just being made names its holder a moment later
        return _touched(path) not in (None, touched) and _holder(lease) is not None

    try:
        try:
            lease.acquire(timeout=GLANCE, poll_interval=0.05, cancel_check=is_touched)
        except Timeout:
            name = _holder(lease)
            if name is None or is_touched():
                raise
            say(f"{path}: {name} has not touched it for {GLANCE:g} s; waiting {LEASE:g} s in all")
            lease.acquire(timeout=LEASE + GLANCE, poll_interval=0.05, cancel_check=is_touched)
    except (LeaseSettingsMismatch, Timeout) as error:
        raise _held(path, _holder(lease)) from error
    except OSError as error:
        raise unwritable(path, error) from error
    if before:
        say(f"{path}: left behind by {before}, which runs no more; taken over")
    return lease


def _held(path: Path, name: str | None) -> InputError:
    if name is None:
        return InputError(
            "empty", "names no holder", "if nobody writes to that directory, remove it", path=path
        )
    problem = f"{path.parent} is being written by {name}"
    return InputError("in-use", problem, "wait for it, stop it, or choose another -o", path=path)


def _holder(lease: SoftFileLease) -> str | None:
    owner = lease.owner
    return owner and f"process {owner.pid} on {owner.hostname.partition('?')[0]}"


def _touched(path: Path) -> tuple[int, int] | None:
    """When a lock was touched, and which file it is; None if there is none."""
    with suppress(OSError):
        status = os.lstat(path)
        return status.st_mtime_ns, status.st_ino
    return None

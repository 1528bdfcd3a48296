"""Runs of a batch: their lock files, their notes of unfinished jobs, and files of killed runs.

``.journal.lock`` locks the whole output folder OUT, ``.journal-2of8.lock`` a shard of the batch.
The system releases a lock when its process ends, in whatever way. Shards may only run at the same
time if the batch is divided into the same number of them. Until a run has done all its jobs, their
names are noted in ``OUT/.journal.run``.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import socket
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from hashlib import blake2b
from pathlib import Path

from msgspec import Struct
from msgspec.json import decode, encode

from defocus_core.batch.journal.journal import NO_JSON, JournalFile, Shard, journal_path, shards
from defocus_core.errors import InputError, cannot_read
from defocus_core.io.write_files import (
    LEFTOVER,
    Folder,
    is_at,
    left_in,
    sync_folder,
    unwritable,
    written_whole,
)
from defocus_core.request.output_kinds import KINDS
from defocus_core.system.text import note

PATIENCE = 0.2  # seconds to wait for a holder that only tests the lock
_HOLDER = re.compile(r"process \d{1,10} on [\w.-]{1,100}")
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)  # errors of file systems without locks
Check = Callable[[], None]
INDEX, SHARDS_FOLDER = "metadata.jsonl", "shards"  # index of a data set, folder of its tars


def lock_path(out: Path, shard: Shard | None = None) -> Path:
    """The path of the lock file of `out`, or of a shard."""
    return out / (f".journal-{shard.number}of{shard.of}.lock" if shard else ".journal.lock")


@contextmanager
def locked(out: Path, shard: Shard | None = None) -> Iterator[Check]:
    """Hold the lock of `out`, or of a shard, during the block.

    Yields a function that raises InputError if the lock file was removed.
    """
    path = lock_path(out, shard)

    def require_held() -> None:
        if not is_at(path, number):
            problem, remedy = "was removed while jobs were done", "run the same command again"
            raise InputError("unwritable", problem, remedy, path=path)

    with _held(path) as number:
        for other in {*out.glob(".journal*.lock")} - {path}:  # remove those of killed runs
            if shard is None or not other.name.endswith(f"of{shard.of}.lock"):
                with _held(other):
                    pass
        yield require_held


def holder(path: Path) -> str | None:
    """The process that holds a lock file, like "process 7 on host"; None if it is not locked."""
    with suppress(OSError), Folder(path.parent).open(path.name) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            words = file.read(200).decode(errors="replace")
            return words if _HOLDER.fullmatch(words) else "another process"
    return None


def own_words() -> str:
    """The text by which this process is named in its lock files."""
    return f"process {os.getpid()} on {socket.gethostname()}"


def is_held_by(out: Path, words: str) -> bool:
    """Whether a lock file in `out` has the text `words`, the `own_words` of another process."""
    with suppress(OSError):
        for path in out.glob(".journal*.lock"):
            with suppress(FileNotFoundError):  # of another shard, which ended
                if path.read_text(errors="replace") == words:
                    return True
    return False


@contextmanager
def _held(path: Path) -> Iterator[int]:
    """Lock a file during the block and yield its descriptor; fails if another process holds it."""
    end = time.monotonic() + PATIENCE
    try:
        while (number := _try_lock(path)) is None:
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
            os.write(number, own_words().encode())
            os.fdatasync(number)  # workers on other machines look for it
        except OSError as error:
            raise unwritable(path, error) from error
        yield number
    finally:
        with suppress(OSError):  # OUT may be gone, and the lock another's
            if is_at(path, number):
                path.unlink()
        os.close(number)


def _try_lock(path: Path) -> int | None:
    """Lock a file; returns its file descriptor, or None if another process holds the lock."""
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


class OpenRun(Struct):
    """The note of an unfinished run: the number of older records of each sample to be done."""

    jobs: dict[str, int]


def run_path(out: Path, shard: Shard | None = None) -> Path:
    """The path of the note of a run on `out`, or on a shard."""
    return out / (f".journal-{shard.number}of{shard.of}.run" if shard else ".journal.run")


def note_run(out: Path, shard: Shard | None, jobs: dict[str, int]) -> Path:
    """Write the note of a run, with the number of older records of each sample; returns its path.

    A run on the whole of `out` replaces the notes of shards.
    """
    path = run_path(out, shard)
    with written_whole(path) as file:
        file.write(encode(OpenRun(jobs)) + b"\n")
    for other in out.glob(".journal-*.run") if shard is None else ():
        other.unlink(missing_ok=True)
    return path


def open_run(out: Path, shard: Shard | None = None) -> dict[str, int]:
    """The samples that an unfinished run noted, with their numbers of older records; else empty."""
    path = run_path(out, shard)
    try:
        text = Folder(path.parent).read(path.name)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise cannot_read(path, error, "remove it") from None
    with suppress(*NO_JSON):
        return decode(text, type=OpenRun).jobs
    remedy = "remove the file, and what the run left half-written; the next run begins anew"
    raise InputError("malformed", "is not the note of a run", remedy, path=path)


def begun_samples(out: Path, shard: Shard | None) -> set[str]:
    """The samples that interrupted runs noted; they may have files but no record."""
    parts = (None, *(shards(out) if shard is None else [shard]))
    return {name for part in parts for name in open_run(out, part)}


def sweep_up(out: Path, labels: Iterable[str] = ()) -> None:
    """Remove temporary files of killed processes; `labels` are further folders to search.

    The caller must hold the lock of `out`.
    """
    below = Folder(out)
    # Those of the index and shards, written without the lock, stay while their process lives.
    found = [(folder, left_in(out / folder)) for folder in ("", SHARDS_FOLDER)]
    for folder in (*KINDS, *labels):
        with suppress(OSError):
            found.append((folder, filter(LEFTOVER.fullmatch, below.names(folder))))
    for folder, names in found:
        for name in names:
            with suppress(OSError):
                below.remove(f"{folder}/{name}" if folder else name)


def refuse_other_division(out: Path, own: Shard) -> None:
    """Raise InputError if `out` has journals of a batch divided into another number of shards.

    It would be unknown which of their records are newer.
    """
    for shard in shards(out):
        if shard.of != own.of and journal_path(out, shard).exists():
            problem = f"belongs to another number of shards than {own.number}/{own.of}"
            remedy = f"run 'defocus merge {out}' first"
            raise InputError("contradiction", problem, remedy, path=journal_path(out, shard))


def gather(out: Path) -> list[Shard]:
    """Merge the journals of all shards into that of `out`; returns these shards.

    The caller must hold the lock of `out`.
    """
    parts = [shard for shard in shards(out) if journal_path(out, shard).exists()]
    if parts:
        with written_whole(journal_path(out)) as file:
            file.writelines(_merged_lines([None, *parts], out))
        sync_folder(out)  # before the journals of the shards are removed
    for shard in parts:
        journal_path(out, shard).unlink()
    return parts


def _merged_lines(parts: Sequence[Shard | None], out: Path) -> Iterator[bytes]:
    """Yield the lines of several journals, without duplicates."""
    known = set[bytes]()
    for part in parts:
        for _, _, line in JournalFile(journal_path(out, part)).lines():
            text = line.rstrip(b"\n") + b"\n"
            digest = blake2b(text, digest_size=16).digest()
            if digest not in known:
                known.add(digest)
                yield text

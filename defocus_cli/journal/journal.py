"""The journal of OUT: a durable JSON line for each job that ended.

``OUT/journal.jsonl`` holds what a single process wrote, ``OUT/journal-2of8.jsonl`` what that shard
of a batch did. Each record starts with its newline, so that a torn one cannot spoil the next; a
torn tail is ignored, and cut off by who appends next. Where records speak of the same file, the
last holds.

A record has
    sample_id   name of the sample, the stem of its files
    job, recipe its identity, see `defocus_cli.journal.identity`
    status      ok, failed or rejected
    reason      a code of `defocus_cli.journal.reasons`, null if ok; ``message`` says it to people
    settings    what was asked for: lens, reading, outputs, quality
    inputs      role to path (relative to OUT, or absolute as given), size, mtime_ns, blake2b
    outputs     kind, or kind.preview, to path relative to OUT; if ok, size, mtime_ns, blake2b, too
    lens        what it turned out to be, as `report.lens_record`; with size, coc_px, color_note,
                depth_note, device and warnings, null if not ok
    quality, version (of the package), renderer (its version)
    seconds     of reading, rendering and writing; cpu, of rendering
    finished    when, UTC
"""

from __future__ import annotations

import gc
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from defocus_cli.journal.reasons import STATUSES
from defocus_cli.system.errors import InputError, reason
from defocus_cli.system.safe_files import is_at, sync_folder, unwritable

Record = Mapping[str, Any]
_BLOCK = 1000  # lines
_SAMPLE = re.compile(rb'"sample_id": ("(?:[^"\\]|\\.)+")')
_SHARD = re.compile(r"\.?journal-(\d+)of(\d+)\.(jsonl|run|lock)")


class Shard(NamedTuple):
    """The part of a batch that one process does: ``number`` of ``of``, from 1."""

    number: int
    of: int


def journal_path(out: Path, shard: Shard | None = None) -> Path:
    """The journal of OUT, or of a shard."""
    return out / (f"journal-{shard.number}of{shard.of}.jsonl" if shard else "journal.jsonl")


def shards(out: Path) -> list[Shard]:
    """The shards that have begun in OUT."""
    found = (_SHARD.fullmatch(path.name) for path in out.glob("*journal-*of*.*"))
    return sorted({Shard(int(name[1]), int(name[2])) for name in found if name})


def require_journal(out: Path) -> None:
    """Refuse a directory that no batch has written to.

    Raises:
        InputError: there is no journal.
    """
    if not any(out.glob("journal*.jsonl")):
        raise InputError(out, "has no journal", "name the directory that a batch writes to")


def read_all(out: Path) -> list[Record]:
    """The records of all journals in OUT, in the order in which the jobs came to an end.

    Raises:
        InputError: a journal cannot be read, or a line of it is broken.
    """
    paths = [journal_path(out), *(journal_path(out, shard) for shard in shards(out))]
    return in_order([read(path) for path in paths])


def in_order(journals: Sequence[Sequence[Record]]) -> list[Record]:
    """The records of several journals in the order in which the jobs came to an end."""
    records = [record for journal in journals for record in journal]
    if sum(map(bool, journals)) > 1:
        records.sort(key=lambda record: str(record.get("finished")))
    return records


def read(path: Path) -> list[Record]:
    """The records of a journal, none if it is missing.

    Raises:
        InputError: it cannot be read, or a line is broken that is not the last.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return []
    except OSError as error:
        remedy = "check its permissions"
        raise InputError(path, f"cannot be read: {reason(error)}", remedy) from error
    lines = data.split(b"\n")
    records: list[Record] = []
    with without_collections():
        for start in range(0, len(lines), _BLOCK):
            block = lines[start : start + _BLOCK]
            together = _together(block)
            if together is None:
                together = list(_one_by_one(path, block, start, last=len(lines)))
            records += together
    return records


def _together(lines: Sequence[bytes]) -> list[Record] | None:
    """The records of lines that are all whole, keys shared; None if one is not."""
    with suppress(ValueError, RecursionError):
        found = json.loads(b"[" + b",".join(filter(None, lines)) + b"]")
        if all(map(_is_record, found)):
            return list(found)
    return None


def _one_by_one(path: Path, lines: Sequence[bytes], start: int, *, last: int) -> Iterator[Record]:
    for number, line in enumerate(lines, start + 1):
        record = _parsed(line) if line else None
        if record is not None:
            yield record
        elif line and number < last:
            remedy = "remove that line and the outputs of its job, which is done again"
            raise InputError(path, f"line {number}{_of_sample(line)} is broken", remedy)


def _of_sample(line: bytes) -> str:
    """Which sample a broken line speaks of, as far as it can be read."""
    found = _SAMPLE.search(line)
    with suppress(ValueError):
        return f", of {json.loads(found[1])}," if found else ""
    return ""


@contextmanager
def without_collections() -> Iterator[None]:
    """Nothing in the block makes cycles; looking for them takes most of its time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _parsed(line: bytes) -> Record | None:
    with suppress(ValueError, RecursionError):
        record = json.loads(line)
        if _is_record(record):
            return dict(record)
    return None


def _is_record(value: object) -> bool:
    return isinstance(value, dict) and value.get("status") in STATUSES and "outputs" in value


def told_path(path: Path, out: Path) -> str:
    """The path of an input as a journal has it: as given if absolute, else relative to OUT."""
    if path.is_absolute():
        return str(path)
    return (_told_folder(path.parent, out, Path.cwd()) / path.name).as_posix()


@lru_cache(maxsize=1024)
def _told_folder(folder: Path, out: Path, here: Path) -> Path:
    """A folder, relative to OUT, as both are seen from ``here``."""
    # What is above a linked folder is what is above that which the link leads to.
    ups = max((place for place, part in enumerate(folder.parts, 1) if part == ".."), default=0)
    start = here.joinpath(*folder.parts[:ups]).resolve()
    return Path(os.path.relpath(start.joinpath(*folder.parts[ups:]), (here / out).resolve()))


class Journal:
    """A journal that records are appended to. Its one writer holds the lock of OUT.

    Raises:
        InputError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.count = 0
        self._new = not path.exists()
        try:
            self._number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
            self._cut_torn_tail()
        except OSError as error:
            raise unwritable(path, error) from error

    def append(self, record: Record) -> None:
        """Add a record; when this returns, no crash loses it.

        Raises:
            InputError: it cannot be written; nothing of it is. Or the journal is no longer there.
        """
        line = b"\n" + json.dumps(record, allow_nan=False).encode()
        end = os.fstat(self._number).st_size
        try:
            if os.write(self._number, line) < len(line):  # the disk took a part
                os.write(self._number, line[os.fstat(self._number).st_size - end :])
            os.fdatasync(self._number)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._number, end)
            raise unwritable(self.path, error) from error
        self._require_in_place()
        if self._new:
            sync_folder(self.path.parent)
            self._new = False
        self.count += 1

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                self._require_in_place()
        finally:
            os.close(self._number)
        if self._new:  # nothing to tell leaves no file behind
            with suppress(OSError):
                self.path.unlink()

    def _require_in_place(self) -> None:
        """Refuse to go on where nobody will find what is written."""
        if not is_at(self.path, self._number):
            problem = "was removed or replaced while jobs were done"
            raise InputError(self.path, problem, "run the same command again, to go on or anew")

    def _cut_torn_tail(self) -> None:
        """Remove a record that was being written when its writer died."""
        size = os.fstat(self._number).st_size
        tail, start = b"", size
        while start and b"\n" not in tail:
            step = min(2**16, start)
            start -= step
            tail = os.pread(self._number, step, start) + tail
        last = tail.rpartition(b"\n")[2]
        if last and _parsed(last) is None:
            torn = size - len(last)
            os.ftruncate(self._number, max(torn - 1, 0))


def merged(records: Sequence[Record]) -> bytes:
    """A journal of these records, each of them once."""
    lines = dict.fromkeys(json.dumps(record, allow_nan=False) for record in records)
    return "".join(f"\n{line}" for line in lines).encode()

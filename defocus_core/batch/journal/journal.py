"""The journal of a batch: a file to which a record, a line of JSON, is appended when a job ends.

``OUT/journal.jsonl`` has the records of runs of the whole batch, ``OUT/journal-2of8.jsonl`` later
ones of a shard, a part of the batch. If the last line is incomplete, its writer was killed: the
line is ignored, and cut off before another one is appended. If several records name the same file,
the last one is valid.

The module `record` defines the fields of a line. A `Ledger` reads all lines once, and keeps their
offsets to read records again.
"""

from __future__ import annotations

import os
import re
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO, NamedTuple
from weakref import finalize

from msgspec import DecodeError, ValidationError
from msgspec.json import decode

from defocus_core.batch.journal.record import Record, line_of, linked_folders, record_of
from defocus_core.errors import InputError, cannot_read, one_line
from defocus_core.io.write_files import Folder, is_at, sync_folder, unwritable
from defocus_core.request.output_kinds import PREVIEW
from defocus_core.system.memory import without_collections

_SAMPLE = re.compile(rb'"sample_id": ?("(?:[^"\\]|\\.)+")')
MAX_SHARDS = 999_999  # greatest number of shards
_SHARD = re.compile(r"\.?journal-(\d+)of(\d+)\.(jsonl|run|lock)")
_PREVIEW = f"{PREVIEW}.png"  # ending of the names of previews
NO_JSON = (DecodeError, UnicodeDecodeError, RecursionError)


class Shard(NamedTuple):
    """The part of a batch that one run does: ``number``, counted from 1, out of ``of``."""

    number: int
    of: int


def journal_path(out: Path, shard: Shard | None = None) -> Path:
    """The path of the journal of the whole batch, or of a shard."""
    return out / (f"journal-{shard.number}of{shard.of}.jsonl" if shard else "journal.jsonl")


def shards(out: Path) -> list[Shard]:
    """The shards that have a journal, a note of a run or a lock in `out`, sorted."""
    names = (_SHARD.fullmatch(path.name) for path in out.glob("*journal-*of*.*"))
    found = {Shard(int(name[1]), int(name[2])) for name in names if name}
    return sorted(shard for shard in found if 1 <= shard.number <= shard.of <= MAX_SHARDS)


def require_journal(out: Path, pattern: str = "journal*.jsonl") -> None:
    """Raise InputError if `out` has no file that matches `pattern`, and so no batch."""
    if not any(out.glob(pattern)):
        remedy = "name the directory that a batch writes to"
        raise InputError("empty", "has no journal", remedy, path=out)


class JournalFile:
    """A journal to read, line by line or at an offset. A missing file is like an empty one."""

    def __init__(self, path: Path) -> None:
        self.path, self.end = path, 0  # end: bytes that were read
        self._file: BinaryIO | None = None
        try:
            self._file = Folder(path.parent).open(path.name)
            finalize(self, self._file.close)
        except FileNotFoundError:
            pass  # it is empty
        except OSError as error:
            raise cannot_read(path, error, "check its permissions, or copy it again") from error

    def lines(self) -> Iterator[tuple[int, Record, bytes]]:
        """Yield offset in bytes, record and text of each line, except an incomplete last one."""
        linked, lines = linked_folders(self.path.parent), enumerate(self._file or (), 1)
        for number, text in lines:
            begin = self.end
            if text == b"\n":
                self.end += 1
                continue
            try:
                record = record_of(text, linked)
            except ValidationError as error:
                fault = f"is no record: {one_line(error)}"
            except NO_JSON:
                if all(rest == b"\n" for _, rest in lines):
                    return
                fault = "is broken"
            else:
                self.end += len(text)
                yield begin, record, text
                continue
            named = ""  # as far as its name can be read
            with suppress(ValueError, TypeError):
                named = f", of {decode(_SAMPLE.search(text)[1])},"  # type: ignore[index]
            remedy = "remove that line and the outputs of its job, which is done again"
            raise InputError("damaged", f"line {number}{named} {fault}", remedy, path=self.path)

    def record(self, begin: int) -> Record:
        """Read again the record at an offset in bytes, as given by `lines`."""
        assert self._file is not None
        self._file.seek(begin)
        return record_of(self._file.readline())


class Ledger:
    """All records in the journals of an output folder, numbered from 0, oldest first.

    A record names all files that its job writes. If several name the same file, the last is valid.
    A record of an ok job is superseded when later records name all of its files except previews;
    that of a failed job, when a later one names any of its files. About 300 bytes per record are
    kept in memory; the rest is read again when needed.
    """

    def __init__(self, out: Path, *, is_empty: bool = False) -> None:
        """Read the journal in `out`, then those of shards; nothing if `is_empty`."""
        self.out = out
        self.splits: dict[str, tuple[str, ...]] = {}  # splits recorded for pictures, by stem
        self.last: dict[str, int] = {}  # number of the valid record by file, relative to OUT
        self.outcomes: list[Outcome] = []  # by number
        self._once: set[str] = set()  # files of an ok record, of which the last one failed
        # of each record: sample, offset, journal, number of files
        self._samples: list[str] = []
        self._begins, self._of, self._files = array("Q"), array("L"), array("H")
        parts = [] if is_empty else [None, *shards(out)]
        self._journals = [JournalFile(journal_path(out, part)) for part in parts]
        outcomes: dict[Outcome, Outcome] = {}
        with without_collections():
            for place, reader in enumerate(self._journals):
                for begin, record, _ in reader.lines():
                    found = Outcome(record.status, record.end.reason, record.end.back)
                    self.outcomes.append(outcomes.setdefault(found, found))
                    self._begins.append(begin)
                    self._of.append(place)
                    self._add(record)

    def _add(self, record: Record) -> None:
        number, is_ok = len(self._files), record.status == "ok"
        paths = [stamp.path for stamp in record.outputs.values()]
        for path in paths:
            if is_ok:
                self._once.discard(path)
            elif self.is_known(path):
                self._once.add(path)
            self.last[path] = number
        self._files.append(len(paths))
        self._samples.append(record.sample_id)
        if record.split:
            stem = record.settings.get("stem", "")
            if record.split not in self.splits.setdefault(stem, ()):
                self.splits[stem] += (record.split,)

    def end_of(self, path: Path) -> int:
        """The offset in bytes of the end of the last record in a journal file; 0 if it has none."""
        return next((reader.end for reader in self._journals if reader.path == path), 0)

    def counts(self) -> Counter[str]:
        """The number of records of each sample."""
        return Counter(self._samples)

    def is_ok(self, number: int | None) -> bool:
        """Whether a record is that of an ok job; False for None."""
        return number is not None and self.outcomes[number].status == "ok"

    def is_known(self, path: str) -> bool:
        """Whether an ok job has written a file; `path` is relative to the output folder."""
        return path in self._once or self.is_ok(self.last.get(path))

    def number_of(self, paths: Iterable[str]) -> int | None:
        """The number of the record that is valid for all of these files; None if there is none."""
        number, *others = {self.last.get(path) for path in paths}
        return None if others else number

    def record(self, number: int) -> Record:
        """Read a record by its number."""
        return self._journals[self._of[number]].record(self._begins[number])

    def live(self) -> Iterator[int]:
        """The numbers of the records that are not superseded, in ascending order."""
        own = Counter(self.last.values())
        shown = {n for path, n in self.last.items() if not path.endswith(_PREVIEW)}
        for number, files in enumerate(self._files):
            if 0 < own[number] == files or (number in shown and self.is_ok(number)):
                yield number

    def records(self, only: Collection[str] | None = None) -> Iterator[Record]:
        """Yield the records that are not superseded, sorted by sample, oldest first for each.

        Outputs replaced by a later record are left out. `only`: names of samples, or None for all.
        """
        wanted = (n for n in self.live() if only is None or self._samples[n] in only)
        for number in sorted(wanted, key=self._samples.__getitem__):
            record = self.record(number)
            own = {k: s for k, s in record.outputs.items() if self.last[s.path] == number}
            yield record if len(own) == len(record.outputs) else record.with_files(outputs=own)


class Outcome(NamedTuple):
    """How a job ended: status, then reason if it failed, or the back that rendered if it is ok."""

    status: str
    reason: str | None
    back: str  # empty without a picture


def input_path(path: Path, out: Path) -> str:
    """The path of an input as written to a journal: relative to `out`, unless given as absolute."""
    text = str(path)
    if path.is_absolute():
        return text
    folder, _, name = text.rpartition("/")
    return _input_folder(folder, out, os.getcwd()) + name  # noqa: PTH109 - it is asked of each job


@lru_cache(maxsize=1024)
def _input_folder(folder: str, out: Path, base: str) -> str:
    """A folder relative to `out`, with a trailing slash; both are given relative to ``base``."""
    there, here = (os.path.realpath(os.path.join(base, path)) for path in (folder, out))  # noqa: PTH118
    return "" if there == here else f"{os.path.relpath(there, here)}/"


class Journal:
    """A journal to append records to. Only the process that holds the lock of OUT may do so."""

    def __init__(self, path: Path, end: int, began: Callable[[], bool] = lambda: False) -> None:
        """Open the journal for appending.

        Args:
            path: The journal file; it need not exist.
            end: End of the last complete record in bytes. What follows it is cut off.
            began: Tells on closing whether outputs exist. If no record was appended to a new
                journal and it returns False, the file is removed.
        """
        self.path, self._new, self._began = path, end == 0, began
        try:
            self._number = Folder(path.parent).append(path.name)
            os.ftruncate(self._number, min(end, os.fstat(self._number).st_size))
            if end and os.pread(self._number, 1, end - 1) != b"\n":
                os.write(self._number, b"\n")
        except OSError as error:
            raise unwritable(path, error) from error

    def append(self, record: Record) -> None:
        """Append a record, which is safe on disk when this returns."""
        line = line_of(record)
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

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self._require_in_place()
        finally:
            os.close(self._number)
        if self._new and not self._began():  # without a record, no file is left
            with suppress(OSError):
                self.path.unlink()

    def _require_in_place(self) -> None:
        if not is_at(self.path, self._number):
            problem = "was removed or replaced while jobs were done"
            remedy = "run the same command again, to go on or anew"
            raise InputError("damaged", problem, remedy, path=self.path)

"""The journal of OUT: a durable JSON line for each job that ended.

``OUT/journal.jsonl`` holds what a single process wrote, ``OUT/journal-2of8.jsonl`` what that shard
of a batch did since. A last line that is no JSON is a record whose writer died: it is ignored, and
cut off before the next record is appended. Where records speak of the same file, the last holds.

A record has
    sample_id   name of the sample, the stem of its files
    job, recipe its identity, see `identity`
    status      ok, failed or rejected
    reason      a code of `defocus_core.errors`, null if ok; ``message`` says it to people
    settings    what was asked for: lens, reading, outputs, quality
    inputs      role to path (relative to OUT, or absolute as given), size, mtime_ns, blake2b
    outputs     kind, or kind.preview, to path relative to OUT; if ok, size, mtime_ns, blake2b, too
    lens        what it turned out to be, as `lens_record`; with size, coc_px, color_note,
                depth_note, device and warnings, null if not ok; depth_repair, null if nothing
                was rendered, see `defocus_core.picture.repair_words`
    quality, version (of the package), renderer (its version)
    seconds     of reading, rendering and writing; cpu, of rendering
    finished    when, UTC, for people: the order of the lines decides
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from defocus_core.batch.journal.records import fault_of, linked_folders
from defocus_core.errors import InputError, cannot_read
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import is_at, sync_folder, unwritable
from defocus_core.system.memory import without_collections

Record = Mapping[str, Any]
_BLOCK = 1000  # lines
_LONGEST_NUMBER = 20  # characters of 64 bits
_SAMPLE = re.compile(rb'"sample_id": ("(?:[^"\\]|\\.)+")')
MAX_SHARDS = 999_999  # as many as can be asked for
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
    names = (_SHARD.fullmatch(path.name) for path in out.glob("*journal-*of*.*"))
    found = {Shard(int(name[1]), int(name[2])) for name in names if name}
    return sorted(shard for shard in found if 1 <= shard.number <= shard.of <= MAX_SHARDS)


def require_journal(out: Path) -> None:
    """Refuse a directory that no batch has written to."""
    if not any(out.glob("journal*.jsonl")):
        raise InputError(
            "empty", "has no journal", "name the directory that a batch writes to", path=out
        )


def read_all(out: Path) -> list[Record]:
    """The records of all journals in OUT, the last of a file the true one.

    Those of shards follow, since a run on all of OUT begins with `run_file.gather`.
    """
    paths = [journal_path(out), *(journal_path(out, shard) for shard in shards(out))]
    return [record for path in paths for record in read(path)]


def read(path: Path) -> list[Record]:
    """The records of a journal, none if it is missing."""
    try:
        data = Folder(path.parent).read(path.name)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise cannot_read(path, error, "check its permissions, or copy it again") from error
    lines = [(number, line) for number, line in enumerate(data.split(b"\n"), 1) if line]
    if lines and not _is_whole(lines[-1][1]):
        lines.pop()
    linked = linked_folders(path.parent)
    records: list[Record] = []
    with without_collections():
        for start in range(0, len(lines), _BLOCK):
            records += _block(path, lines[start : start + _BLOCK], linked)
    return records


def _block(
    path: Path, numbered: Sequence[tuple[int, bytes]], linked: frozenset[str]
) -> list[Record]:
    """The records of a block of lines, which share their keys in memory."""
    records: list[Any] = []
    with suppress(ValueError, RecursionError):
        records = _parsed(b"[" + b",".join(line for _, line in numbered) + b"]")
    if len(records) != len(numbered):
        records = [_parsed(line) if _is_whole(line) else None for _, line in numbered]
    for (number, line), record in zip(numbered, records, strict=True):
        fault = "is broken" if record is None else fault_of(record, linked)
        if fault:
            remedy = "remove that line and the outputs of its job, which is done again"
            raise InputError(
                "damaged", f"line {number}{_sample_words(line)} {fault}", remedy, path=path
            )
    return records


def _sample_words(line: bytes) -> str:
    """The name of the sample in a line that is no record, as far as it can be read."""
    name = _SAMPLE.search(line)
    with suppress(ValueError):
        return f", of {json.loads(name[1])}," if name else ""
    return ""


def _parsed(line: bytes) -> Any:
    return json.loads(line, parse_constant=_refuse_constant, parse_int=_bounded)


def _bounded(digits: str) -> int:
    if len(digits) > _LONGEST_NUMBER:
        raise ValueError("a number of more than 64 bits")
    return int(digits)


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no JSON")


def _is_whole(line: bytes) -> bool:
    """Whether a line is JSON; the beginning of a record, whose writer died, is not."""
    with suppress(ValueError, RecursionError):
        _parsed(line)
        return True
    return False


def files_of(record: Record) -> list[str]:
    """The outputs that a record speaks of, relative to OUT."""
    return [stamp["path"] for stamp in record["outputs"].values()]


def input_path(path: Path, out: Path) -> str:
    """The path of an input as a journal has it: as given if absolute, else relative to OUT."""
    text = str(path)
    if path.is_absolute():
        return text
    folder, _, name = text.rpartition("/")
    return _input_folder(folder, out, os.getcwd()) + name  # noqa: PTH109 - it is asked of each job


@lru_cache(maxsize=1024)
def _input_folder(folder: str, out: Path, base: str) -> str:
    """A folder relative to OUT, with a slash at its end; both paths are relative to ``base``."""
    # What is above a linked folder is what is above that which the link leads to.
    parts = Path(folder).parts
    ups = max((place for place, part in enumerate(parts, 1) if part == ".."), default=0)
    start = Path(base, *parts[:ups]).resolve()
    found = Path(os.path.relpath(start.joinpath(*parts[ups:]), Path(base, out).resolve()))
    return "" if found == Path() else f"{found.as_posix()}/"


class Journal:
    """A journal that records are appended to. Its one writer holds the lock of OUT."""

    def __init__(self, path: Path, began: Callable[[], bool] = lambda: False) -> None:
        """Open it.

        `began`: whether outputs are there, of which an empty journal says that they are its own.
        """
        self.path, self._began = path, began
        self._new = not path.exists()
        try:
            self._number = Folder(path.parent).append(path.name)
            self._cut_torn_tail()
        except OSError as error:
            raise unwritable(path, error) from error

    def append(self, record: Record) -> None:
        """Add a record; when this returns, no crash loses it."""
        line = json.dumps(record, allow_nan=False).encode() + b"\n"
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
        """Refuse to go on where nobody will find what is written."""
        if not is_at(self.path, self._number):
            problem = "was removed or replaced while jobs were done"
            raise InputError(
                "damaged", problem, "run the same command again, to go on or anew", path=self.path
            )

    def _cut_torn_tail(self) -> None:
        """Remove a record that was being written when its writer died; end the last whole line."""
        data = Folder(self.path.parent).read(self.path.name)
        last = data.rstrip(b"\n").rpartition(b"\n")[2]
        if last and not _is_whole(last):
            os.ftruncate(self._number, data.rindex(last))
        elif last and not data.endswith(b"\n"):
            os.write(self._number, b"\n")


def merged(records: Sequence[Record]) -> bytes:
    """A journal of these records, each of them once."""
    lines = dict.fromkeys(json.dumps(record, allow_nan=False) for record in records)
    return "".join(f"{line}\n" for line in lines).encode()

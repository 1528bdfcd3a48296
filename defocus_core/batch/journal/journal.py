"""What was done: the journal of OUT, a durable JSON line for each job that ended.

``OUT/journal.jsonl`` holds what a single process wrote, ``OUT/journal-2of8.jsonl`` what that shard
of a batch did since. A last line that is no JSON is a record whose writer died: it is ignored, and
cut off before the next record is appended. Where records speak of the same file, the last holds.

A line holds the fields of `record`. Settings, lens and notes of records are mostly alike: a line
whose ``shared`` is that of an earlier, full line has of them only what differs.
A `Ledger` reads lines as a stream, and keeps of a record where it stands.
"""

from __future__ import annotations

import json
import os
import re
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from weakref import finalize

from defocus_core.batch.journal.record import (
    Record,
    fault_of,
    linked_folders,
    record_of,
    values_of,
)
from defocus_core.errors import InputError, cannot_read
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import is_at, sync_folder, unwritable
from defocus_core.request.output_kinds import PREVIEW
from defocus_core.system.memory import without_collections

_LONGEST_NUMBER = 20  # characters of 64 bits
_SAMPLE = re.compile(rb'"sample_id": ?("(?:[^"\\]|\\.)+")')
_ENCODER = json.JSONEncoder(separators=(",", ": "), allow_nan=False)
MAX_SHARDS = 999_999  # as many as can be asked for
_SHARD = re.compile(r"\.?journal-(\d+)of(\d+)\.(jsonl|run|lock)")
_PREVIEW = f"{PREVIEW}.png"  # ends the names of previews
_TAIL = 2**16  # bytes that are looked at first for the beginning of the last line
# Keys of which a line has what differs from an earlier one, and those of pictures alone.
_ASKED = ("settings", "quality", "version", "renderer")
_FOUND = (
    *("lens", "size", "color_note", "depth_note", "depth_repair", "device", "measures"),
    *("warnings", "reason", "message"),
)
Values = Mapping[str, Any]


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


def require_journal(out: Path, pattern: str = "journal*.jsonl") -> None:
    """Refuse a directory that no batch has written to."""
    if not any(out.glob(pattern)):
        raise InputError(
            "empty", "has no journal", "name the directory that a batch writes to", path=out
        )


class Line(NamedTuple):
    """A line of a journal."""

    begin: int  # where it begins, in bytes
    values: Values
    text: bytes


class JournalFile:
    """The lines of a journal, one after another, or each by where it begins."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._whole: dict[str, Values] = {}  # full lines, by what others share with them
        self._file: BinaryIO | None = None
        with suppress(FileNotFoundError):
            try:
                self._file = Folder(path.parent).open(path.name)
            except FileNotFoundError:
                raise
            except OSError as error:
                remedy = "check its permissions, or copy it again"
                raise cannot_read(path, error, remedy) from error
            finalize(self, self._file.close)

    def lines(self) -> Iterator[Line]:
        """Each line but blank ones, and one whose writer died."""
        linked, start = linked_folders(self.path.parent), 0
        lines = enumerate(self._file or (), 1)
        for number, text in lines:
            begin, start = start, start + len(text)
            if text == b"\n":
                continue
            values: Any = None
            fault = "is broken"
            try:
                values = _parsed(text)
            except _NoValueError as error:
                fault = str(error)
            else:
                if values is None and all(rest == b"\n" for _, rest in lines):
                    return
            if values is not None:
                values = self._with_shared(values)
                fault = fault_of(values, linked) or ""
            if fault:
                remedy = "remove that line and the outputs of its job, which is done again"
                problem = f"line {number}{_sample_words(text)} {fault}"
                raise InputError("damaged", problem, remedy, path=self.path)
            yield Line(begin, values, text)

    def _with_shared(self, values: Any) -> Any:
        """The values of a line, and what it shares with an earlier one if that is there."""
        mark = values.get("shared") if isinstance(values, dict) else None
        if type(mark) is not str:
            return values
        if "version" in values:  # a process has one, which a line that shares it leaves out
            self._whole[mark] = _shared(values)
        return _sum(self._whole.get(mark, {}), values)

    def record(self, begin: int) -> Record:
        """The record of a line that was read before."""
        assert self._file is not None
        self._file.seek(begin)
        return record_of(self._with_shared(json.loads(self._file.readline())))


def _shared(values: Values) -> dict[str, Any]:
    """What other records may have in common with a record."""
    keys = (*_ASKED, *(_FOUND if values.get("status") == "ok" else ()))
    return {key: values[key] for key in keys if key in values}


def _sum(whole: Values, values: Values) -> dict[str, Any]:
    """Values, and what they leave out of those of a full line, in tables within them, too."""
    both = {**whole, **values}
    for key, value in values.items():
        if type(value) is dict and type(whole.get(key)) is dict:
            both[key] = _sum(whole[key], value)
    return both


def _difference(whole: Values, values: Values) -> dict[str, Any]:
    """What of values `_sum` does not know from a full line of the same keys."""
    return {
        key: _difference(whole[key], value) if isinstance(value, dict) else value
        for key, value in values.items()
        if value != whole[key]
    }


def _keys(values: Any) -> Any:
    """The keys of values, and of tables within them."""
    if not isinstance(values, dict):
        return None
    return tuple((key, _keys(value)) for key, value in sorted(values.items()))


def _sample_words(line: bytes) -> str:
    """The name of the sample in a line that is no record, as far as it can be read."""
    name = _SAMPLE.search(line)
    with suppress(ValueError):
        return f", of {json.loads(name[1])}," if name else ""
    return ""


def _parsed(line: bytes) -> Any:
    """The value of a line of JSON; None if it is none, as the beginning of one."""
    try:
        values = _DECODER.decode(line.decode())
    except (ValueError, RecursionError):
        return None
    if b"\\ud" in line or b"\\uD" in line:
        try:
            os.fsencode(_ENCODER_OF_TEXTS.encode(values))
        except UnicodeEncodeError:
            raise _NoValueError("has a text with half of a surrogate pair") from None
    return ... if values is None else values


class _NoValueError(Exception):
    """JSON that holds what no value is."""


def _bounded(digits: str) -> int:
    if len(digits) > _LONGEST_NUMBER:
        raise _NoValueError("has a number of more than 64 bits")
    return int(digits)


def _finite(digits: str) -> float:
    if (number := float(digits)) - number != 0:
        raise _NoValueError(f"has the number {digits:.40}, which no float holds")
    return number


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


_DECODER = json.JSONDecoder(
    parse_constant=_refuse_constant, parse_int=_bounded, parse_float=_finite
)
_ENCODER_OF_TEXTS = json.JSONEncoder(ensure_ascii=False)


class Ledger:
    """The records of the journals of OUT, the last of a file the true one.

    A record names all files that its job writes; of records that name the same file the last one
    counts. A record of pictures is superseded when none of them is left but previews; a record
    without outputs, as soon as another one names any of its files. Kept of a record are its files,
    and where its line begins: some 300 bytes.

    Attributes:
        splits: the splits that pictures were in, by their stems.
        last: by file, relative to OUT, the number of the record that holds for it.
        outcomes: how the job of each record ended.
        seconds: what each took to render.
    """

    def __init__(
        self,
        out: Path,
        seen: Callable[[Shard | None, str, str], None] | None = None,
        *,
        is_empty: bool = False,
    ) -> None:
        """Read the journals; those of shards follow, as a run on all of OUT joins them first.

        `seen`: called with the shard, the sample and the time of each record, oldest first;
        `is_empty`: no journal counts, as beside a picture that has none.
        """
        self.out = out
        self.splits: dict[str, tuple[str, ...]] = {}
        self.last: dict[str, int] = {}
        self.outcomes: list[Outcome] = []
        self.seconds = array("f")
        self._once: set[str] = set()  # files that an earlier record has as done, and the last not
        # Of each record its sample, where its line begins, in which journal; how many files it has
        self._samples: list[str] = []
        self._begins, self._of, self._files = array("Q"), array("L"), array("H")
        parts = [] if is_empty else [None, *shards(out)]
        self._journals = [JournalFile(journal_path(out, part)) for part in parts]
        outcomes: dict[Outcome, Outcome] = {}
        with without_collections():
            for place, (part, reader) in enumerate(zip(parts, self._journals, strict=True)):
                for begin, values, _ in reader.lines():
                    status = "ok" if values["status"] == "ok" else "failed"
                    found = Outcome(status, values["reason"], values.get("renderer"))
                    self.outcomes.append(outcomes.setdefault(found, found))
                    self._begins.append(begin)
                    self._of.append(place)
                    self._add(values)
                    if seen is not None:
                        seen(part, values["sample_id"], values["finished"])

    def _add(self, values: Values) -> None:
        number, is_ok = len(self._files), values["status"] == "ok"
        paths = [stamp["path"] for stamp in values["outputs"].values()]
        for path in paths:
            if is_ok:
                self._once.discard(path)
            elif self.is_known(path):
                self._once.add(path)
            self.last[path] = number
        self._files.append(len(paths))
        self._samples.append(values["sample_id"])
        self.seconds.append(values["seconds"]["render"] if is_ok else 0.0)
        if split := values.get("split"):
            stem = values["settings"].get("stem", "")
            if split not in self.splits.setdefault(stem, ()):
                self.splits[stem] += (split,)

    def is_ok(self, number: int | None) -> bool:
        """Whether a record is of pictures; not if there is none."""
        return number is not None and self.outcomes[number].status == "ok"

    def is_known(self, path: str) -> bool:
        """Whether a record has a file, relative to OUT, as written."""
        return path in self._once or self.is_ok(self.last.get(path))

    def number_of(self, paths: Iterable[str]) -> int | None:
        """The number of the record that holds for all of these files; None if there is none."""
        numbers = {self.last.get(path) for path in paths}
        return numbers.pop() if len(numbers) == 1 else None

    def record(self, number: int) -> Record:
        """The record of a number."""
        reader = self._journals[self._of[number]]
        return reader.record(self._begins[number])

    def record_of(self, paths: Iterable[str]) -> Record:
        """The record that holds for all of these files, which there is."""
        number = self.number_of(paths)
        assert number is not None
        return self.record(number)

    def live(self) -> Iterator[int]:
        """The numbers of the records that are not superseded, oldest first."""
        own = Counter(self.last.values())
        shown = {n for path, n in self.last.items() if not path.endswith(_PREVIEW)}
        for number, files in enumerate(self._files):
            if 0 < own[number] == files or (number in shown and self.is_ok(number)):
                yield number

    def samples(self) -> set[str]:
        """The names of the samples that have pictures."""
        return {self._samples[number] for number in self.live() if self.is_ok(number)}

    def records(self, only: Collection[str] | None = None) -> Iterator[Record]:
        """The records that are not superseded by name, oldest first, with the outputs of theirs.

        `only`: names of samples; None for all.
        """
        samples = self._samples
        wanted = (n for n in self.live() if only is None or samples[n] in only)
        for number in sorted(wanted, key=samples.__getitem__):
            record = self.record(number)
            outputs = record.outputs.items()
            own = {name: stamp for name, stamp in outputs if self.last[stamp.path] == number}
            yield record if len(own) == len(outputs) else record.with_files(outputs=own)


class Outcome(NamedTuple):
    """How a job ended, as far as jobs are counted by it."""

    status: str
    reason: str | None
    renderer: int | None


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
        # What this process wrote whole, by its keys
        self._whole: dict[Any, tuple[str, Values]] = {}
        try:
            self._number = Folder(path.parent).append(path.name)
            self._cut_torn_tail()
        except OSError as error:
            raise unwritable(path, error) from error

    def append(self, record: Record) -> None:
        """Add a record; when this returns, no crash loses it."""
        values = values_of(record)
        shared = _shared(values)
        values = {key: value for key, value in values.items() if key not in shared}
        keys = _keys(shared)
        mark, whole = self._whole.get(keys, ("", None))
        if whole is None:
            mark = blake2b(_ENCODER.encode(shared).encode(), digest_size=4).hexdigest()
        values |= {"shared": mark, **(shared if whole is None else _difference(whole, shared))}
        line = _ENCODER.encode(values).encode() + b"\n"
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
        self._whole.setdefault(keys, (mark, shared))
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
        size = os.fstat(self._number).st_size
        last, begin = b"", size
        while begin and b"\n" not in last.rstrip(b"\n"):
            begin = max(0, begin - _TAIL)
            last = os.pread(self._number, size - begin, begin)
        begin += last.rstrip(b"\n").rfind(b"\n") + 1
        last = os.pread(self._number, size - begin, begin)
        with suppress(_NoValueError):  # whoever reads it tells of that
            if last.strip(b"\n") and _parsed(last) is None:
                os.ftruncate(self._number, begin)
                return
        if last and not last.endswith(b"\n"):
            os.write(self._number, b"\n")

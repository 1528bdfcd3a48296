"""Two finished batches side by side: their pictures by sample, and how their recipes differ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from defocus_core.batch.journal import identity
from defocus_core.batch.journal.journal import Record, read_all
from defocus_core.batch.journal.resume import Ledger
from defocus_core.compare.pairing import FilePair
from defocus_core.compare.picture import SUFFIXES
from defocus_core.errors import InputError

_VERSIONS = ("version", "renderer")


@dataclass(frozen=True)
class RecipeChange:
    """What differs in the recipes of samples that two batches share."""

    # A setting like lens.fnum, ``renderer``, ``version``, or ``input color`` of another role,
    # whose bytes differ
    what: str
    a: str  # what it is in A
    b: str  # what it is in B
    samples: int  # number of samples that differ so
    shared: int  # number of samples that both have

    @property
    def words(self) -> str:
        """The change, like ``lens.fnum 2 instead of 1.4 in 3 of 4 samples``."""
        many = f"in {self.samples} of {self.shared} samples"
        if self.what.startswith("input "):
            return f"other bytes of the {self.what} {many}"
        return f"{self.what} {self.b} instead of {self.a} {many}"


@dataclass(frozen=True)
class BatchPairs:
    """The pictures of two batches, and the changes of their recipes, the most frequent first."""

    pairs: list[FilePair]
    changes: list[RecipeChange]
    shared: int

    def lines(self) -> Iterator[str]:
        """The recipes in words."""
        if self.shared and not self.changes:
            yield f"recipes: alike in all {self.shared} samples that both batches have"
        for change in self.changes:
            yield f"recipe: {change.words}"


def are_batches(*folders: Path) -> bool:
    """Whether all of the folders have the journal of a batch."""
    return all(folder.is_dir() and any(folder.glob("journal*.jsonl")) for folder in folders)


def pair_batches(a: Path, b: Path) -> BatchPairs:
    """The pictures of two batches, paired by sample and kind."""
    of_a, of_b = _samples(a), _samples(b)
    files_a, files_b = _pictures(a, of_a), _pictures(b, of_b)
    if not files_a and not files_b:
        problem = f"has a journal without pictures, and so has {b}"
        raise InputError("empty", problem, "name batches that made some", path=a)
    pairs = []
    for key in files_a | files_b:
        one, other = files_a.get(key), files_b.get(key)
        root, path = (a, one) if one is not None else (b, other)
        assert path is not None
        pairs.append(FilePair(path.relative_to(root).as_posix(), one, other))
    pairs.sort(key=lambda pair: pair.name)
    shared = sorted(of_a.keys() & of_b.keys())
    counts = Counter(change for name in shared for change in _changes(of_a[name], of_b[name]))
    changes = [RecipeChange(*change, count, len(shared)) for change, count in counts.items()]
    changes.sort(key=lambda change: (-change.samples, change.what, change.b))
    return BatchPairs(pairs, changes, len(shared))


def _samples(folder: Path) -> dict[str, Record]:
    """The records of the samples that were made, by name."""
    live = Ledger(folder, read_all(folder)).live
    return {record["sample_id"]: record for record in live if record["status"] == "ok"}


def _pictures(folder: Path, records: Mapping[str, Record]) -> dict[tuple[str, str], Path]:
    """Files by sample and kind; a file that is gone is not there."""
    files = {
        (name, kind): folder / stamp["path"]
        for name, record in records.items()
        for kind, stamp in record["outputs"].items()
    }
    return {
        key: path
        for key, path in files.items()
        if path.suffix.lower() in SUFFIXES and path.exists()
    }


def _changes(a: Record, b: Record) -> Iterator[tuple[str, str, str]]:
    """What differs between the recipes of two records, and what it is in each."""
    for key, was, now in identity.changed_settings(a["settings"], b["settings"]):
        yield key, str(was), str(now)
    for key in _VERSIONS:
        if a.get(key) != b.get(key):
            yield key, str(a.get(key)), str(b.get(key))
    for role in sorted({*a["inputs"], *b["inputs"]}):
        was, now = (_digest(record, role) for record in (a, b))
        if was != now:
            yield f"input {role}", "", ""


def _digest(record: Record, role: str) -> Any:
    return record["inputs"].get(role, {}).get("blake2b")

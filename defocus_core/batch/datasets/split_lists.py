"""The list of each split, ``OUT/<split>set.jsonl``, by which `datasets` of Hugging Face loads it.

The ``configs`` in the head of README.md name the lists. A line is that of the index, without what
would give a column other types in two splits: what some split has no value of. Pictures that image
libraries cannot decode are in ``outputs`` alone.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from defocus_core.batch.datasets import sample_index
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import written_whole

Entry = Mapping[str, Any]


def write(out: Path, entries: Sequence[Entry]) -> list[Path]:
    """Write the list of each split; none where the samples have none."""
    splits = _by_split(entries)
    said = [set[str]().union(*map(_said, mine)) for mine in splits.values()]
    common = set[str].intersection(*said) if said else set()
    for split, mine in splits.items():
        with written_whole(out / _name(split), out) as file:
            file.writelines(sample_index.line(_only(entry, common)) for entry in mine)
    return [out / _name(split) for split in splits]


def remove(out: Path, splits: Iterable[str]) -> None:
    """Remove the lists of some splits."""
    for split in splits:
        Folder(out).remove(_name(split))


def configs(entries: Sequence[Entry]) -> Iterator[str]:
    """Lines of YAML that tell `datasets` of the lists; of all samples where there is no split."""
    lists = {split: _name(split) for split in _by_split(entries)} or {"train": sample_index.NAME}
    folders = {
        f"{path.partition('/')[0]}/*.{path.rpartition('.')[2]}"
        for entry in entries
        for path in entry["outputs"].values()
        if sample_index.decoded(path)
    }
    yield from ("configs:", "- config_name: default")
    if folders:  # else the lists are tables
        yield f"  metadata_filenames: {json.dumps(list(lists.values()))}"
    yield "  data_files:"
    for split, name in lists.items():
        yield f"  - split: {json.dumps(split)}"
        yield f"    path: {json.dumps([name, *sorted(folders)])}"


def _name(split: str) -> str:
    # Of "train.jsonl" `datasets` would guess that it is all of a split, as of any such name.
    return f"{split}set.jsonl"


def _by_split(entries: Sequence[Entry]) -> Mapping[str, list[Entry]]:
    splits: dict[str, list[Entry]] = defaultdict(list)
    for entry in entries:
        if entry["split"]:
            splits[entry["split"]].append(entry)
    return splits


def _said(entry: Entry, before: str = "") -> Iterator[str]:
    """Dotted keys of an entry that have a value."""
    for key, value in entry.items():
        if isinstance(value, Mapping):
            yield from _said(value, f"{before}{key}.")
        elif value not in (None, []) and (
            not key.endswith("file_name") or sample_index.decoded(value)
        ):
            yield before + key


def _only(entry: Entry, keys: set[str], before: str = "") -> dict[str, Any]:
    """An entry with these dotted keys alone."""
    kept: dict[str, Any] = {}
    for key, value in entry.items():
        if isinstance(value, Mapping):
            if inner := _only(value, keys, f"{before}{key}."):
                kept[key] = inner
        elif before + key in keys:
            kept[key] = value
    return kept

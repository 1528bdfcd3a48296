"""The list of each split, ``OUT/<split>set.jsonl``, by which `datasets` of Hugging Face loads it.

The ``configs`` in the head of README.md name the lists. A line is that of the index, without what
would give a column other types in two splits: what one has a value of, and another has none.
Pictures that image libraries cannot decode are in ``outputs`` alone.
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
Key = tuple[str, ...]  # of a value in a mapping, or in one within it


def write(out: Path, entries: Sequence[Entry], lines: Sequence[bytes]) -> list[Path]:
    """Write the list of each split; none where the samples have none.

    `lines`: of the index.
    """
    splits, has_pictures = _by_split(entries), bool(_folders(entries))
    known = [_with_values(entries[n] for n in mine) for mine in splits.values()]
    left_out = set[Key]().union(*known).difference(set[Key].intersection(*known) if known else ())
    for split, mine in splits.items():
        with written_whole(out / _name(split), out) as file:
            file.writelines(
                sample_index.line(_without(entries[n], left_out))
                if left_out or has_pictures
                else lines[n]
                for n in mine
            )
    return [out / _name(split) for split in splits]


def remove(out: Path, splits: Iterable[str]) -> None:
    """Remove the lists of some splits."""
    for split in splits:
        Folder(out).remove(_name(split))


def configs(entries: Sequence[Entry]) -> Iterator[str]:
    """Lines of YAML that tell `datasets` of the lists; of all samples where there is no split."""
    lists = {split: _name(split) for split in _by_split(entries)} or {"train": sample_index.NAME}
    folders = _folders(entries)
    yield from ("configs:", "- config_name: default")
    if folders:  # else the lists are tables
        yield f"  metadata_filenames: {json.dumps(list(lists.values()))}"
    yield "  data_files:"
    for split, name in lists.items():
        yield f"  - split: {json.dumps(split)}"
        yield f"    path: {json.dumps([name, *folders])}"


def _name(split: str) -> str:
    # Of "train.jsonl" `datasets` would guess that it is all of a split, as of any such name.
    return f"{split}set.jsonl"


def _by_split(entries: Sequence[Entry]) -> Mapping[str, list[int]]:
    """The numbers of the entries of each split."""
    splits: dict[str, list[int]] = defaultdict(list)
    for number, entry in enumerate(entries):
        if entry["split"]:
            splits[entry["split"]].append(number)
    return splits


def _folders(entries: Iterable[Entry]) -> list[str]:
    """Patterns of the pictures that can be decoded."""
    paths = {path for entry in entries for path in entry["outputs"].values()}
    pictures = filter(sample_index.decoded, paths)
    return sorted({f"{path.partition('/')[0]}/*.{path.rpartition('.')[2]}" for path in pictures})


def _with_values(entries: Iterable[Entry], before: Key = ()) -> set[Key]:
    """The keys of which any entry has a value."""
    known: set[str] = set()
    inner: dict[str, list[Entry]] = defaultdict(list)
    for entry in entries:
        for key, value in entry.items():
            if key in known:
                continue
            if isinstance(value, dict):
                inner[key].append(value)
            elif value not in (None, []):
                known.add(key)
    within = (_with_values(each, (*before, key)) for key, each in inner.items())
    return {(*before, key) for key in known}.union(*within)


def _without(entry: Entry, keys: set[Key]) -> dict[str, Any]:
    """An entry without some keys, and without pictures that cannot be decoded."""
    kept = {
        key: value
        for key, value in entry.items()
        if not key.endswith("file_name") or sample_index.decoded(value)
    }
    for *folders, last in keys:
        place = kept
        for key in folders:
            place[key] = dict(place.get(key, {}))
            place = place[key]
        place.pop(last, None)
    return kept

"""The index of a finished batch, ``OUT/metadata.jsonl``: a line for each sample.

``file_name`` comes first, as the image folders of Hugging Face's `datasets` want it, and each
further picture that they can decode is ``<kind>_file_name``. They call the column of ``file_name``
image; beside the sharp picture, whose kind is image, it is ``<kind>_file_name``, too. A key has
one type in every line, null where there is nothing to say, so that it reads as a table. It holds no
time and no place of OUT.

Beside it are the list of each split, ``OUT/<split>set.jsonl``, by which `datasets` loads it: the
``configs`` in the head of README.md name them. A line of theirs is that of the index, without what
would give a column other types in two splits: what one has a value of, and another has none.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import reduce
from hashlib import blake2b
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO

from defocus_core.batch.journal.record import Record, Taken
from defocus_core.batch.journal.runs import INDEX
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import written_whole
from defocus_core.picture.take import MEASURES
from defocus_core.request.job import FRAME_ROLE
from defocus_core.request.lens import EFFECTS
from defocus_core.request.origin import Origin
from defocus_core.request.output_kinds import KINDS

NAME = INDEX
_OWN = (b'"sample_id": ', b'"outputs_blake2b": ')  # what a line of ours has
_SAMPLE = re.compile(rb'"sample_id": ("(?:[^"\\]|\\.)*")')
_LONGEST_LINE = 2**24  # bytes
DIGEST = 16  # bytes of the hash of an index
_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)
MM_PER_M = 1000.0
_DECODED = (".png", ".jpg", ".tif")  # types that image libraries without EXR decode


def joined(records: Iterable[Record]) -> Iterator[Record]:
    """A record for each sample; those that took nothing are no samples.

    Records of one sample become one if they differ in their outputs alone; else the last holds, as
    the earlier outputs were taken by another lens.

    `records`: of the journal by name, oldest first.
    """
    pictures = (r for r in records if r.taken and not r.outputs.keys().isdisjoint(KINDS))
    for _, mine in groupby(pictures, lambda record: record.sample_id):
        yield reduce(_joined, mine)


def is_own(out: Path, name: str = NAME) -> bool:
    """Whether a list of samples in OUT is of a batch, by its first line, or holds nothing."""
    return is_free(out, name, lambda file: is_own_line(file.readline(_LONGEST_LINE)))


def is_free(out: Path, name: str, is_own: Callable[[BinaryIO], bool]) -> bool:
    """Whether a file of OUT is missing, or one of ours."""
    try:
        with Folder(out).open(name) as file:
            return is_own(file)
    except OSError as error:
        return isinstance(error, FileNotFoundError)


def is_own_line(line: bytes) -> bool:
    """Whether a line is one of an index, or none."""
    return not line or all(key in line for key in _OWN)


def listed(out: Path) -> set[str] | None:
    """The names of the samples in the index of OUT; None if it has none."""
    with suppress(OSError, ValueError, TypeError):
        return {name for name, _ in _lines(out)} if (out / NAME).exists() else None
    return None


def withdraw(out: Path, changing: Collection[str], *, alone: bool) -> set[str]:
    """Take samples that are about to change out of the index of OUT; the names of those taken.

    A process that is killed leaves an index of the samples that it did not touch, each as it is.
    """
    taken = (listed(out) or set()) & {*changing}
    if taken and alone:
        with written_whole(out / NAME, out) as file:
            file.writelines(text for name, text in _lines(out) if name not in taken)
    elif taken:
        with suppress(FileNotFoundError):
            Folder(out).remove(NAME)
    return taken


def _lines(out: Path) -> Iterator[tuple[str, bytes]]:
    """Name and line of each sample of the index of OUT.

    Raises OSError, ValueError or TypeError if it has no index of ours, or one without names.
    """
    if not is_own(out):
        raise ValueError("is not of a batch")
    with Folder(out).open(NAME) as file:
        for line in file:
            yield json.loads(_SAMPLE.search(line)[1]), line  # type: ignore[index]


def digest(lines: Iterable[bytes]) -> str:
    """The hash of an index of these lines."""
    hashed = blake2b(digest_size=DIGEST)
    for each in lines:
        hashed.update(each)
    return hashed.hexdigest()


def _joined(before: Record, record: Record) -> Record:
    """A record with the outputs of an earlier record of the sample, if both were taken alike."""
    was, now = _pictures(before), _pictures(record)
    if _how_taken(before) != _how_taken(record):
        return record
    outputs = {**was.outputs, **now.outputs}
    warnings = tuple(dict.fromkeys([*was.warnings, *now.warnings]))
    return replace(record, end=replace(now, outputs=outputs, warnings=warnings))


def _pictures(record: Record) -> Taken:
    assert record.taken is not None  # of a sample
    return record.taken


def _how_taken(record: Record) -> tuple[Any, ...]:
    """What two records have in common whose pictures have the same inputs, lens and renderer."""
    taken = _pictures(record)
    how = (taken.lens, taken.size, taken.coc_px, record.quality, record.renderer)
    return (*how, _hashes(record))


def _hashes(record: Record) -> dict[str, Any]:
    return {role: stamp.blake2b for role, stamp in record.inputs.items()}


def line(entry: Mapping[str, Any]) -> bytes:
    """A line of the index."""
    return _ENCODER.encode(entry).encode("utf-8", "replace") + b"\n"


def entry_of(record: Record, origin: Origin) -> dict[str, Any]:
    """What the index says of a sample."""
    taken = _pictures(record)
    outputs = {kind: taken.outputs[kind] for kind in KINDS if kind in taken.outputs}
    paths = {kind: stamp.path for kind, stamp in outputs.items()}
    first, *others = sorted(paths, key=lambda kind: not KINDS[kind].image)
    (near, far), (width, height) = taken.coc_px, taken.size
    repair = taken.depth_repair or {}
    return {
        f"{first}_file_name" if "image" in paths else "file_name": paths[first],
        **{f"{kind}_file_name": paths[kind] for kind in others if decoded(paths[kind])},
        "sample_id": record.sample_id,
        "split": record.split or None,
        "width": width,
        "height": height,
        "outputs": paths,
        "inputs": {
            role: stamp.path
            for role, stamp in record.inputs.items()
            if not role.startswith(FRAME_ROLE)  # other frames of a shot
        },
        "lens": _lens(taken.lens),
        "coc_min_px": float(near),
        "coc_max_px": float(far),
        **{name: taken.measures.get(name) for name in MEASURES},
        "quality": record.quality,
        # What was repaired of the depth, and the share of the pixels that it changed.
        "depth_repaired": list(repair.get("kinds", ())),
        "depth_repaired_share": repair.get("share"),
        "warnings": list(taken.warnings),
        "outputs_blake2b": {kind: stamp.blake2b for kind, stamp in outputs.items()},
        "inputs_blake2b": _hashes(record),
        "version": record.version,
        "renderer": record.renderer,
        **{key: getattr(origin, key) or None for key in ("licence", "source")},
    }


def decoded(path: str) -> bool:
    """Whether image libraries without EXR decode a file of this name."""
    return path.endswith(_DECODED)


def _lens(lens: Mapping[str, Any]) -> dict[str, Any]:
    """A lens as the journal has it, each number a float; infinity is 0 dioptres, and null mm.

    Beside a file of radii, whose lens is the shape of its opening alone, the others are null.
    """
    focus = None if lens["focus_mm"] in ("inf", None) else float(lens["focus_mm"])
    dioptres = None if lens["focus_mm"] is None else 0.0 if focus is None else MM_PER_M / focus
    optics = ("focal_length_mm", "fnumber", "sensor_width_mm")
    draw = lens.get("draw") or {}
    return {
        **{key: None if lens[key] is None else float(lens[key]) for key in optics},
        "focus_mm": focus,
        "focus_dioptres": dioptres,
        "focus_at_px": lens.get("focus_at_px"),
        "focus_percentile": lens.get("focus_percentile"),
        "blades": lens["blades"],
        "blade_rotation_deg": float(lens["blade_rotation_deg"]),
        **EFFECTS,
        **{name: value for name, value in lens.items() if name in EFFECTS},
        "draw_seed": draw.get("seed"),
        "draw_index": draw.get("index"),
        "draw_attempt": draw.get("attempt"),
    }


Entry = Mapping[str, Any]
Key = tuple[str, ...]  # of a value in a mapping, or in one within it


class SplitLists:
    """The lists of the splits of an index, whose entries are looked at as they are written."""

    def __init__(self) -> None:
        self._known: dict[str, set[Key]] = {}  # by split, the keys of which an entry has a value
        self._folders: set[str] = set()  # patterns of the pictures that can be decoded

    def look_at(self, entry: Entry) -> None:
        """Note what the lists need to know of an entry."""
        for path in filter(decoded, entry["outputs"].values()):
            self._folders.add(f"{path.partition('/')[0]}/*.{path.rpartition('.')[2]}")
        if entry["split"]:
            self._known.setdefault(entry["split"], set()).update(_with_values(entry))

    def write(self, out: Path) -> list[Path]:
        """Write the list of each split of the index of OUT; none where the samples have none."""
        every = [*self._known.values()]
        left_out = (
            set[Key]().union(*every).difference(every[0].intersection(*every) if every else ())
        )
        paths = {split: out / list_name(split) for split in self._known}
        if paths:
            with ExitStack() as stack, Folder(out).open(NAME) as index:
                files = {s: stack.enter_context(written_whole(p, out)) for s, p in paths.items()}
                for text in index:
                    entry = json.loads(text)
                    if entry["split"]:
                        is_shorter = left_out or self._folders
                        kept = line(_without(entry, left_out)) if is_shorter else text
                        files[entry["split"]].write(kept)
        return [*paths.values()]

    def configs(self) -> Iterator[str]:
        """Lines of YAML that tell `datasets` of the lists; of all samples if there is no split."""
        lists = {split: list_name(split) for split in self._known} or {"train": NAME}
        yield from ("configs:", "- config_name: default")
        if self._folders:  # else the lists are tables
            yield f"  metadata_filenames: {json.dumps(list(lists.values()))}"
        yield "  data_files:"
        for split, name in lists.items():
            yield f"  - split: {json.dumps(split)}"
            yield f"    path: {json.dumps([name, *sorted(self._folders)])}"


def remove_splits(out: Path, splits: Iterable[str]) -> None:
    """Remove the lists of some splits."""
    for split in splits:
        Folder(out).remove(list_name(split))


def list_name(split: str) -> str:
    """The name of the list of a split."""
    # Of "train.jsonl" `datasets` would guess that it is all of a split, as of any such name.
    return f"{split}set.jsonl"


def _with_values(entry: Entry, before: Key = ()) -> Iterator[Key]:
    """The keys of which an entry has a value."""
    for key, value in entry.items():
        if isinstance(value, dict):
            yield from _with_values(value, (*before, key))
        elif value not in (None, []):
            yield (*before, key)


def _without(entry: Entry, keys: set[Key]) -> dict[str, Any]:
    """An entry without some keys, and without pictures that cannot be decoded."""
    kept = {
        key: value
        for key, value in entry.items()
        if not key.endswith("file_name") or decoded(value)
    }
    for *folders, last in keys:
        place = kept
        for key in folders:
            place[key] = dict(place.get(key, {}))
            place = place[key]
        place.pop(last, None)
    return kept

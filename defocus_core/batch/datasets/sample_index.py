"""The index of a finished batch, ``OUT/metadata.jsonl``: a JSON object per sample, one per line.

The index is written for `datasets` of Hugging Face, which can load a folder of images. Its first
key is ``file_name``, the rendered picture, which becomes the column image; every other picture of a
type that `datasets` decodes is ``<kind>_file_name``. In a batch that also copies input pictures, of
the kind image, two columns would be named image: there, no key is ``file_name``, and the first one
is ``<kind>_file_name``. A key has the same type in all lines, or null, so that the index can be
read as a table. The index does not contain the time or the path of OUT.

`datasets` loads a split from a list of its samples, ``OUT/<split>set.jsonl``; README.md names these
lists. If a column were null in all lines of one split, its type would differ between splits. Lists
and tar files therefore have only the columns that have a value in every sample.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO

from defocus_core.batch.journal.record import Record
from defocus_core.batch.journal.runs import INDEX
from defocus_core.io.write_files import Folder
from defocus_core.picture.take import MEASURES
from defocus_core.request.job import FRAME_ROLE, is_label
from defocus_core.request.lens import EFFECTS
from defocus_core.request.origin import Origin
from defocus_core.request.output_kinds import KINDS

NAME = INDEX
_OWN = (b'"sample_id": ', b'"coc_min_px": ')  # the keys of our lines
_LONGEST_LINE = 2**24  # bytes
_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)
MM_PER_M = 1000.0
_DECODED = (".png", ".jpg", ".tif")  # types that image libraries without EXR decode


def newest(records: Iterable[Record]) -> Iterator[Record]:
    """The newest record of each sample, without failed ones.

    `records` must be sorted by name of the sample, and oldest first for each.
    """
    pictures = (r for r in records if r.completed and not r.outputs.keys().isdisjoint(KINDS))
    for _, mine in groupby(pictures, lambda record: record.sample_id):
        *_, last = mine
        yield last


def is_own(out: Path, name: str = NAME) -> bool:
    """Whether a list of samples in `out` may be replaced: missing, empty, or written by a batch."""
    return is_free(out, name, lambda file: is_own_line(file.readline(_LONGEST_LINE)))


def is_free(out: Path, name: str, is_own: Callable[[BinaryIO], bool]) -> bool:
    """Whether a file in `out` may be replaced: it is missing, or `is_own` accepts its content."""
    try:
        with Folder(out).open(name) as file:
            return is_own(file)
    except OSError as error:
        return isinstance(error, FileNotFoundError)


def is_own_line(line: bytes) -> bool:
    """Whether a line was written by this module, or is empty."""
    return not line or all(key in line for key in _OWN)


def listed(out: Path) -> set[str] | None:
    """The names of the samples in the index in `out`; None if there is no index of a batch."""
    with suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
        if is_own(out):
            with Folder(out).open(NAME) as file:
                return {json.loads(line)["sample_id"] for line in file}
    return None


def split_lists(out: Path) -> Iterator[str]:
    """The file names of the lists of splits in `out` that a batch has written."""
    with suppress(OSError):
        names = Folder(out).names()
        yield from (name for name in names if name.endswith(list_name("")) and is_own(out, name))


def line(entry: Mapping[str, Any]) -> bytes:
    """An entry as a line of JSON."""
    return _ENCODER.encode(entry).encode("utf-8", "replace") + b"\n"


def entry_of(record: Record, origin: Origin) -> dict[str, Any]:
    """The entry in the index for the record of a sample."""
    completed = record.completed
    assert completed is not None  # of a sample
    own = completed.outputs
    labels = [name for name in own if is_label(name)]
    outputs = {kind: own[kind] for kind in (*KINDS, *labels) if kind in own}
    paths = {kind: stamp.path for kind, stamp in outputs.items()}
    first, *others = sorted(paths, key=lambda kind: kind in labels or not KINDS[kind].image)
    (near, far), (width, height) = completed.coc_px, completed.size
    repair = completed.depth_repair or {}
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
            if role not in labels and not role.startswith(FRAME_ROLE)  # other frames of a shot
        },
        "lens": _lens(completed.lens),
        "coc_min_px": float(near),
        "coc_max_px": float(far),
        **{name: completed.measures.get(name) for name in MEASURES},
        "quality": record.quality,
        # The repairs of the depth, and the share of the changed pixels.
        "depth_repaired": kinds if isinstance(kinds := repair.get("kinds"), list) else [],
        "depth_repaired_share": repair.get("share"),
        "warnings": list(completed.warnings),
        "outputs_blake2b": {kind: stamp.blake2b for kind, stamp in outputs.items()},
        "inputs_blake2b": {role: stamp.blake2b for role, stamp in record.inputs.items()},
        "version": record.version,
        "renderer": record.renderer,
        **{key: getattr(origin, key) or None for key in ("licence", "source")},
    }


def made_by(record: Record) -> str:
    """The versions of the program, the renderer and the libraries that made a sample, as text."""
    renderer = f"renderer {record.renderer} ({record.end.back})"
    software = "" if record.completed is None else record.completed.software
    return ", ".join(filter(None, [f"defocus {record.version}", renderer, software]))


def decoded(path: str) -> bool:
    """Whether `datasets` can decode a file with this suffix; it cannot decode EXR."""
    return path.endswith(_DECODED)


def _lens(lens: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a lens in an index entry. An infinite focus is null in mm, and 0 in 1/m."""
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
    }


# Columns of the sample and of its lens that every row has.
_COLUMNS = ("sample_id", "width", "height", "coc_min_px", "coc_max_px", "quality")
_OF_LENS = ("focal_length_mm", "fnumber", "sensor_width_mm", "focus_dioptres", "blades")


def row_of(entry: Mapping[str, Any]) -> dict[str, Any]:
    """The columns of an entry that have a value in every sample, each of the same type.

    Lens effects that are off have their default, or an empty text.
    """
    lens = {key: entry["lens"][key] for key in _OF_LENS}
    for name, default in EFFECTS.items():
        value = entry["lens"][name]
        lens[name] = value if default is not None else "" if value is None else str(value)
    columns = {key: entry[key] for key in _COLUMNS}
    return {**columns, "split": entry["split"] or "", "lens": lens}


def list_line(entry: Mapping[str, Any]) -> bytes:
    """The line of a sample in the list of its split."""
    names = {k: v for k, v in entry.items() if k.endswith("file_name") and decoded(v)}
    return line({**names, **row_of(entry)})


def tar_line(entry: Mapping[str, Any]) -> bytes:
    """The JSON of a sample in a tar: the columns of `row_of`, and the hashes of its files."""
    return line({**row_of(entry), "blake2b": entry["outputs_blake2b"]})


def list_name(split: str) -> str:
    """The file name of the list of samples of a split."""
    # `datasets` would take any name like "train.jsonl" for all of a split.
    return f"{split}set.jsonl"

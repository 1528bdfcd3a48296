"""The index of a finished batch, ``OUT/metadata.jsonl``: a line for each sample.

``file_name`` comes first, as the image folders of Hugging Face's `datasets` want it, and each
further picture that they can decode is ``<kind>_file_name``. They call the column of ``file_name``
image; beside the sharp picture, whose kind is image, it is ``<kind>_file_name``, too. A key has
one type in every line, null where there is nothing to say, so that it reads as a table. It holds no
time and no place of OUT.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from defocus_core.batch.jobs.job import FRAME_ROLE
from defocus_core.batch.jobs.origin import Origin
from defocus_core.batch.jobs.output_kinds import KINDS
from defocus_core.batch.lenses.lens import EFFECTS
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import written_whole
from defocus_core.picture.measures import MEASURES

NAME = "metadata.jsonl"
_ENCODER = json.JSONEncoder(ensure_ascii=False, allow_nan=False)
Record = Mapping[str, Any]
MM_PER_M = 1000.0
_TAKEN = ("lens", "size", "coc_px", "quality", "renderer")  # keys that say how it was taken
_DECODED = (".png", ".jpg", ".tif")  # types that image libraries without EXR decode


def write(out: Path, lines: Iterable[bytes]) -> Path:
    """Write the index, whole or not at all."""
    path = out / NAME
    with written_whole(path) as file:
        file.writelines(lines)
    return path


def entries(records: Iterable[Record], origin: Origin | None = None) -> Iterator[dict[str, Any]]:
    """What the index says of each sample, sorted by sample_id.

    `records`: of the journal, oldest first; those whose status is not ``ok`` are no samples. Of the
    others are read: sample_id, size, coc_px, quality, warnings, version, renderer, lens (as
    `lens_record` has it), and by role or kind inputs and outputs, each with its path and, where it
    is known, its blake2b. Records of one sample are joined if they differ in their outputs alone;
    else the last holds, as the earlier outputs were taken by another lens.
    """
    done: dict[str, Record] = {}
    for record in records:
        if _is_sample(record):
            name = str(record["sample_id"])
            done[name] = _joined(done[name], record) if name in done else record
    said = {key: getattr(origin, key, "") or None for key in ("licence", "source")}
    for name in sorted(done):
        yield {**_entry(done[name]), **said}


def names(records: Iterable[Record]) -> set[str]:
    """The names of the samples that the index of some records would list."""
    return {str(record["sample_id"]) for record in records if _is_sample(record)}


def listed(out: Path) -> set[str] | None:
    """The names of the samples in the index of OUT; None if it has none that can be read."""
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        lines = Folder(out).read(NAME).splitlines()
        return {str(json.loads(line)["sample_id"]) for line in lines}
    return None


def withdraw(out: Path, changing: Collection[str], *, alone: bool) -> set[str]:
    """Take samples that are about to change out of the index of OUT; the names of those taken.

    A process that is killed leaves an index of the samples that it did not touch, each as it is.
    """
    lines: dict[str, bytes] = {}
    with suppress(OSError):
        for text in Folder(out).read(NAME).splitlines(keepends=True):
            with suppress(ValueError, KeyError, TypeError, RecursionError):
                lines[str(json.loads(text)["sample_id"])] = text
    taken = lines.keys() & changing
    if taken and alone:
        with written_whole(out / NAME, out) as file:
            file.writelines(text for name, text in lines.items() if name not in taken)
    elif taken:
        with suppress(FileNotFoundError):
            Folder(out).remove(NAME)
    return taken


def _is_sample(record: Record) -> bool:
    return record["status"] == "ok" and not record["outputs"].keys().isdisjoint(KINDS)


def _joined(before: Record, record: Record) -> Record:
    """A record with the outputs of an earlier record of the sample, if both were taken alike."""
    if not _taken_alike(before, record):
        return record
    outputs = {**before["outputs"], **record["outputs"]}
    warnings = list(dict.fromkeys([*before["warnings"], *record["warnings"]]))
    return {**record, "outputs": outputs, "warnings": warnings}


def _taken_alike(before: Record, record: Record) -> bool:
    """Whether two finished pictures have the same inputs, lens and renderer."""
    alike = all(before[key] == record[key] for key in _TAKEN)
    return alike and _hashes(before) == _hashes(record)


def _hashes(record: Record) -> dict[str, Any]:
    return {role: stamp.get("blake2b") for role, stamp in record["inputs"].items()}


def line(entry: Mapping[str, Any]) -> bytes:
    """A line of the index."""
    return _ENCODER.encode(entry).encode("utf-8", "replace") + b"\n"


def _entry(record: Record) -> dict[str, Any]:
    outputs = {kind: record["outputs"][kind] for kind in KINDS if kind in record["outputs"]}
    paths = {kind: output["path"] for kind, output in outputs.items()}
    first, *others = sorted(paths, key=lambda kind: not KINDS[kind].image)
    near, far = record["coc_px"]
    width, height = record["size"]
    return {
        f"{first}_file_name" if "image" in paths else "file_name": paths[first],
        **{f"{kind}_file_name": paths[kind] for kind in others if decoded(paths[kind])},
        "sample_id": record["sample_id"],
        "split": record.get("split") or None,
        "width": width,
        "height": height,
        "outputs": paths,
        "inputs": {
            role: stamp["path"]
            for role, stamp in record["inputs"].items()
            if not role.startswith(FRAME_ROLE)  # other frames of a shot
        },
        "lens": _lens(record["lens"]),
        "coc_min_px": float(near),
        "coc_max_px": float(far),
        **{name: (record.get("measures") or {}).get(name) for name in MEASURES},
        "quality": record["quality"],
        "warnings": list(record["warnings"]),
        "outputs_blake2b": {kind: output.get("blake2b") for kind, output in outputs.items()},
        "inputs_blake2b": _hashes(record),
        "version": record["version"],
        "renderer": record["renderer"],
    }


def decoded(path: str) -> bool:
    """Whether image libraries without EXR decode a file of this name."""
    return path.endswith(_DECODED)


def _lens(lens: Record) -> dict[str, Any]:
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
        **{name: lens.get(name, default) for name, default in EFFECTS.items()},
        "draw_seed": draw.get("seed"),
        "draw_index": draw.get("index"),
        "draw_attempt": draw.get("attempt"),
    }

"""Records of a journal, and the files that they speak of, for what is made of a finished batch."""

from hashlib import blake2b

import msgspec
import numpy as np
from image_files import save

from defocus_core.batch.datasets import sample_index, tar_shards
from defocus_core.batch.journal.journal import Journal, Ledger, journal_path
from defocus_core.batch.journal.record import record_of
from defocus_core.request.origin import Origin
from defocus_core.request.output_kinds import KINDS


def png(path, level=0):
    path.parent.mkdir(parents=True, exist_ok=True)
    return save(path, np.full((3, 4, 3), level, np.uint8)).read_bytes()


def write_index(out, records):
    """Write the index of records, oldest first; its path."""
    made = [record_of(msgspec.json.encode(e)) if isinstance(e, dict) else e for e in records]
    made.sort(key=lambda record: record.sample_id)
    entries = (sample_index.entry_of(each, Origin()) for each in sample_index.newest(made))
    path = out / sample_index.NAME
    path.write_bytes(b"".join(map(sample_index.line, entries)))
    return path


def journal(out, records):
    """Write the journal of records."""
    with Journal(journal_path(out), 0) as opened:
        for each in records:
            opened.append(record_of(msgspec.json.encode(each)))


def journalled(out):
    """The records that hold in a journal."""
    return list(Ledger(out).records())


def pack(out, records, limit):
    """The shards of records."""
    write_index(out, records)
    return tar_shards.write(out, limit)


def completed(out, name, *of, **more):
    """The `Record` of a sample that is done."""
    return record_of(msgspec.json.encode(record(out, name, *of, **more)))


def record(out, name, kinds=("render", "coc"), level=0, **more):
    """A record of one sample that is done, whose outputs lie in ``out``."""
    outputs = {}
    for kind in kinds:
        path = f"{kind}/{name}.{'png' if KINDS[kind].image else 'exr'}"
        data = png(out / path, level) if path.endswith("png") else b"EXR" * (level + 1)
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        (out / path).write_bytes(data)
        digest = blake2b(data, digest_size=16).hexdigest()
        outputs[kind] = {"path": path, "size": len(data), "mtime_ns": 7, "blake2b": digest}
        preview = {**outputs[kind], "path": f"{kind}/{name}.preview.png"}
        outputs[f"{kind}.preview"] = preview
    return line(name, outputs, **more)


def line(name, outputs, **more):
    """The line of a sample that is done."""
    lens = {"focal_length_mm": 50, "fnumber": 2, "sensor_width_mm": 36.0, "focus_mm": 2000}
    return {
        "sample_id": name,
        "job": "1f",
        "recipe": "2e",
        "status": "ok",
        "reason": None,
        "message": None,
        "settings": {},
        "inputs": {role: {"path": f"{role}.exr", "mtime_ns": 7} for role in ("color", "depth")},
        "outputs": outputs,
        "lens": lens | {"blades": 0, "blade_rotation_deg": 0},
        "coc_px": [-1, 2.5],
        "size": [4, 3],
        "quality": "high",
        "color_note": "",
        "depth_note": "EXR float channel Z, metres",
        "device": "cpu",
        "seconds": {"render": 0.25},
        "finished": "2026-01-01T00:00:00Z",
        "warnings": [],
        "version": "1",
        "renderer": 1,
        **more,
    }

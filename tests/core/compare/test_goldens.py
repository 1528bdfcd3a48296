"""Goldens change all together or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from defocus_core.compare.goldens import MANIFEST, accept, store_to_update
from defocus_core.compare.record import DIFFERENT, EXTRA, MISSING, Comparison
from defocus_core.errors import InputError

OLD = {"render/a.exr": b"old a", "render/gone.exr": b"gone"}
NEW = {"render/a.exr": b"new a", "render/b.exr": b"new b"}
STATUSES = {"render/a.exr": DIFFERENT, "render/b.exr": EXTRA, "render/gone.exr": MISSING}


def held(folder):
    """Files of golden.json, with what they hold; nothing else lies in the folder."""
    found = {name: (folder / name).read_bytes() for name in store_to_update(folder).files}
    there = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert there == {*found, MANIFEST}
    return found


@pytest.mark.parametrize("survives", range(6))
def test_a_kill_while_accepting_leaves_the_old_goldens_or_the_new(survives, tmp_path, monkeypatch):
    goldens, root = tmp_path / "goldens", tmp_path / "root"
    for folder, files in ((goldens, OLD), (root, NEW)):
        (folder / "render").mkdir(parents=True)
        for name, data in files.items():
            (folder / name).write_bytes(data)
    (goldens / MANIFEST).write_text(json.dumps({"samples": {"a": {"files": sorted(OLD)}}}))
    job: Any = SimpleNamespace(sample_id="a", names=dict(enumerate(sorted(NEW))))
    monkeypatch.setattr("defocus_core.batch.journal.identity.settings", lambda _: {})
    records = [Comparison(name, None, None, status) for name, status in STATUSES.items()]
    steps, replace, store = 0, Path.replace, store_to_update(goldens)

    def killed(self, target):
        nonlocal steps
        steps += 1
        if steps > survives:
            raise KeyboardInterrupt
        return replace(self, target)

    def full(*_):
        raise OSError(28, "No space left on device")

    if survives == 5:
        monkeypatch.setattr("shutil.copyfileobj", full)
        with pytest.raises(InputError) as refused:
            accept(store, [job], root, records)
        assert refused.value.code == "unwritable"
        assert held(goldens) == OLD
        return
    monkeypatch.setattr(Path, "replace", killed)
    if survives < 3:
        with pytest.raises(KeyboardInterrupt):
            accept(store, [job], root, records)
    else:
        assert accept(store, [job], root, records) == 3
    monkeypatch.setattr(Path, "replace", replace)
    assert held(goldens) == NEW

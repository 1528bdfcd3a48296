"""Goldens change all together or not at all, and a full folder of scratch is named."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from jobs_files import FIXED, INPUTS, jobs_file

from defocus_core.batch.jobs.job import Machine
from defocus_core.batch.workers.plan import Execution
from defocus_core.compare.goldens import store
from defocus_core.compare.goldens.store import MANIFEST, accept, store_to_update
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


def test_a_full_folder_of_scratch_is_named(tmp_path, monkeypatch):
    for name in ("a_rgb.exr", "a_z.exr"):
        (tmp_path / name).touch()

    def fails(*_):
        raise InputError("unwritable", "cannot be written", "", path=tmp_path)

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr("defocus_core.batch.workers.run.carry_out", fails)
    execution: Any = Execution
    listener: Any = None
    jobs = jobs_file(tmp_path, FIXED, inputs=INPUTS)
    for free, code in ((0, "no-space"), (2**40, "unwritable")):
        usage = SimpleNamespace(free=free)
        monkeypatch.setattr("shutil.disk_usage", lambda _, usage=usage: usage)
        with (
            pytest.raises(InputError) as refused,
            store.rendered(jobs, Machine(), execution, listener),
        ):
            pass
        assert (refused.value.code, refused.value.path) == (code, str(tmp_path))
    assert not list(tmp_path.glob("defocus-golden-*"))

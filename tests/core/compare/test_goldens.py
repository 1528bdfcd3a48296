"""What is accepted appears whole, and nothing outside of the folder is touched."""

import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from defocus_core.compare.goldens import SUFFIX, accept, read_store
from defocus_core.compare.record import DIFFERENT, EXTRA, MISSING, Comparison
from defocus_core.errors import InputError
from defocus_core.io.below import Folder

OLD = {"render/a.exr": b"old a", "render/gone.exr": b"gone"}
NEW = {"render/a.exr": b"new a", "render/b.exr": b"new b"}
STATUSES = {"render/a.exr": DIFFERENT, "render/b.exr": EXTRA, "render/gone.exr": MISSING}
RECORDS = [Comparison(name, None, None, status) for name, status in STATUSES.items()]


@pytest.fixture
def folder(tmp_path):
    for root, files in ((tmp_path / "goldens", OLD), (tmp_path / "root", NEW)):
        (root / "render").mkdir(parents=True)
        for name, data in files.items():
            (root / name).write_bytes(data)
    text = json.dumps({"files": sorted(OLD), "settings": {"fnum": 2}})
    (tmp_path / "goldens" / f"a{SUFFIX}").write_text(text)
    return tmp_path / "goldens"


@pytest.fixture
def fresh(folder, monkeypatch):
    monkeypatch.setattr("defocus_core.batch.journal.resume.settings", lambda _: {})
    job: Any = SimpleNamespace(sample_id="a", names=dict(enumerate(sorted(NEW))))
    return SimpleNamespace(jobs=[job], root=folder.parent / "root", inputs={})


def held(folder):
    files = (path for path in folder.rglob("*") if path.is_file())
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in files}


def test_a_full_disk_while_accepting_leaves_the_old_goldens(folder, fresh, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    before = held(folder)
    monkeypatch.setattr("shutil.copyfileobj", full)
    with pytest.raises(InputError) as refused:
        accept(read_store(folder), fresh, RECORDS)
    assert refused.value.code == "unwritable"
    assert held(folder) == before


@pytest.mark.parametrize("survives", range(5))
def test_a_kill_while_accepting_leaves_whole_files_and_is_made_good(
    survives, folder, fresh, monkeypatch
):
    steps = 0

    def killed(real):
        def step(*words, **named):
            nonlocal steps
            steps += 1
            if steps > survives:
                raise KeyboardInterrupt
            return real(*words, **named)

        return step

    with monkeypatch.context() as patched:
        patched.setattr("os.replace", killed(os.replace))
        patched.setattr(Folder, "remove", killed(Folder.remove))
        with pytest.raises(KeyboardInterrupt):
            accept(read_store(folder), fresh, RECORDS)
    whole = {*OLD.values(), *NEW.values()}
    assert all(held(folder)[name] in whole for name in {*OLD, *NEW} & held(folder).keys())
    accept(read_store(folder), fresh, RECORDS)
    pictures = {name: data for name, data in held(folder).items() if name.endswith(".exr")}
    assert {name: pictures[name] for name in NEW} == NEW
    assert read_store(folder).files == {*NEW}


def test_a_link_in_place_of_a_golden_is_refused_before_anything_changes(folder, fresh):
    outside = folder.parent / "mine"
    outside.write_bytes(b"mine")
    (folder / "render" / "b.exr").symlink_to(outside)
    before = held(folder)
    with pytest.raises(InputError):
        accept(read_store(folder), fresh, RECORDS)
    assert (held(folder), Path(outside).read_bytes()) == (before, b"mine")

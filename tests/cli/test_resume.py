"""What was done is not done again, and what is not as it was is."""

import json
import os
import re
import subprocess

import pytest
from batches import again, jobs_file, records
from command_line import (
    color_exr,
    depth_exr,
    pair,
    photograph,
    ramp,
    refused,
    render,
    run,
    succeed,
    texture,
)

from defocus_core.batch.workers import pipeline
from defocus_core.picture import plain_path
from defocus_core.renderer_version import RENDERER_VERSION


@pytest.fixture
def computed(monkeypatch):
    """The names of the samples that are computed."""
    names: list[str] = []
    compute = plain_path.compute

    def counted(take, *rest):
        names.append(take.job.sample_id)
        return compute(take, *rest)

    monkeypatch.setattr(plain_path, "compute", counted)
    return names


def test_what_was_done_is_skipped_and_told(folders, out, computed):
    first = again(folders, out, "--json")
    before = (out / "journal.jsonl").read_bytes()
    second = again(folders, out, "--json")
    assert computed == ["a", "b", "c"]
    assert second.code == 0
    assert [line.split(":")[1] for line in second.err.splitlines()] == [
        " done before -> " + str(out / "coc" / f"{stem}.exr") for stem in "abc"
    ]
    assert (out / "journal.jsonl").read_bytes() == before
    for was, now in zip(first.json["pictures"], second.json["pictures"], strict=True):
        assert (was["done_before"], now["done_before"]) == (False, True)
        assert was["coc_px"] == now["coc_px"]
    assert sorted(path.name for path in out.iterdir()) == ["coc", "journal.jsonl"]


def test_a_record_holds_what_a_paper_needs(tmp_path, out):
    color, depth = pair(tmp_path)
    render(color, depth, "-o", out, "--outputs", "render,coc", "--preview", "--quality", "high")
    (record,) = records(out)
    assert (record["sample_id"], record["status"]) == ("a", "ok")
    assert set(record["outputs"]) == {"render", "render.preview", "coc", "coc.preview"}
    for stamp in record["outputs"].values():
        assert stamp["size"] == (out / stamp["path"]).stat().st_size
        assert len(stamp["blake2b"]) == 32
    assert record["inputs"]["color"]["path"] == str(color)
    assert record["inputs"]["depth"]["size"] == depth.stat().st_size
    assert record["lens"]["focus_mm"] == 2000
    assert record["quality"] == "high"
    assert set(record["seconds"]) == {"read", "render", "write", "cpu"}
    assert record["size"] == [24, 16]
    assert str(out) not in json.dumps(record)


CHANGES = {
    "colour": (lambda c, d, o: color_exr(c / "b.exr", texture(seed=9)), ["b"]),
    "depth": (lambda c, d, o: depth_exr(d / "b.exr", ramp() + 1), ["b"]),
    "output cut": (lambda c, d, o: os.truncate(o / "b.exr", 100), ["b"]),
    "output gone": (lambda c, d, o: (o / "b.exr").unlink(), ["b"]),
    "output of as many bytes": (
        lambda c, d, o: (o / "b.exr").write_bytes((o / "b.exr").read_bytes()[::-1]),
        ["b"],
    ),
    "times alone": (lambda c, d, o: [os.utime(path) for path in (c / "a.exr", o / "b.exr")], []),
    "a picture gone": (lambda c, d, o: [(folder / "b.exr").unlink() for folder in (c, d)], []),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_redoes_its_job_alone_and_once(name, folders, out, computed):
    again(folders, out)
    computed.clear()
    change, redone = CHANGES[name]
    change(*folders, out / "coc")
    assert again(folders, out).code == 0
    again(folders, out)
    assert computed == redone


def test_bytes_that_hide_behind_size_and_time_are_found_if_asked(folders, out, computed):
    again(folders, out)
    path = folders[1] / "b.exr"
    before = path.stat()
    path.write_bytes(path.read_bytes()[:-4] + b"\0\0\0\0")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    computed.clear()
    again(folders, out, "--check-inputs", "stat")
    assert computed == []
    ran = again(folders, out, "--check-inputs", "hash")
    assert records(out)[-1]["sample_id"] == "b"
    assert ran.code in (0, 1)  # it may not be readable any more


def test_other_settings_redo_and_other_kinds_add(folders, out, computed):
    again(folders, out)
    render(*folders, "-o", out, "--outputs", "disparity")
    assert len(computed) == 6
    again(folders, out)
    assert len(computed) == 6, "both are known"
    assert "done again" in again(folders, out, "--quality", "high").err
    assert len(computed) == 9
    again(folders, out)
    assert len(computed) == 12, "the files are those of the last quality"


@pytest.mark.parametrize("link", [False, True])
def test_a_file_that_the_journal_does_not_know_is_refused(link, folders, out, computed):
    theirs = out / "coc" / "c.exr"
    theirs.parent.mkdir(parents=True)
    if link:
        theirs.symlink_to("/mnt/away/c.exr")
    else:
        theirs.write_text("mine")
    refused(again(folders, out), 3, "exists", "c.exr")
    assert computed == []
    assert (theirs.is_symlink(), link or theirs.read_text() == "mine") == (link, True)
    assert sorted(path.name for path in out.iterdir()) == ["coc"]
    assert again(folders, out, "--overwrite").code == 0
    assert not theirs.is_symlink()


PLAN = '{"jobs": {"c": 0}}'


def test_what_a_killed_run_had_begun_is_not_forgotten_by_the_next_that_is_killed(
    folders, out, monkeypatch
):
    again(folders, out)
    journal, run = out / "journal.jsonl", out / ".journal.run"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-1]))
    run.write_text(PLAN)

    def killed(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(pipeline, "execute", killed)
        assert again(folders, out).code == 130
    ran = again(folders, out)
    assert ran.code == 0, ran.err
    assert len(records(out)) == 3
    assert not run.exists()


def test_what_failed_is_tried_again(folders, out, computed):
    good = (folders[1] / "b.exr").read_bytes()
    depth_exr(folders[1] / "b.exr", -ramp())
    assert again(folders, out).code == 1
    assert [record["status"] for record in records(out)] == ["ok", "failed", "ok"]
    assert again(folders, out).code == 1
    (folders[1] / "b.exr").write_bytes(good)
    assert again(folders, out).code == 0
    assert computed == ["a", "c", "b"]


def test_another_picture_of_the_same_name_is_refused(tmp_path, out, computed):
    one, other = (pair(tmp_path / folder) for folder in ("one", "other"))
    color_exr(other[0], texture(seed=1))
    photograph(*one, "-o", out)
    refused(render(*other, "-o", out), 3, "exists", "a.exr")
    photograph(*other, "-o", out, "--overwrite")
    one[0].rename(tmp_path / "moved.exr")
    photograph(*other, "-o", out, "--quality", "high")
    assert computed == ["a", "a", "a"]


def with_renderer(out, version):
    """A journal whose records are of an earlier renderer."""
    path = out / "journal.jsonl"
    text = path.read_text()
    path.write_text(re.sub(r'"renderer":\d+', f'"renderer":{version}', text))


def test_why_a_job_is_done_again_is_counted_by_reason(tmp_path, out, computed):
    path = jobs_file(tmp_path, *"abcde")
    run("batch", path, "-o", out, "--processes", "1")
    with_renderer(out, 7)
    color_exr(tmp_path / "rgb" / "a.exr", texture(seed=9))
    (out / "coc" / "b_focus2m.exr").unlink()
    path.write_text(path.read_text().replace('"1.5m", "2m"', '"1.5m", "2m", "3m"'))
    reasons = {f"renderer 7 → {RENDERER_VERSION}": 7, "inputs changed": 2}
    reasons |= {"outputs gone or changed": 1}
    words = ("done again: ", *(f"{reason} ({count})" for reason, count in reasons.items()))
    planned = run("batch", path, "-o", out, "--dry-run")
    assert all(word in planned.out for word in words)
    assert run("batch", path, "-o", out, "--dry-run", "--json").json["again"] == reasons
    computed.clear()
    ran = succeed("batch", path, "-o", out, "--processes", "1", "--new-only", "--json")
    assert {*computed} == {"b_focus2m", *(f"{stem}_focus3m" for stem in "abcde")}
    kept = {f"renderer 7 → {RENDERER_VERSION}": 7, "inputs changed": 2}
    assert (ran.json["kept"], ran.json["again"]) == (kept, {"outputs gone or changed": 1})
    computed.clear()
    ran = succeed("batch", path, "-o", out, "--processes", "1")
    assert len(computed) == 9
    path.write_text(path.read_text().replace("fnumber = 2", "fnumber = 4"))
    assert "done again: settings changed (15)" in succeed("batch", path, "-o", out).err


def test_what_a_kill_left_of_the_index_and_of_shards_is_removed_by_the_next_run(folders, out):
    again(folders, out)
    dead = subprocess.Popen(["true"])
    dead.wait()
    (out / "shards").mkdir()
    left = (f".metadata.jsonl.{dead.pid}.0.tmp", f"shards/.samples-000000.tar.{dead.pid}.1.tmp")
    written_now = out / f".metadata.jsonl.{os.getppid()}.0.tmp"
    for path in (out / left[0], out / left[1], written_now):
        path.write_text("half")
    again(folders, out)
    assert not any((out / name).exists() for name in left)
    assert written_now.exists(), "its process runs"

"""``defocus batch``: many jobs, whatever stops them."""

import json
import tarfile
from pathlib import Path

import pytest
from batches import JOBS, contents, jobs_file, records, without_times
from command_line import depth_exr, files_under, hidden_in, ramp, refused, run, succeed

from defocus_core import samples
from defocus_core.batch.datasets.sample_index import tar_line
from defocus_core.batch.journal.runs import locked

NAMES = [f"{stem}_focus{focus}" for stem in "ab" for focus in ("1.5m", "2m")]


def test_each_picture_is_taken_by_each_lens_and_indexed(tmp_path, out):
    ran = succeed("batch", jobs_file(tmp_path), "-o", out)
    assert ran.out == ""
    assert ran.err.startswith("4 jobs: 4 done; ")
    wanted = {f"coc/{name}.exr" for name in NAMES} | {"README.md", "jobs.toml", "metadata.jsonl"}
    assert files_under(out) == wanted
    assert [sample.sample_id for sample in samples(out)] == NAMES
    assert not hidden_in(out), "no lock and no note is left"


def test_a_batch_is_the_same_whoever_does_it(tmp_path, out, in_processes):
    path = jobs_file(tmp_path)
    run("batch", path, "-o", tmp_path / "here")
    in_processes()
    succeed("batch", path, "-o", out, "--processes", "1")
    assert contents(out) == contents(tmp_path / "here")
    assert without_times(out) == without_times(tmp_path / "here")


def test_many_equal_errors_are_told_once(tmp_path, out):
    path = jobs_file(tmp_path, *"abcdef")
    for stem in "abcdef":
        depth_exr(tmp_path / "depth" / f"{stem}.exr", -ramp())
    ran = run("batch", path, "-o", out)
    assert ran.code == 1
    assert len([line for line in ran.err.splitlines() if "depth/" in line]) == 5, ran.err
    assert "defocus: 12 of 12 jobs failed (input-unusable 12)" in ran.err
    assert len(records(out)) == 12
    assert run("status", out, "--json").json["failed"] == 12


def test_fail_fast_stops_at_the_first(tmp_path, out):
    path = jobs_file(tmp_path, *"abcdefgh")
    depth_exr(tmp_path / "depth" / "a.exr", -ramp())
    ran = run("batch", path, "-o", out, "--fail-fast")
    assert ran.code == 1
    assert len(records(out)) < 8
    assert " left " in ran.err
    assert run("batch", path, "-o", out, "--keep-going").code == 1
    assert run("status", out, "--json").json["ok"] == 14


def test_a_limit_leaves_the_rest_for_later(tmp_path, out):
    path = jobs_file(tmp_path)
    assert run("batch", path, "-o", out, "--limit", "3").err.startswith("4 jobs: 3 done, 1 left; ")
    told = run("status", out, "--json").json
    assert (told["ok"], told["left"], told["jobs"]) == (3, 1, 4)
    assert "not running; run the same command again" in run("status", out).out
    assert run("batch", path, "-o", out).err.splitlines()[-1].startswith("4 jobs: 1 done, 3 done b")
    assert run("status", out, "--json").json["left"] == 0


def test_a_contact_sheet_shows_what_is_done_to_one_who_asks_later(tmp_path, out):
    path = jobs_file(tmp_path, text=JOBS.replace('"coc"', '"render"'))
    run("batch", path, "-o", out)
    assert not (out / "contact.png").exists()
    told = run("batch", path, "-o", out, "--contact", "2", "--json").json
    assert str(out / "contact.png") in told["written"]
    for dry in ((), ("--dry-run",)):
        maps = run("batch", jobs_file(tmp_path), "-o", out, "--contact", "2", *dry)
        refused(maps, 2, "idle-option")


def test_a_limit_overlooks_no_file_that_a_later_job_would_replace(tmp_path, out):
    (out / "coc").mkdir(parents=True)
    (out / "coc" / "b_focus2m.exr").write_text("somebody's own")
    for _ in range(2):
        ran = run("batch", jobs_file(tmp_path), "-o", out, "--limit", "1")
        refused(ran, 3, "exists", "b_focus2m.exr")
    assert (out / "coc" / "b_focus2m.exr").read_text() == "somebody's own"


@pytest.mark.parametrize("moved", ["out", "rgb"])
def test_where_the_inputs_are_is_said_anew_when_files_have_moved(moved, tmp_path, out, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = jobs_file(Path(), "a", "b", "c")
    run("batch", path, "-o", "out")
    before = records(out)
    if moved == "out":
        out = tmp_path / "some" / "where"
        out.parent.mkdir()
        (tmp_path / "out").rename(out)
    else:
        Path("rgb").rename("color")
        path.write_text(JOBS.replace("rgb/", "color/"))
    assert run("batch", path, "-o", out).err.endswith("6 jobs: 6 done before\n")
    for sample in samples(out):
        assert sample.inputs["color"].exists()
        assert sample.inputs["depth"].exists()
    told = [record["finished"] for record in records(out)]
    assert told == 2 * [record["finished"] for record in before]
    run("batch", path, "-o", out)
    assert len(records(out)) == len(told), "once is enough"
    assert run("status", out, "--json").json["jobs"] == 6


def test_a_sample_made_anew_with_fewer_kinds_is_indexed_once(tmp_path, out):
    path = jobs_file(tmp_path, "a", text=JOBS.replace('"coc"', '"coc", "disparity"'))
    run("batch", path, "-o", out)
    path.write_text(JOBS.replace("fnumber = 2", "fnumber = 4"))
    run("batch", path, "-o", out)
    assert [(one.sample_id, one.lens.fnum) for one in samples(out)] == [(n, 4) for n in NAMES[:2]]
    assert {kind for one in samples(out) for kind in one.files} == {"coc"}


def test_the_index_lists_what_the_batch_asks_for_and_after_a_merge_all(tmp_path, out):
    path = jobs_file(tmp_path)
    run("batch", path, "-o", out)
    depth_exr(tmp_path / "depth" / "b.exr", -ramp())
    path.write_text(JOBS.replace('"2m"', '"3m"'))
    run("batch", path, "-o", out, "--shards-size", "1MB")
    assert [one.sample_id for one in samples(out)] == ["a_focus1.5m", "a_focus3m"]
    depth_exr(tmp_path / "depth" / "b.exr")
    succeed("batch", path, "-o", out)
    now = [f"{stem}_focus{focus}" for stem in "ab" for focus in ("1.5m", "3m")]
    assert [one.sample_id for one in samples(out)] == now
    run("merge", out)
    assert [one.sample_id for one in samples(out)] == sorted({*now, *NAMES})


def test_a_second_batch_on_the_same_directory_is_refused(tmp_path, out):
    path = jobs_file(tmp_path)
    out.mkdir()
    with locked(out):
        refused(run("batch", path, "-o", out), 3, "in-use", ".journal.lock")
        refused(run("merge", out), 3, "empty", out)
    assert files_under(out) == set()


def test_a_dry_run_says_what_is_to_do_and_does_nothing(tmp_path, out):
    path = jobs_file(tmp_path)
    ran = succeed("batch", path, "-o", out, "--dry-run")
    assert "0 jobs done before, 4 to do" in ran.out
    assert "4 files to write" in ran.out
    assert "MB of memory" in ran.out
    assert not out.exists()
    run("batch", path, "-o", out, "--limit", "1")
    told = run("batch", path, "-o", out, "--dry-run", "--limit", "2", "--json").json
    assert (told["done_before"], told["todo"], told["beyond_limit"]) == (1, 2, 1)
    assert [sample["stem"] for sample in told["pictures"]] == NAMES[1:3]
    assert "would read" in run("batch", path, "-o", out, "--dry-run", "-v").out


def test_shards_hold_what_the_index_lists_if_asked_for_again(tmp_path, out):
    path = jobs_file(tmp_path)
    run("batch", path, "-o", out, "--shards-size", "1GB")
    tar = out / "shards" / "samples-000000.tar"
    first = tar.read_bytes()
    assert "may hold other samples" not in run("batch", path, "-o", out).err
    assert tar.read_bytes() == first

    def whole():
        with tarfile.open(tar) as files:
            found = {name: files.extractfile(name) for name in files.getnames()}
            lines = [file.read() for name, file in found.items() if file and "json" in name]
        index = map(json.loads, (out / "metadata.jsonl").read_text().splitlines())
        return lines == [tar_line(entry) for entry in index]

    depth_exr(tmp_path / "depth" / "b.exr", 2 * ramp())
    for words in (("batch", path, "-o", out), ("merge", out)):
        ran = succeed(*words)
        assert f"{tar.parent}: warning: may hold other samples than metadata.jsonl; --sh" in ran.err
        assert not whole()
        ran = succeed(*words, "--shards-size", "1GB", "--json")
        assert str(tar) in ran.json["written"]
        assert whole()
        path.write_text(JOBS.replace('"1.5m", "2m"', '"3m"'))
        run("batch", path, "-o", out)


def test_a_scheduler_that_is_none_is_refused(tmp_path, out, monkeypatch):
    path = jobs_file(tmp_path)
    refused(run("batch", path, "-o", out, "--scheduler", "head"), 2, "malformed", "scheduler")
    monkeypatch.setattr("defocus_core.batch.workers.dask_pool.find_spec", lambda name: None)
    ran = run("batch", path, "-o", out, "--scheduler", "tcp://127.0.0.1:1")
    refused(ran, 2, "needs-extra", "scheduler")
    assert not out.exists()

"""``defocus batch`` with sweeps and draws, up to what a training script reads."""

import json

import pytest
from command_line import files_under, refused, run, succeed
from jobs_files import FIXED, INPUTS, LENS, SAMPLE, pictures

from defocus_cli.words import dry_run
from defocus_core.batch.datasets.finished import samples

DRAFT = '\n[machine]\nquality = "draft"\n'


def batch(folder, text, *options):
    path = folder / "jobs.toml"
    path.write_text(f"[inputs]\n{INPUTS}\n{text}{DRAFT}")
    return run("batch", path, "-o", folder / "out", "--processes", "1", *options)


def test_a_sweep_is_the_renders_that_it_stands_for(tmp_path):
    pictures(tmp_path)
    assert batch(tmp_path, LENS + '[sweep]\nfnumber = [2, 4]\nfocus = ["1m", "inf"]\n').code == 0
    single = ("--focal-length", "50mm", "--fnumber", "4", "--focus", "inf", "--quality", "draft")
    files = (tmp_path / "a_rgb.exr", tmp_path / "a_z.exr")
    succeed("render", *files, "-o", tmp_path / "one", *single)
    swept = tmp_path / "out" / "render" / "a_f4_focusinf.exr"
    assert swept.read_bytes() == (tmp_path / "one" / "render" / "a_rgb.exr").read_bytes()
    assert len(files_under(tmp_path / "out" / "render")) == 8


@pytest.mark.parametrize(("more", "counts"), [((), (40, 0)), (("--shard", "2/2"), (20, 0))])
def test_some_jobs_stand_for_a_large_batch(tmp_path, monkeypatch, more, counts):
    monkeypatch.setattr(dry_run, "MAX_PLANNED", 12)
    monkeypatch.setattr(dry_run, "LOOKED_AT", 8)
    pictures(tmp_path)
    text = LENS + SAMPLE.replace("n = 4", "n = 20")
    told = batch(tmp_path, text, "--dry-run", "--json", *more).json
    assert (told["todo"], told["done_before"]) == counts
    assert told["looked_at"] == len(told["samples"]) == 8
    assert told["forecast"]["pictures"] == counts[0]
    words = batch(tmp_path, text, "--dry-run", *more).out
    assert words.startswith(f"of 8 of {counts[0]} jobs")


def test_some_jobs_tell_how_many_are_done_and_left(tmp_path, monkeypatch):
    monkeypatch.setattr(dry_run, "MAX_PLANNED", 9)
    monkeypatch.setattr(dry_run, "LOOKED_AT", 10)
    pictures(tmp_path)
    text = LENS + SAMPLE.replace("n = 4", "n = 10").replace('"render", ', "")
    batch(tmp_path, text, "--shard", "1/2")
    told = batch(tmp_path, text, "--dry-run", "--json", "--limit", "6").json
    assert (told["done_before"], told["todo"], told["beyond_limit"]) == (10, 6, 4)


def test_names_of_a_large_batch_that_two_jobs_share_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(dry_run, "MAX_PLANNED", 3)
    monkeypatch.setattr(dry_run, "LOOKED_AT", 2)
    pictures(tmp_path)
    files = {"color": "a_rgb.exr", "depth": "a_z.exr"}
    stems = [{**files, "stem": stem} for stem in ("a", "a_mirror0.4", "c")]
    (tmp_path / "list.jsonl").write_text("".join(f"{json.dumps(row)}\n" for row in stems))
    sweep = "lenses = [{squeeze = 2, obstruction = 0.4}, {squeeze = 2}]\n"
    path = tmp_path / "jobs.toml"
    path.write_text(f'[inputs]\nlist = "list.jsonl"\n{FIXED}[sweep]\n{sweep}')
    refused(
        run("batch", path, "-o", tmp_path / "out", "--dry-run"),
        3,
        "duplicate",
        "a_mirror0.4_squeeze2.exr",
    )


def test_an_index_tells_of_the_lens_that_took_a_picture_last(tmp_path):
    pictures(tmp_path)
    out = tmp_path / "out"
    batch(tmp_path, LENS + 'fnumber = 2\nfocus = "2m"\n', "--shards-size", "1MB")
    index, words = out / "metadata.jsonl", ("--focal-length", "50mm", "--focus", "2m")
    first = index.read_bytes()

    def rendered(name, *more):
        color, depth = (tmp_path / f"a_{kind}.exr" for kind in ("rgb", "z"))
        if name != "a_rgb":
            color = color.rename(tmp_path / f"{name}.exr")
        lens = (*words, "--fnumber", "4", "--overwrite")
        ran = succeed("render", color, depth, "-o", out, *lens, *more)
        return ran.err

    assert "written again" not in rendered("a_rgb"), "another sample"
    assert index.read_bytes() == first
    told = rendered("a", "--quality", "draft")
    assert f"{index}: written again, as it lists samples that were done now" in told
    assert f"{out / 'shards'}: packed again" in told
    assert [sample.lens.fnum for sample in samples(out)] == [4, 2]

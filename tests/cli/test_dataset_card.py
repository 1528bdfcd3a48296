"""A finished batch is a dataset that stands by itself: inputs, splits, and a card."""

import json
import os
import tarfile
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from batches import contents, jobs_file
from command_line import depth_exr, pair, ramp, read_exr, refused, run, succeed
from refusals import refuses

from defocus_core import BatchDataset, run_batch, samples

JOBS = """
[inputs]
color = "*_rgb.exr"
depth = "*_z.exr"
[split]
train = 0.5
test = 0.5
[lens]
focal-length = "50mm"
focus = "2m"
[sweep]
fnumber = [2, 4]
[outputs]
kinds = ["render", "coc"]
format = "png"
map-format = "tiff"
inputs = "copy"
[machine]
quality = "high"
"""


RENDERED = ("--fnumber", "2", "--focal-length", "50mm", "--focus", "2m", "--outputs", "coc", "-o")


@pytest.fixture
def folder(tmp_path):
    for name in "abcd":
        color, depth = pair(tmp_path / name)
        color.rename(tmp_path / f"{name}_rgb.exr")
        depth.rename(tmp_path / f"{name}_z.exr")
    (tmp_path / "jobs.toml").write_text(JOBS)
    return tmp_path


def batch(folder, *words):
    succeed("batch", folder / "jobs.toml", "-o", folder / "out", *words)


def entries(folder):
    lines = (folder / "out" / "metadata.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


def test_the_sharp_picture_and_its_depth_stand_beside_the_outputs(folder):
    batch(folder, "--shards-size", "1GB")
    for entry in entries(folder):
        names = {key for key in entry if key.endswith("file_name")}
        assert names == {f"{kind}_file_name" for kind in ("render", "coc", "image", "depth")}
        name = entry["sample_id"][0]
        metres = read_exr(folder / f"{name}_z.exr")["Z"]
        written = oiio.ImageBuf(str(folder / "out" / entry["depth_file_name"]))
        assert str(written.spec().format) == "float"
        assert np.array_equal(written.get_pixels()[..., 0], metres)
    members = {
        member
        for path in (folder / "out" / "shards").glob("*.tar")
        for member in tarfile.open(path).getnames()  # noqa: SIM115
    }
    assert sum(member.endswith(("image.png", "depth.tif")) for member in members) == 16


def test_a_picture_is_in_one_split_with_all_its_lenses(folder):
    batch(folder, "--shards-size", "1GB")
    splits: dict[str, set[str]] = {}
    for entry in entries(folder):
        splits.setdefault(entry["sample_id"][0], set()).add(entry["split"])
    assert all(len(split) == 1 for split in splits.values())
    shards = {path.name for path in (folder / "out" / "shards").glob("*.tar")}
    every = {split for found in splits.values() for split in found}
    assert shards == {f"{split}set-000000.tar" for split in every}


def test_other_shares_render_nothing_again(folder):
    batch(folder)
    before = (folder / "out" / "render").stat().st_mtime_ns
    (folder / "jobs.toml").write_text(JOBS.replace("train = 0.5\ntest = 0.5", "all = 1.0"))
    batch(folder)
    assert {entry["split"] for entry in entries(folder)} == {"all"}
    assert [path.name for path in (folder / "out").glob("*set.jsonl")] == ["allset.jsonl"]
    assert (folder / "out" / "render").stat().st_mtime_ns == before


def test_the_card_is_a_head_as_hugging_face_has_it(folder):
    batch(folder)
    text = (folder / "out" / "README.md").read_text()
    head = pytest.importorskip("yaml").safe_load(text.split("---\n")[1])
    assert (head["size_categories"], head["tags"][0]) == (["n<1K"], "depth-of-field")


def test_a_readme_of_somebody_elses_stays(folder):
    batch(folder, "--limit", "1")
    readme = folder / "out" / "README.md"
    assert readme.read_text().startswith("---\n# Written by defocus; without")
    readme.write_text("---\nlicense: mit\n---\n")
    ran = run("batch", folder / "jobs.toml", "-o", folder / "out")
    assert f"{readme}: was not written by a batch and is kept" in ran.err
    assert "mit" in readme.read_text()


def test_an_index_that_is_true_stays_and_any_other_is_written_again(tmp_path, out):
    path = jobs_file(tmp_path)
    run("batch", path, "-o", out)
    index, before = out / "metadata.jsonl", contents(out)
    os.utime(index, (1, 1))
    assert run("batch", path, "-o", out).code == 0
    assert index.stat().st_mtime == 1
    for change in (Path.unlink, lambda path: path.write_text(path.read_text().partition("\n")[2])):
        change(index)
        run("batch", path, "-o", out)
        assert contents(out) == before
    path.write_text(path.read_text() + '[dataset]\nlicence = "MIT"\n')
    run("batch", path, "-o", out)
    assert {json.loads(line)["licence"] for line in index.read_text().splitlines()} == {"MIT"}


def test_readers_of_a_batch_that_was_cut_off_are_told_what_to_do(tmp_path, out):
    path = jobs_file(tmp_path)
    run("batch", path, "-o", out)
    before = contents(out)
    depth_exr(tmp_path / "depth" / "a.exr", 2 * ramp())
    with pytest.raises(KeyboardInterrupt):
        run_batch(path, out, ended=_interrupted)
    assert not list(out.glob("*a.jsonl"))
    for read in (lambda: [*samples(out)], lambda: BatchDataset(out, ["coc"])):
        with refuses("not-found", f"batch again, 'defocus status {out}' says what is left"):
            read()
    succeed("render", tmp_path / "rgb", tmp_path / "depth", *RENDERED, out)
    assert not (out / "metadata.jsonl").exists(), "it is that of the batch"
    succeed("batch", path, "-o", out)
    assert contents(out).keys() == before.keys() | {"coc/a.exr", "coc/b.exr"}
    index = (out / "metadata.jsonl").read_bytes()
    succeed("render", tmp_path / "rgb", tmp_path / "depth", *RENDERED, out, "--overwrite")
    assert (out / "metadata.jsonl").read_bytes() == index, "an index that is there is written again"


def _interrupted(*_):
    raise KeyboardInterrupt


FOREIGN = ("metadata.jsonl", "trainset.jsonl")
FOREIGN_TAR = "shards/trainset-000007.tar"


@pytest.mark.parametrize("name", [*FOREIGN, FOREIGN_TAR])
def test_a_data_set_of_others_stays_as_it_is(name, folder):
    theirs = folder / "out" / name
    theirs.parent.mkdir(parents=True)
    theirs.write_text('{"file_name": "1.png", "text": "a cat"}\n')
    for words in ((), ("--overwrite",), ("--dry-run",)):
        jobs = (folder / "jobs.toml", "-o", folder / "out", "--shards-size", "1GB", *words)
        refused(run("batch", *jobs), 3, "exists", theirs)
    assert list(contents(folder / "out")) == [name]
    kept = theirs.rename(folder / "theirs")
    batch(folder, "--shards-size", "1GB")
    theirs.write_bytes(kept.read_bytes())
    words = ("merge", folder / "out", "--shards-size", "1GB")
    refused(run(*words), 3, "exists", theirs)
    assert theirs.read_bytes() == kept.read_bytes()


@pytest.mark.parametrize("edit", [None, "[dataset]\nlicence = 'MIT'\n"])
def test_the_jobs_file_is_read_once(edit, folder):
    jobs = folder / "jobs.toml"
    before = jobs.read_bytes()

    def edited(*_):
        jobs.unlink(missing_ok=True)
        if edit is not None:
            jobs.write_text(edit + JOBS)

    run_batch(jobs, folder / "out", ended=edited)
    assert (folder / "out" / "jobs.toml").read_bytes().endswith(b"\n" + before)
    assert {entry["licence"] for entry in entries(folder)} == {None}


def test_samples_that_tars_cannot_tell_apart_are_refused_before_the_batch(folder):
    for name in ("a.1", "a_1"):
        for of in ("rgb", "z"):
            (folder / f"{name}_{of}.exr").write_bytes((folder / f"a_{of}.exr").read_bytes())
    words = ("batch", folder / "jobs.toml", "-o", folder / "out")
    for more in ((), ("--dry-run",)):
        refused(run(*words, "--shards-size", "1GB", *more), 3, "duplicate", folder / "out")
    assert not (folder / "out").exists()
    succeed(*words)

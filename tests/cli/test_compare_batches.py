"""``defocus compare`` of two finished batches: recipes first, then pixels, sample by sample."""

import shutil
from pathlib import Path

import pytest
from command_line import color_exr, depth_exr, ramp, refused, run, succeed, texture

JOBS = """[inputs]
color = "{folder}/rgb/*.exr"
depth = "{folder}/z/*.exr"
[lens]
focal-length = "50mm"
fnumber = {fnumber}
focus = "2m"
[outputs]
kinds = ["render", "coc"]
format = "{format}"
"""


def batch(folder, out, fnumber=2.0, *, format="exr"):
    """A finished batch of the pictures in a folder."""
    jobs = folder / f"{out}.toml"
    jobs.write_text(JOBS.format(folder=folder, fnumber=fnumber, format=format))
    succeed("batch", jobs, "-o", folder / out, "--processes", "1")
    return folder / out


def inputs(folder):
    for seed, name in enumerate("ab"):
        color_exr(folder / "rgb" / f"{name}.exr", texture(seed=seed))
        depth_exr(folder / "z" / f"{name}.exr")
    return folder


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder of inputs, a batch of them, and another by another lens."""
    folder = inputs(tmp_path_factory.mktemp("made"))
    return folder, batch(folder, "one"), batch(folder, "two", 2.8)


def copied(folder, name):
    return Path(shutil.copytree(folder, name))


def test_batches_of_one_recipe_are_the_same(made):
    folder, one, _ = made
    ran = succeed("compare", one, batch(folder, "again"))
    assert ran.out.splitlines() == [
        "recipes: alike in all 2 samples that both batches have",
        "4 pairs: 4 same",
    ]


def test_recipes_that_differ_come_before_the_pixels(made, tmp_path):
    _, one, two = made
    depth_exr(inputs(tmp_path) / "z" / "b.exr", ramp() + 1)
    three = batch(tmp_path, "three", 2.8)
    lines = run("compare", one, two, "--html", tmp_path / "r.html").out.splitlines()
    assert lines[0] == "recipe: lens.fnum 2.8 instead of 2.0 in 2 of 2 samples"
    assert "lens.fnum 2.8 instead of 2.0" in (tmp_path / "r.html").read_text()
    assert [line.split(":")[0] for line in lines[1:]] == [
        *("coc/a.exr", "coc/b.exr", "render/a.exr", "render/b.exr"),
        "4 pairs",
    ]
    lines = run("compare", one, three).out.splitlines()
    assert lines[1] == "recipe: other bytes of the input depth in 1 of 2 samples"
    document = run("compare", one, three, "--json").json
    assert document["recipes"] == [
        {"what": "lens.fnum", "a": "2.0", "b": "2.8", "samples": 2, "shared": 2},
        {"what": "input depth", "a": "", "b": "", "samples": 1, "shared": 2},
    ]


def test_samples_pair_whatever_their_format(made):
    folder, one, _ = made
    two = batch(folder, "png", format="png16")
    document = run("compare", one, two, "--fail", "psnr<40", "--fail", "max>0", "--json").json
    names = {pair["name"]: Path(pair["b"]).suffix for pair in document["pairs"]}
    assert names["render/a.exr"] == ".png"
    assert names["coc/a.exr"] == ".exr"
    assert document["recipes"][0]["what"] == "outputs.format"


def test_samples_and_files_that_one_batch_lacks_are_a_difference(made, tmp_path):
    inputs(tmp_path)
    for name in ("rgb", "z"):
        (tmp_path / name / "b.exr").rename(tmp_path / name / "c.exr")
    color_exr(tmp_path / "rgb" / "c.exr", texture(seed=7))
    two = batch(tmp_path, "two")
    (two / "coc" / "a.exr").unlink()
    ran = run("compare", made[1], two)
    assert ran.code == 1
    assert [line.split(": ")[:2] for line in ran.out.splitlines()][1:-1] == [
        ["coc/a.exr", "MISSING"],
        ["coc/b.exr", "MISSING"],
        ["coc/c.exr", "EXTRA"],
        ["render/b.exr", "MISSING"],
        ["render/c.exr", "EXTRA"],
    ]


def test_a_directory_without_a_journal_pairs_by_path(made, tmp_path):
    for kind in ("render", "coc"):
        copied(made[1] / kind, tmp_path / kind)
    ran = run("compare", made[1], tmp_path)
    assert (ran.code, ran.out) == (0, "4 pairs: 4 same\n")


def test_a_journal_that_cannot_be_read_is_refused(made, tmp_path):
    one, two = (copied(made[1], tmp_path / name) for name in ("one", "two"))
    (two / "journal.jsonl").write_text('{"sample_id": "a"}\n{}\n')
    refused(run("compare", one, two), 3, "damaged", "journal.jsonl")
    for folder in (one, two):
        (folder / "journal.jsonl").write_text("")
    refused(run("compare", one, two), 3, "empty", one)

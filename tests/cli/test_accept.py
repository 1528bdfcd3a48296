"""``defocus compare --accept``: the life of goldens, the pictures of a batch that were accepted."""

import json
import shutil

import numpy as np
import pytest
from command_line import failed, files_under, read_exr, refused, run, succeed, write_exr
from jobs_files import FIXED, INPUTS, jobs_file, pictures

PICTURES = {"render/a.exr", "render/b.exr"}
RECIPES = {"a.recipe.json", "b.recipe.json"}


def rendered(jobs, name="new", **changes):
    text = jobs.read_text()
    for old, new in changes.items():
        text = text.replace(f"{old} = 2", f"{old} = {new}")
    jobs.with_name(f"{name}.toml").write_text(text)
    out = jobs.parent / name
    words = ("--processes", "1", "--threads", "1")
    succeed("batch", jobs.with_name(f"{name}.toml"), "-o", out, *words)
    return out


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Jobs, a batch of them, and what was accepted of it."""
    folder = tmp_path_factory.mktemp("made")
    pictures(folder)
    jobs = jobs_file(folder, FIXED, inputs=INPUTS)
    ran = run("compare", folder / "goldens", rendered(jobs), "--like", "golden", "--accept")
    assert (
        ran.out.splitlines()[-1] == f"{folder / 'goldens'}: 2 files accepted from {folder / 'new'}"
    )
    assert ran.code == 0, ran.err
    return jobs


@pytest.fixture
def jobs(made, tmp_path):
    shutil.copytree(made.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / made.name


@pytest.fixture
def goldens(jobs):
    return jobs.parent / "goldens"


def compare(goldens, new, *words):
    return run("compare", goldens, new, "--like", "golden", *words)


def test_accepted_pictures_are_those_of_the_batch_with_their_recipes(jobs, goldens):
    assert files_under(goldens) == PICTURES | RECIPES
    ran = compare(goldens, jobs.parent / "new")
    assert ran.code == 0
    assert ran.out.splitlines()[0] == "recipes: alike in all 2 samples that both batches have"
    recipe = json.loads((goldens / "a.recipe.json").read_text())
    assert recipe["settings"]["lens"]["fnum"] == 2.0
    assert recipe["files"] == {"render": "render/a.exr"}


def test_settings_that_changed_are_told_until_they_are_accepted(jobs, goldens):
    new = rendered(jobs, "other", fnumber=1.4)
    ran = compare(goldens, new, "--accept", "--only", "render/b.exr")
    assert ran.out.splitlines()[0] == "recipe: lens.fnum 1.4 instead of 2.0 in 1 of 1 samples"
    assert "1 file accepted" in ran.out
    left = compare(goldens, new, "--json").json
    assert [pair["status"] for pair in left["pairs"]] == ["different", "same"]
    assert [each["samples"] for each in left["recipes"]] == [1]
    assert compare(goldens, new, "--accept").code == 0
    assert compare(goldens, new).out.startswith("recipes: alike in all 2")


def test_only_needs_a_picture_that_it_matches(jobs, goldens):
    ran = compare(goldens, jobs.parent / "new", "--only", "render/x.exr")
    refused(ran, 2, "empty", "only")


def test_what_passes_stays_and_what_is_missing_is_told(jobs, goldens):
    before = (goldens / "render" / "a.exr").read_bytes()
    (goldens / "render" / "b.exr").unlink()
    new = jobs.parent / "new"
    assert "render/b.exr: EXTRA" in compare(goldens, new).out
    planes = read_exr(new / "render" / "a.exr")
    rounded = {n: np.nextafter(plane, np.float16(9)) for n, plane in planes.items()}
    write_exr(new / "render" / "a.exr", **rounded)
    assert compare(goldens, new, "--accept").code == 0
    assert (goldens / "render" / "a.exr").read_bytes() == before
    (new / "render" / "b.exr").unlink()
    ran = compare(goldens, new, "--accept")
    assert (ran.code, "render/b.exr: MISSING" in ran.out) == (1, True)
    assert (goldens / "render" / "b.exr").exists()


def test_a_golden_of_another_format_replaces_no_file_of_its_name(jobs, goldens):
    jobs.write_text(jobs.read_text() + '[outputs]\nformat = "tiff"\n')
    theirs, new = goldens / "render" / "a.tif", rendered(jobs, "other", fnumber=1.4)
    theirs.write_text("mine")
    failed(compare(goldens, new, "--accept"), 3, "exists", theirs)
    assert theirs.read_text() == "mine"
    theirs.unlink()
    for _ in range(2):
        assert compare(goldens, new, "--accept").code == 0


def test_a_conflict_of_a_merge_is_told_and_a_pointer_is_never_accepted(jobs, goldens):
    new = jobs.parent / "new"
    (goldens / "a.recipe.json").write_text("<<<<<<< ours\n{}\n=======\n{}\n>>>>>>> theirs\n")
    ran = compare(goldens, new)
    refused(ran, 3, "damaged", "a.recipe.json")
    assert "resolve the merge conflict" in ran.err
    (goldens / "a.recipe.json").unlink()
    before = (goldens / "render" / "b.exr").read_bytes()
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
    (new / "render" / "b.exr").write_text(pointer)
    assert "UNREADABLE" in compare(goldens, new, "--accept").out
    assert (goldens / "render" / "b.exr").read_bytes() == before


def test_a_full_disk_while_accepting_leaves_the_old_goldens(jobs, goldens, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    new = rendered(jobs, "other", fnumber=1.4)
    before = {name: (goldens / name).read_bytes() for name in files_under(goldens)}
    monkeypatch.setattr("shutil.copyfileobj", full)
    assert compare(goldens, new, "--accept").code == 3
    assert {name: (goldens / name).read_bytes() for name in files_under(goldens)} == before


def test_an_input_that_was_renamed_is_one_picture_which_moves(jobs, goldens):
    for role in ("rgb", "z"):
        (jobs.parent / f"b_{role}.exr").rename(jobs.parent / f"c_{role}.exr")
    new = rendered(jobs, "other")
    ran = compare(goldens, new)
    assert "render/c.exr: DIFFERENT: renamed from render/b.exr" in ran.out
    assert ran.out.splitlines()[-1] == "2 pairs: 1 same, 1 different"
    assert compare(goldens, new, "--accept").code == 0
    pictures = {"render/a.exr", "render/c.exr"}
    assert files_under(goldens) == pictures | {"a.recipe.json", "c.recipe.json"}
    assert compare(goldens, new).code == 0


def test_a_picture_that_was_renamed_moves(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    for folder, name in ((a, "old"), (b, "sub/new")):
        (folder / name).parent.mkdir(parents=True)
        write_exr(folder / f"{name}.exr", R=np.ones((4, 4), np.float16))
    ran = run("compare", a, b, "--accept")
    assert "sub/new.exr: DIFFERENT: renamed from old.exr" in ran.out
    assert files_under(a) == {"sub/new.exr"}


def test_further_pictures_are_accepted_beside_a_golden(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    for folder, name, value in ((a, "x", 1), (a, "x.1", 2), (b, "x", 2)):
        folder.mkdir(exist_ok=True)
        write_exr(folder / f"{name}.exr", R=np.full((4, 4), value, np.float16))
    ran = run("compare", a, b, "-v")
    assert (ran.code, ran.out.splitlines()[0]) == (0, "x.exr: same: noted: as x.1.exr")
    write_exr(b / "x.1.exr", R=np.full((4, 4), 2, np.float16))  # frames
    assert run("compare", a, b).code == 1

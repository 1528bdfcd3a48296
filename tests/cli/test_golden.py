"""``defocus golden``: accepted pictures are kept and checked."""

import json
import shutil

import numpy as np
import pytest
from command_line import color_exr, files_under, read_exr, refused, run, texture, write_exr
from html_reports import item
from jobs_files import FIXED, INPUTS, jobs_file, pictures

PICTURES = {"render/a.exr", "render/b.exr"}
RECORDS = {"a.golden.json", "b.golden.json"}


@pytest.fixture(scope="module")
def accepted(tmp_path_factory):
    """Jobs with their pictures and accepted goldens."""
    folder = tmp_path_factory.mktemp("accepted")
    pictures(folder)
    jobs = jobs_file(folder, FIXED, inputs=INPUTS)
    assert golden("update", jobs, folder / "goldens", "--accept").code == 0
    return jobs


@pytest.fixture
def jobs(accepted, tmp_path):
    shutil.copytree(accepted.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / accepted.name


@pytest.fixture
def goldens(jobs):
    return jobs.parent / "goldens"


def golden(*words):
    return run("golden", *words, "--processes", "1", "--threads", "1")


def brighten(path, amount):
    planes = {name: plane + np.float16(amount) for name, plane in read_exr(path).items()}
    write_exr(path, **planes)


def test_update_shows_what_would_change_and_writes_only_what_is_accepted(jobs, tmp_path):
    folder = tmp_path / "new"
    ran = golden("update", jobs, folder)
    assert ran.code == 1
    assert [line.split(":")[0] for line in ran.out.splitlines()[:2]] == ["new", "new"]
    assert "2 would change; --accept" in ran.out
    assert not folder.exists()
    assert golden("update", jobs, folder, "--accept").code == 0
    assert files_under(folder) == PICTURES | RECORDS
    again = golden("update", jobs, folder)
    assert (again.code, again.out) == (0, f"{folder}: 2 goldens, none changes\n")
    sample = json.loads((folder / "a.golden.json").read_text())
    assert sample["settings"]["lens"]["fnum"] == 2.0
    assert sample["files"] == ["render/a.exr"]
    assert {"torch", "processor", "system"} <= set(sample["machine"])
    assert {"version", "renderer"} <= set(sample)


def test_check_passes_until_a_picture_changes(jobs, goldens, tmp_path):
    ran = golden("check", jobs, goldens)
    assert (ran.code, ran.out) == (0, "2 pairs: 2 same\n")
    brighten(goldens / "render" / "a.exr", 0.25)
    file = tmp_path / "golden.xml"
    ran = golden("check", jobs, goldens, "--junit", file, "--diff", tmp_path / "diff")
    assert ran.code == 1
    assert "render/a.exr: DIFFERENT" in ran.out
    assert 'failures="1"' in file.read_text()
    assert files_under(tmp_path / "diff") == {"render/a.exr.diff.exr", "render/a.exr.diff.png"}
    assert golden("check", jobs, goldens, "--fail", "max>0.5").code == 0


def test_what_another_processor_rounds_otherwise_passes(jobs, goldens):
    path = goldens / "render" / "a.exr"
    planes = {name: plane.astype(np.float32) for name, plane in read_exr(path).items()}
    write_exr(path, **{name: plane + np.float32(9e-5) for name, plane in planes.items()})
    assert golden("check", jobs, goldens).code == 0
    write_exr(path, **{name: plane + np.float32(2e-4) for name, plane in planes.items()})
    assert golden("check", jobs, goldens).code == 1


def test_settings_of_a_foreign_list_are_quoted_in_short(jobs, goldens):
    text = (goldens / "a.golden.json").read_text()
    (goldens / "a.golden.json").write_text(text.replace('"fnum": 2.0', f'"fnum": "{"x" * 9000}"'))
    assert max(map(len, golden("check", jobs, goldens).out.splitlines())) < 500


def test_settings_that_changed_are_told_before_the_pixels(jobs, goldens):
    jobs.write_text(jobs.read_text().replace("fnumber = 2", "fnumber = 1.4"))
    first, second, *_ = golden("check", jobs, goldens).out.splitlines()
    assert first == "a: lens.fnum 1.4 instead of 2.0"
    assert second == "b: lens.fnum 1.4 instead of 2.0"
    ran = golden("update", jobs, goldens, "--accept")
    assert ran.out.count("changed: render/") == 2
    assert golden("check", jobs, goldens).code == 0
    assert golden("update", jobs, goldens).out.endswith("none changes\n")


def test_a_golden_is_not_lost_when_a_render_fails(jobs, goldens, tmp_path):
    before = {name: (goldens / name).read_bytes() for name in files_under(goldens)}
    (tmp_path / "b_z.exr").write_bytes(b"no picture")
    color_exr(tmp_path / "a_rgb.exr", texture(seed=5))
    ran = golden("update", jobs, goldens, "--accept")
    assert ran.code == 1
    assert {name: (goldens / name).read_bytes() for name in files_under(goldens)} == before
    checked = golden("check", jobs, goldens)
    assert checked.code == 1
    assert "render/b.exr: MISSING" in checked.out


def test_a_golden_that_no_job_asks_for_is_removed_and_another_file_is_not(jobs, goldens, tmp_path):
    write_exr(goldens / "mine.exr", Y=np.zeros((4, 4), np.float32))
    for name in ("b_rgb.exr", "b_z.exr"):
        (tmp_path / name).unlink()
    assert "render/b.exr: MISSING: no job asks for it" in golden("check", jobs, goldens).out
    assert "removed: render/b.exr" in golden("update", jobs, goldens, "--accept").out
    assert files_under(goldens) == {"render/a.exr", "mine.exr", "a.golden.json"}
    assert golden("check", jobs, goldens).code == 0


def test_what_is_no_folder_of_goldens_is_refused(jobs, goldens, tmp_path):
    refused(golden("check", jobs, tmp_path), 3, "not-found", tmp_path)
    for name, text in (
        ("golden.json", '{"samples": {"c": 1}}'),
        ("golden.json", "7"),
        ("c.golden.json", "<<<<<<< ours\n{}\n=======\n{}\n>>>>>>> theirs\n"),
    ):
        (goldens / name).write_text(text)
        ran = golden("check", jobs, goldens)
        refused(ran, 3, "damaged", name)
        assert ("conflict markers" in ran.err) == ("<<<" in text)
        (goldens / name).unlink()


def test_branches_that_add_goldens_merge_and_a_deleted_one_is_told_from_a_new_one(
    jobs, goldens, tmp_path
):
    (goldens / "a.golden.json").unlink()  # as on the branch that has b alone
    (goldens / "render" / "b.exr").unlink()
    report = tmp_path / "goldens.html"
    out = golden("check", jobs, goldens, "--html", report).out
    assert ["No pair", "a new case, without a golden yet"] in item(report, "render/a.exr")["facts"]
    assert "render/a.exr: EXTRA: a new case, without a golden yet" in out
    assert "render/b.exr: EXTRA: its golden was deleted" in out
    before = (goldens / "b.golden.json").read_bytes()
    assert golden("update", jobs, goldens, "--only", "render/a.exr", "--accept").code == 0
    assert (goldens / "b.golden.json").read_bytes() == before


def test_other_bytes_of_an_input_are_said_first_until_they_are_accepted(jobs, goldens, tmp_path):
    jobs.write_text(jobs.read_text().replace("fnumber = 2", "fnumber = 1.4"))
    planes = read_exr(tmp_path / "b_rgb.exr")
    write_exr(tmp_path / "b_rgb.exr", **planes, note=planes["R"])
    first, *_ = golden("check", jobs, goldens).out.splitlines()
    assert first == "b: color has other bytes than when its golden was accepted"
    told = golden("check", jobs, goldens, "--json").json
    assert (len(told["inputs_changed"]), len(told["settings_changed"])) == (1, 2)
    jobs.write_text(jobs.read_text().replace("fnumber = 1.4", "fnumber = 2"))
    assert golden("update", jobs, goldens, "--accept").code == 0
    assert golden("update", jobs, goldens).out.endswith("none changes\n")
    assert "other bytes" not in golden("check", jobs, goldens).out


def test_a_list_of_goldens_as_once_is_read_and_gives_way_to_a_file_each(jobs, goldens):
    samples = {n.split(".")[0]: json.loads((goldens / n).read_text()) for n in RECORDS}
    for name in RECORDS:
        (goldens / name).unlink()
    (goldens / "golden.json").write_text(json.dumps({"samples": samples}))
    assert golden("check", jobs, goldens).code == 0
    assert golden("update", jobs, goldens, "--only", "render/a.exr", "--accept").code == 0
    assert files_under(goldens) == PICTURES | RECORDS
    assert {n.split(".")[0]: json.loads((goldens / n).read_text()) for n in RECORDS} == samples

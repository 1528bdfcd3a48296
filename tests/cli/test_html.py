"""``--html`` and ``defocus report``: what the reports hold, and that their commands do it."""

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from batches import jobs_file
from command_line import files_under, pair, read_exr, refused, run, write_exr
from html_reports import item, items, keys, run_command
from planted_faults import planes, scene, write_planes

DUAL = """
[inputs]
color = "rgb/*.exr"
depth = "depth/*.exr"
[lens]
focal-length = "50mm"
fnumber = 2
focus = "2m"
blades = 6
blade-rotation = 15
blade-curvature = 0.25
sharp-range = "1.9m..2.1m"
highlights = "0.9:1.5"
[reading]
depth-unit = "m"
depth-scale = 0.7
sky = 2.7
[outputs]
kinds = ["render", "left", "right", "coc", "trust"]
exr-type = "float"
"""
PERCENTILE = """
[inputs]
color = "rgb/*.exr"
depth = "depth/*.exr"
[lens]
focal-length = "50.5mm"
fnumber = 2
focus = "percentile(30)"
sensor-width = "24mm"
aperture-image = "star.exr"
[reading]
depth-range = ["1m", "5m"]
depth-kind = "depth"
radial = true
fov = "60deg"
[outputs]
kinds = ["multiview"]
[machine]
quality = "high"
"""


@pytest.fixture
def folders(tmp_path):
    """Two folders: the same, shifted, missing, further, and no picture."""
    a, b = tmp_path / "A", tmp_path / "B"
    for folder, names in ((a, ("same", "shifted", "gone")), (b, ("same", "new"))):
        for name in names:
            write_planes(folder / f"{name}.exr", planes(scene()))
    write_planes(b / "shifted.exr", planes(np.roll(scene(), 2, 1)))
    for folder in (a, b):
        (folder / "bad.exr").write_bytes(b"no picture")
    return a, b


def compared(folders, *options):
    file = folders[0].parent / "report.html"
    assert run("compare", *folders, "--html", file, *options).code == 3
    return file


def test_all_pairs_are_items_with_what_they_have(folders):
    file = compared(folders)
    status = {each["name"]: each["status"] for each in items(file)}
    assert status == {
        **{"bad.exr": "unreadable", "gone.exr": "missing", "new.exr": "extra"},
        **{"same.exr": "same", "shifted.exr": "different"},
    }
    assert items(file)[-1]["name"] == "same.exr"
    shifted = item(file, "shifted.exr")
    assert shifted["words"] == "shifted by (2, 0)"
    assert keys(shifted) == ["a", "b", "difference"]
    assert keys(shifted, valued=True)[:2] == ["a", "b"]
    assert keys(item(file, "same.exr")) == ["b"]
    assert keys(item(file, "same.exr"), valued=True) == []
    assert keys(item(file, "gone.exr")) == ["a"]
    assert keys(item(file, "bad.exr")) == []


def test_a_report_is_the_same_file_however_many_processes_drew(folders):
    for number in range(3):
        for folder in folders:
            shutil.copy(folder / "shifted.exr", folder / f"more{number}.exr")
    one = compared(folders, "--processes", "1").read_bytes()
    assert compared(folders, "--processes", "2").read_bytes() == one


def test_where_no_report_can_be_written_one_line_says_so(folders):
    a, _ = folders
    refused_to = a / "same.exr" / "report.html"
    ran = run("compare", a / "same.exr", a / "same.exr", "--html", refused_to, "--json")
    assert ran.code == 3
    assert "cannot be written" in ran.err


def test_values_of_eight_bits_and_of_maps_are_kept_as_they_are(tmp_path):
    radius = np.linspace(-9, 9, 600, dtype=np.float32).reshape(20, 30)
    for folder, change in (("A", 0.0), ("B", 1e-6)):
        write_exr(tmp_path / folder / "coc.exr", coc=radius + np.float32(change))
    file = tmp_path / "r.html"
    assert run("compare", tmp_path / "A", tmp_path / "B", "--html", file).code == 1
    layers = {layer["key"]: layer for layer in item(file, "coc.exr")["layers"]}
    assert layers["a"]["kind"] == "signed"
    assert layers["a"]["ends"] == pytest.approx([-9, 9])
    # Halves of A and B are equal: their difference is kept apart, in its own scale.
    assert layers["difference"]["values"]["scale"] < 1e-5


def test_a_golden_is_checked_and_accepted_alone(tmp_path):
    jobs, folder, file = jobs_file(tmp_path), tmp_path / "gold", tmp_path / "gold.html"
    alone = ("--processes", "1", "--threads", "1")
    assert run("golden", "update", jobs, folder, "--accept", *alone).code == 0
    jobs.write_text(jobs.read_text().replace("fnumber = 2", "fnumber = 4"))
    assert run("golden", "check", jobs, folder, "--html", file, *alone).code == 1
    names = {each["name"] for each in items(file)}
    assert len(names) == 4
    name = "coc/a_focus2m.exr"
    assert name in names
    assert ("B", "rendered now") in map(tuple, item(file, name)["facts"])
    assert run_command(file, name, "Check again", *alone).code == 1
    before = (folder / "coc/b_focus2m.exr").read_bytes()
    accepted = run_command(file, name, "Accept as the golden", *alone)
    assert (accepted.code, accepted.out.splitlines()[-1]) == (0, f"{folder}: 1 golden changed")
    assert run_command(file, name, "Check again", *alone).code == 0
    assert (folder / "coc/b_focus2m.exr").read_bytes() == before
    assert len([*folder.glob("*.golden.json")]) == 4
    assert run("golden", "check", jobs, folder, *alone).out.count("DIFFERENT") == 3


def test_only_needs_a_picture_that_it_matches(tmp_path):
    jobs = jobs_file(tmp_path)
    ran = run("golden", "update", jobs, tmp_path / "gold", "--only", "render/x.exr")
    refused(ran, 2, "empty", "only")


def test_a_batch_shows_its_samples_and_how_to_render_them_again(tmp_path, here):
    jobs = jobs_file(tmp_path, text=DUAL)
    color, _ = pair(tmp_path, "c")
    color.write_bytes(b"no picture")
    file, alone = Path("batch.html"), ("--processes", "1", "--threads", "1")
    assert run("batch", jobs, "-o", "out", "--html", file, *alone).code == 1
    assert [(each["name"], each["status"]) for each in items(file)] == [
        *(("c", "failed"), ("a", "done"), ("b", "done")),
    ]
    shown = item(file, "a")
    assert keys(shown) == ["input", "render", "left", "right", "coc", "trust"]
    assert shown["wiggle"] == ["left", "right"]
    assert set(keys(shown, valued=True)) == {"input", "render", "coc", "trust"}
    assert shown["facets"]["lens"].startswith("50mm f/2, focus 2m")
    again = run_command(file, "a", "Render again", "--threads", "1")
    assert again.code == 0, again.err
    for name in ("render/a.exr", "coc/a.exr", "trust/a.exr"):
        one, other = read_exr(Path("out") / name), read_exr(Path("again") / name)
        assert all(np.array_equal(one[channel], other[channel]) for channel in one)
    assert files_under(Path("again")) == {p for p in files_under(Path("out")) if "/a." in p}


def test_views_in_one_file_wiggle_and_its_command_has_all_that_was_said(tmp_path, here):
    star = np.zeros((32, 32), np.float32)
    star[8:24, 12:20] = 1.0
    write_exr(tmp_path / "star.exr", Y=star)
    jobs = jobs_file(tmp_path, text=PERCENTILE)
    for path in (tmp_path / "depth").iterdir():
        write_exr(path, Z=np.linspace(0.1, 0.9, 384, dtype=np.float32).reshape(16, 24))
    file = Path("batch.html")
    ran = run("batch", jobs, "-o", "out", "--html", file, "--processes", "1", "--threads", "1")
    assert ran.code == 0, ran.err
    assert keys(item(file, "a")) == ["input", "left", "right"]
    assert item(file, "a")["wiggle"] == ["left", "right"]
    again = run_command(file, "a", "Render again", "--threads", "1")
    assert again.code == 0, again.err
    one, other = (read_exr(Path(out) / "multiview" / "a.exr") for out in ("out", "again"))
    assert all(np.array_equal(one[channel], other[channel]) for channel in one)


def test_a_finished_batch_is_reported_afterwards(tmp_path):
    jobs, out = jobs_file(tmp_path), tmp_path / "out"
    assert run("batch", jobs, "-o", out, "--html", tmp_path / "first.html").code == 0
    ran = run("report", out)
    assert (ran.code, ran.out) == (0, f"{out / 'report.html'}: 4 samples\n")
    assert (out / "report.html").read_bytes() == (tmp_path / "first.html").read_bytes()
    (out / "coc" / "a_focus2m.exr").unlink()
    assert run("report", out, "--html", tmp_path / "later.html", "--json").json["samples"] == 4
    assert keys(item(tmp_path / "later.html", "a_focus2m")) == ["input"]
    refused(run("report", tmp_path), 3, "empty", tmp_path)


def test_the_report_of_a_batch_has_its_card(tmp_path):
    jobs, out = jobs_file(tmp_path), tmp_path / "out"
    (tmp_path / "depth" / "b.exr").write_bytes(b"no depth")
    assert run("batch", jobs, "-o", out).code == 1
    assert run("report", out).code == 0
    text = (out / "report.html").read_text()
    card = text[text.index('<details id="card">') :].partition("</details>")[0]
    assert "<td>coc/</td>" in card
    (reason,) = json.loads((out / "card.json").read_text())["failures"]
    assert f"<td>{reason}</td><td>2</td>" in card


@pytest.mark.bench
def test_five_hundred_pairs_and_their_report_take_no_more_than_a_minute(tmp_path):
    rng = np.random.default_rng(0)
    large = np.kron(scene(), np.ones((4, 4, 1), np.float32))[:270, :480]
    for number in range(500):
        image = large * rng.uniform(0.5, 1) + rng.normal(0, 0.002, large.shape)
        for folder, factor in (("A", 1.0), ("B", 1.02 if number % 2 else 1.0)):
            write_planes(tmp_path / folder / f"{number}.exr", planes(image * factor))
    words = [sys.executable, "-m", "defocus_cli", "compare", "A", "B", "--html", "r.html"]
    start = time.perf_counter()
    ran = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (1, "")
    assert time.perf_counter() - start < 60
    assert (tmp_path / "r.html").stat().st_size < 40e6

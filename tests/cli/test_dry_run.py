"""``defocus render --dry-run``: what rendering would read, write and take."""

import os
import re
from typing import Any

import pytest
from command_line import (
    LENS,
    color_exr,
    depth_exr,
    files_under,
    pair,
    photograph,
    ramp,
    refused,
    render,
    run,
    texture,
)

from defocus_core.batch.jobs.job import Job, Machine, Outputs, Picture, Reading
from defocus_core.batch.lenses.lens import Lens
from defocus_core.errors import TooLarge
from defocus_core.evaluation import cost
from defocus_core.picture import forecast, memory_budget
from defocus_core.picture.memory_budget import Holding
from defocus_core.system import memory
from defocus_core.system.text import duration, percent
from defocus_core.tensors.box import TILE


def test_a_dry_run_says_what_it_would_do_and_does_not(tmp_path):
    color, depth = pair(tmp_path)
    ran = render(color, depth, "-o", tmp_path / "out", "--dry-run", "--outputs", "coc,render")
    assert (ran.code, ran.err) == (0, "")
    assert str(color) in ran.out
    assert str(depth) in ran.out
    assert "out/{coc,render}/a.exr" in ran.out
    assert "24x16, CoC " in ran.out
    planned = render(color, depth, "-o", tmp_path / "out", "--dry-run", "--json").json
    assert planned["dry_run"]
    assert planned["pictures"][0]["outputs"] == {"render": str(tmp_path / "out/render/a.exr")}
    assert not (tmp_path / "out").exists()


def test_the_work_it_tells_is_the_work_that_is_done(tmp_path):
    color = color_exr(tmp_path / "c.exr", texture(2 * TILE, TILE))
    depth = depth_exr(tmp_path / "z.exr", ramp(2 * TILE, TILE))
    args = (color, depth, "-o", tmp_path / "out", "--json")
    planned = render(*args, "--dry-run").json
    (told,) = planned["pictures"]
    (done,) = render(*args).json["pictures"]
    expected = told["forecast"]
    assert expected["coc_px"] == done["coc_px"]
    assert expected["size"] == done["size"]
    assert planned["forecast"]["render_seconds"] == expected["render_seconds"] > 0.01
    assert expected["peak_mb"] > 50


def test_of_many_pictures_some_are_read_and_all_are_counted(tmp_path):
    count = 2 * forecast.MAX_READ - 1
    for k in range(count):
        color, depth = pair(tmp_path, f"{k:03}")
    args = (color.parent, depth.parent, "-o", tmp_path / "out", "--dry-run")
    planned = render(*args, "--json").json
    read = [k for k, picture in enumerate(planned["pictures"]) if "forecast" in picture]
    assert read == list(range(0, count, 2))
    whole = planned["forecast"]
    assert (whole["pictures"], whole["pictures_read"]) == (count, forecast.MAX_READ)
    each = [planned["pictures"][k]["forecast"]["render_seconds"] for k in read]
    assert whole["render_seconds"] == pytest.approx(count / len(read) * sum(each))
    ran = render(*args, "--outputs", "coc,disparity")
    assert "nothing is rendered" in ran.out
    assert ran.out.splitlines()[-1].startswith(f"{count} pictures: about ")
    assert f"from {forecast.MAX_READ} of them" in ran.out


def test_a_dry_run_of_several_names_all_that_cannot_be_rendered(tmp_path):
    for k in range(4):
        color, depth = pair(tmp_path, f"{k}")
        if k in {1, 2}:
            depth_exr(depth, -ramp())
    ran = render(color.parent, depth.parent, "-o", tmp_path / "out", "--dry-run")
    assert ran.code == 1
    assert "3.exr" in ran.out
    first, second, last = ran.err.splitlines()[-3:]
    assert "1.exr: " in first
    assert "2.exr: " in second
    assert "2 of 4 pictures that were looked at would fail" in last
    told = render(color.parent, depth.parent, "-o", tmp_path / "out", "--dry-run", "--json")
    assert told.json["unusable"] == 2


@pytest.fixture
def short(tmp_path, monkeypatch):
    """A job for four threads on a machine that has 100 MB left, and what its rendering needs."""

    def made(bound, limit=None):
        memory_budget.limit_mb(Machine())  # kept for the tests that come later
        monkeypatch.setattr(memory, "available_mb", lambda device="cpu": 100.0)
        monkeypatch.setattr(
            cost, "memory_bound", lambda _, threads, at_once: 1e6 * bound(threads, at_once)
        )
        color, depth = pair(tmp_path)
        lens, outputs = Lens(50.0, 2.0, 2000.0), Outputs(tmp_path / "out")
        machine = Machine(threads=4, memory=limit)
        return Job(Picture("a", color, depth), lens, Reading(), outputs, machine)

    return made


def held(room_mb):
    return Holding(10.0, 0.0, False, 30.0, room_mb)


def regions_at_once(job, room_mb):
    unused: Any = None
    return memory_budget.regions_at_once(job, unused, held(room_mb), "cpu")[0]


@pytest.mark.parametrize(
    ("of_one_thread", "remedy"), [(90.0, "use ‹threads› 1"), (800.0, "smaller picture")]
)
def test_what_does_not_fit_is_refused_with_what_would_help(of_one_thread, remedy, short):
    job = short(lambda threads, at_once: of_one_thread if threads == 1 else 450.0)
    with pytest.raises(TooLarge, match=remedy):
        regions_at_once(job, 1e9)


def test_the_sizes_of_a_refusal_add_up(short):
    with pytest.raises(TooLarge) as refusal:
        regions_at_once(short(lambda threads, at_once: 450.0), 80.0)
    numbers = [int(word) for word in re.findall(r"\d+", str(refusal.value))]
    needed, program, files, rendering, allowed = numbers[-5:]
    assert needed == program + files + rendering
    assert (files, rendering) == (30, 450)
    assert allowed == pytest.approx(memory_budget.base_mb() + 30 + 80, abs=1)


@pytest.mark.parametrize(("room", "regions"), [(1e9, 4), (75.0, 3), (60.0, 2), (45.0, 1)])
def test_as_many_regions_as_fit_are_computed_at_once(room, regions, short):
    job = short(lambda threads, at_once: 80.0 * (at_once / 4) ** 0.5)
    assert regions_at_once(job, room) == regions


def test_what_a_limit_forbids_a_greater_one_would_allow(short, monkeypatch):
    monkeypatch.setattr(memory_budget, "enough_mb", lambda job, needed: 300.0 + needed)
    job = short(lambda threads, at_once: 60.0, limit=500 * memory.MB)
    monkeypatch.setattr(memory, "available_mb", lambda device="cpu": 4000.0)
    with pytest.raises(TooLarge, match="use ‹memory› 360MB"):
        regions_at_once(job, 30.0)


def test_rendering_refuses_what_does_not_fit_and_writes_nothing(tmp_path, short):
    job = short(lambda threads, at_once: 90.0 if threads == 1 else 450.0)
    files = (job.picture.color, job.picture.depth)
    ran = run("render", *LENS, *files, "-o", tmp_path / "out", "--threads", "4")
    refused(ran, 3, "out-of-memory", "a.exr")
    assert files_under(tmp_path) == {"rgb/a.exr", "depth/a.exr"}


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.04, "0.0 s"),
        (2.34, "2.3 s"),
        (42.4, "42 s"),
        (200.0, "3 min 20 s"),
        (7500.0, "2 h 5 min"),
    ],
)
def test_durations_are_told_as_people_do(seconds, words):
    assert duration(seconds) == words


@pytest.mark.parametrize(
    ("share", "words"), [(1.0, "100 %"), (0.995, "100 %"), (0.031, "3.1 %"), (0.0004, "0.04 %")]
)
def test_shares_are_told_in_percent(share, words):
    assert percent(share) == words


def test_colours_apart_and_up_and_down_are_counted(tmp_path):
    files = (
        color_exr(tmp_path / "c.exr", texture(TILE, TILE)),
        depth_exr(tmp_path / "z.exr", ramp(TILE, TILE)),
    )
    args = (*files, "-o", tmp_path / "out", "--dry-run", "--json", "--threads", "1")
    usual, equal, apart, quad = (
        render(*args, *more).json["pictures"][0]["forecast"]
        for more in (
            (),
            ("--axial-color", "0.1mm:0.1mm"),
            ("--axial-color", "0.1mm:0.2mm"),
            ("--outputs", "left,right,up,down"),
        )
    )
    assert [told["renderings"] for told in (usual, equal, apart, quad)] == [1, 2, 3, 2]
    assert 1.2 < equal["render_seconds"] / usual["render_seconds"] < 1.9
    assert 1.5 < apart["render_seconds"] / usual["render_seconds"] < 2.8
    assert 2 < quad["render_seconds"] / usual["render_seconds"] < 5
    assert "3 renderings, about " in render(*args[:-3], "--axial-color", "0.1mm:0.2mm").out


def test_a_dry_run_needs_no_directory_that_can_be_written(color, depth, out, monkeypatch):
    monkeypatch.setattr(os, "access", lambda _, mode: not mode & os.W_OK)
    photograph(color, depth, "-o", out, "--dry-run")
    refused(render(color, depth, "-o", out), 3, "unwritable", out.parent)

"""``defocus render --dry-run``: what rendering would read, write and take."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import (
    LENS,
    color_exr,
    depth_exr,
    files_under,
    pair,
    ramp,
    refused,
    render,
    run,
    texture,
)

from defocus_cli import budget, calibration, engine, forecast, memory, sizing
from defocus_cli.calibration import Calibration
from defocus_cli.job import Job, Lens, Machine, Outputs, Picture, Reading
from defocus_cli.made import Outcome
from defocus_core.tiling import TILE


def test_a_dry_run_says_what_it_would_do_and_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "compute", None)
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


def test_the_work_it_tells_is_the_work_that_is_done(tmp_path: Path) -> None:
    color = color_exr(tmp_path / "c.exr", texture(2 * TILE, TILE))
    depth = depth_exr(tmp_path / "z.exr", ramp(2 * TILE, TILE))
    args = (color, depth, "-o", tmp_path / "out", "--json")
    planned = render(*args, "--dry-run").json
    (told,) = planned["pictures"]
    (done,) = render(*args).json["pictures"]
    expected = told["forecast"]
    assert expected["coc_px"] == done["coc_px"]
    assert expected["size"] == done["size"]
    assert expected["stats"].items() <= done["stats"].items()
    assert planned["forecast"]["render_seconds"] == expected["render_seconds"] > 0.01
    assert expected["peak_mb"] > 50


def test_more_work_is_told_to_take_longer_and_more_memory(tmp_path: Path) -> None:
    files = (
        color_exr(tmp_path / "c.exr", texture(TILE, TILE)),
        depth_exr(tmp_path / "z.exr", ramp(TILE, TILE)),
    )
    args = (*files, "-o", tmp_path / "out", "--dry-run", "--json", "--threads", "1")
    usual, high, pair_ = (
        render(*args, *more).json["forecast"]
        for more in ((), ("--quality", "high"), ("--outputs", "left,right"))
    )
    for more in (high, pair_):
        assert more["render_seconds"] > 1.3 * usual["render_seconds"]


def test_maps_alone_take_no_rendering_and_no_measurement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forecast, "calibrated", None)
    color, depth = pair(tmp_path)
    ran = render(color, depth, "-o", tmp_path / "out", "--dry-run", "--outputs", "coc,disparity")
    assert ran.code == 0
    assert "nothing is rendered" in ran.out


def test_of_many_pictures_some_are_read_and_all_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(forecast, "MOST_READ", 3)
    for k in range(7):
        color, depth = pair(tmp_path, f"{k}")
    args = (color.parent, depth.parent, "-o", tmp_path / "out", "--dry-run")
    planned = render(*args, "--json").json
    read = [k for k, picture in enumerate(planned["pictures"]) if "forecast" in picture]
    assert read == [0, 3, 6]
    whole = planned["forecast"]
    assert (whole["pictures"], whole["pictures_read"]) == (7, 3)
    each = [planned["pictures"][k]["forecast"]["render_seconds"] for k in read]
    assert whole["render_seconds"] == pytest.approx(7 / 3 * sum(each))
    ran = render(*args)
    assert ran.out.splitlines()[-1].startswith("7 pictures: about ")
    assert "from 3 of them" in ran.out


def test_a_dry_run_finds_what_cannot_be_rendered(tmp_path: Path) -> None:
    color, depth = pair(tmp_path)
    depth_exr(depth, -ramp())
    refused(render(color, depth, "-o", tmp_path / "out", "--dry-run"), 3, str(depth))


def test_a_dry_run_of_several_names_all_that_cannot_be_rendered(tmp_path: Path) -> None:
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


def large(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, **needed: float) -> Outcome:
    """A job, on a machine whose memory is 100 MB, that needs so much with some settings."""
    budget.limit_mb(Machine())  # kept for the tests that come later
    monkeypatch.setattr(memory, "available_mb", lambda device="cpu": 100.0)
    monkeypatch.setattr(sizing, "_most_mb", lambda *_: 1e9)

    def predicted(self: Calibration, plan: object, at_once: int = 0) -> float:
        if self.threads == 1:
            return needed["threads_1"]
        return needed["usual"] * ((at_once or self.threads) / 4) ** 0.5

    monkeypatch.setattr(Calibration, "predicted_mb", predicted)
    color, depth = pair(tmp_path)
    lens, outputs = Lens(50.0, 2.0, 2000.0), Outputs(tmp_path / "out")
    job = Job(Picture("a", color, depth), lens, Reading(), outputs, Machine(threads=4))
    return Outcome(job, lens, (8, 8), (-2.0, 3.0), "", "", "cpu", "standard")


FRAME = (torch.rand(3, 8, 8), torch.zeros(8, 8))


@pytest.mark.parametrize(
    ("needed", "remedy"),
    [
        ({"usual": 900.0, "threads_1": 90.0}, "use --threads 1"),
        ({"usual": 900.0, "threads_1": 800.0}, "smaller picture"),
    ],
)
def test_what_does_not_fit_is_refused_with_what_would_help(
    needed: dict[str, float], remedy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = large(monkeypatch, tmp_path, **needed)
    with pytest.raises(sizing.TooLarge, match=f"about 450 MB .* but 100 MB are left; .*{remedy}"):
        sizing.fitting(outcome, *FRAME, 1e9)


@pytest.mark.parametrize(("room", "regions"), [(1e9, 4), (75.0, 3), (60.0, 2), (45.0, 1)])
def test_as_many_regions_as_fit_are_computed_at_once(
    room: float, regions: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = large(monkeypatch, tmp_path, usual=80.0, threads_1=10.0)
    assert sizing.fitting(outcome, *FRAME, room).at_once == regions


def test_what_a_limit_forbids_a_greater_one_would_allow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = large(monkeypatch, tmp_path, usual=120.0, threads_1=60.0)
    monkeypatch.setattr(sizing, "enough_mb", lambda job, needed: 300.0 + needed)
    job = replace(outcome.job, machine=Machine(threads=4, memory=500 * memory.MB))
    with pytest.raises(sizing.TooLarge, match=r"but 30 MB are left; use --memory 360MB"):
        sizing.fitting(replace(outcome, job=job), *FRAME, 30.0)


def test_rendering_refuses_what_does_not_fit_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = large(monkeypatch, tmp_path, usual=900.0, threads_1=90.0).job
    monkeypatch.setattr("defocus_core.Stream", None)
    files = (job.picture.color, job.picture.depth)
    ran = run("render", *LENS, *files, "-o", tmp_path / "out", "--threads", "4")
    refused(ran, 3, str(job.picture.color), "450 MB", "use --threads 1")
    assert files_under(tmp_path) == {"rgb/a.exr", "depth/a.exr"}


def test_a_frame_that_surely_fits_is_not_planned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sizing, "planned_work", None)
    assert render(*pair(tmp_path), "-o", tmp_path / "out").code == 0


@pytest.mark.parametrize("kind", ["plane", "floor", "cards"])
@pytest.mark.parametrize("r", [2.0, 90.0])
def test_the_quick_bound_is_above_the_prediction(kind: str, r: float) -> None:
    from defocus_core.planning import plan
    from defocus_core.scenery import scenery

    image, radius = scenery(kind, 200, 300, r)
    for quality in ("draft", "reference"):
        found = plan(radius, image=image, quality=quality, left_right=True)
        most = sizing._most_mb(tuple(image.shape), float(radius.abs().max()), 2)
        assert calibration.usual(2).predicted_mb(found) < most


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
def test_durations_are_told_as_people_do(seconds: float, words: str) -> None:
    assert forecast.duration(seconds) == words


def test_sizes_of_pixels_and_depth_are_compared(tmp_path: Path) -> None:
    color, depth = (
        color_exr(tmp_path / "c.exr"),
        depth_exr(tmp_path / "z.exr", np.ones((8, 8), np.float32)),
    )
    refused(render(color, depth, "-o", tmp_path / "out", "--dry-run"), 3, "8x8 px", "24x16")

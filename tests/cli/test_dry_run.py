"""``defocus render --dry-run``: what rendering would read, write and take."""

import os

import pytest
from command_line import color_exr, depth_exr, pair, photograph, ramp, refused, render, texture

from defocus_core.picture import forecast
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
    assert planned["forecast"]["seconds"] == expected["seconds"] > 0.01
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
    each = [planned["pictures"][k]["forecast"]["seconds"] for k in read]
    assert whole["seconds"] == pytest.approx(count / len(read) * sum(each))
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


def test_colours_apart_are_counted(tmp_path):
    files = (
        color_exr(tmp_path / "c.exr", texture(TILE, TILE)),
        depth_exr(tmp_path / "z.exr", ramp(TILE, TILE)),
    )
    args = (*files, "-o", tmp_path / "out", "--dry-run", "--json", "--threads", "1")
    usual, equal, apart = (
        render(*args, *more).json["pictures"][0]["forecast"]
        for more in (
            (),
            ("--axial-color", "0.1mm:0.1mm"),
            ("--axial-color", "0.1mm:0.2mm"),
        )
    )
    assert [told["renderings"] for told in (usual, equal, apart)] == [1, 2, 3]
    assert "3 renderings, about " in render(*args[:-3], "--axial-color", "0.1mm:0.2mm").out


def test_a_dry_run_needs_no_directory_that_can_be_written(color, depth, out, monkeypatch):
    monkeypatch.setattr(os, "access", lambda _, mode: not mode & os.W_OK)
    photograph(color, depth, "-o", out, "--dry-run")
    refused(render(color, depth, "-o", out), 3, "unwritable", out.parent)


def test_a_large_picture_is_counted_without_its_repair_and_writing_counts(
    color, depth, out, monkeypatch
):
    def told(*more):
        return render(color, depth, "-o", out, *more, "--dry-run", "--json").json["forecast"]

    small = told()
    monkeypatch.setattr(forecast, "_durable_seconds", lambda: 10.0)
    assert told()["seconds"] > small["seconds"] + 19, "a file, and its line of the journal"
    monkeypatch.setattr(forecast, "_durable_seconds", lambda: 0.0)
    monkeypatch.setattr(forecast, "work_per_second", lambda device, threads: 1e4)  # not reading
    monkeypatch.setattr(forecast, "_REPAIRED_PIXELS", 0)
    usual, high, apart = (
        told(*more)["seconds"]
        for more in (
            (),
            ("--quality", "high"),
            ("--axial-color", "0.1mm:0.2mm"),
        )
    )
    assert usual < high
    assert apart > 1.5 * usual
    assert told()["pictures_read"] == 1
    assert told()["peak_mb"] >= small["peak_mb"]

"""``defocus render --dry-run``: what rendering would read, write and take."""

import os

from command_line import color_exr, depth_exr, pair, photograph, ramp, refused, render, texture
from renderers import TILE

from defocus_core.picture import forecast


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


def test_what_it_foresees_is_what_is_done(tmp_path):
    color = color_exr(tmp_path / "c.exr", texture(2 * TILE, TILE))
    depth = depth_exr(tmp_path / "z.exr", ramp(2 * TILE, TILE))
    args = (color, depth, "-o", tmp_path / "out", "--json")
    planned = render(*args, "--dry-run").json
    (told,) = planned["pictures"]
    (done,) = render(*args).json["pictures"]
    for name in ("size", "coc_px", "color_note", "depth_note", "depth_repair"):
        assert told["forecast"][name] == done[name]
    assert told["forecast"]["peak_mb"] == planned["peak_mb"] > 50


def test_of_many_pictures_some_are_opened_and_all_are_counted(tmp_path):
    count = 2 * forecast.MAX_READ - 1
    for k in range(count):
        color, depth = pair(tmp_path, f"{k:03}")
    args = (color.parent, depth.parent, "-o", tmp_path / "out", "--dry-run")
    planned = render(*args, "--json").json
    read = [k for k, picture in enumerate(planned["pictures"]) if "forecast" in picture]
    assert read == list(range(0, count, 2))
    assert (planned["todo"], planned["looked_at"]) == (count, forecast.MAX_READ)
    last = render(*args, "--outputs", "coc,disparity").out.splitlines()[-2:]
    assert last[0] == f"0 jobs done before, {count} to do, {2 * count} files to write"
    assert last[1].startswith("at most ")
    assert last[1].endswith(f"going by {forecast.MAX_READ} of them")


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
    assert "2 of 4 whose inputs were opened would fail" in last
    told = render(color.parent, depth.parent, "-o", tmp_path / "out", "--dry-run", "--json")
    assert told.json["unusable"] == 2


def test_a_dry_run_needs_no_directory_that_can_be_written(color, depth, out, monkeypatch):
    monkeypatch.setattr(os, "access", lambda _, mode: not mode & os.W_OK)
    photograph(color, depth, "-o", out, "--dry-run")
    refused(render(color, depth, "-o", out), 3, "unwritable", out.parent)

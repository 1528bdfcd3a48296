"""What ``defocus render`` tells people and scripts, and when it keeps quiet."""

import subprocess
import sys

import numpy as np
import pytest
from batches import JOBS, jobs_file
from command_line import (
    HEIGHT,
    LENS,
    WIDTH,
    Terminal,
    color_exr,
    depth_exr,
    header,
    pair,
    ramp,
    render,
    run,
    succeed,
    texture,
)
from image_files import save
from renderers import TILE


def test_a_bar_counts_the_pictures_of_a_directory_on_a_terminal(tmp_path):
    for stem in ("a", "b"):
        color, depth = pair(tmp_path, stem)
    args = ("render", *LENS, "-o", tmp_path / "out", "--overwrite", color.parent, depth.parent)
    watched = run(*args, err=Terminal())
    assert "0/2 [" in watched.err
    assert watched.out == ""
    assert "0/2 [" not in run(*args).err
    lone = run(*args[:-2], color, depth, err=Terminal()).err
    assert "picture/s]" not in lone


@pytest.mark.usefixtures("torch_back")
def test_a_bar_counts_the_tiles_of_a_lone_picture_on_a_terminal(tmp_path):
    color = color_exr(tmp_path / "c.exr", texture(2 * TILE, TILE))
    depth = depth_exr(tmp_path / "z.exr", ramp(2 * TILE, TILE))
    args = (color, depth, "-o", tmp_path / "out", "--overwrite", "--json")
    watched = run("render", *LENS, *args, err=Terminal())
    assert "0/2 [" in watched.err
    assert watched.json["pictures"]
    unwatched = render(*args)
    assert unwatched.err.count("\n") == 1
    assert "\r" not in unwatched.err


def test_people_are_told_in_one_line_on_stderr(tmp_path):
    ran = render(*pair(tmp_path), "-o", tmp_path / "out", "--outputs", "left,right")
    assert ran.out == ""
    assert ran.err.count("\n") == 1
    for words in ("a: 24x16", "50mm f/2", "focus 2m", "sensor 36mm", "{left,right}/a.exr"):
        assert words in ran.err


def test_libraries_say_nothing_when_the_process_ends(tmp_path):
    """What is still held when the interpreter goes would be listed as leaked."""
    color = save(tmp_path / "a.png", np.full((HEIGHT, WIDTH, 3), 100, np.uint8))
    words = [color, depth_exr(tmp_path / "z.exr"), *LENS, "-o", tmp_path / "out", "--format", "jpg"]
    command = [sys.executable, "-m", "defocus_cli", "render", *map(str, words)]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    assert ran.stdout == ""
    assert ran.stderr.count("\n") == 1
    assert "a: 24x16" in ran.stderr


def test_counts_of_what_was_computed_are_told_to_who_wants_more(tmp_path):
    for more, said in (("-v", True), ("-q", False)):
        told = render(*pair(tmp_path), "-o", tmp_path / "out", more, "--overwrite").err
        assert ("pixels_copied " in told) is said


def depths():
    """Depth with a fault each, the same without it, and what is said of the fault."""
    y, x = np.mgrid[:96, :144]
    level, noise = (x + y) / 238, np.random.default_rng(1).normal(0, 0.02, (96, 144))
    edge = [np.clip((x - 72) / width, 0, 1) for width in (8, 1)]
    down, across = np.mgrid[: 8 * 96, : 8 * 144] / 8
    fine = np.where(across + 0.37 * down < 80.2, 1.0, 3.0)
    return {
        "few-levels": [1 / (0.1 + 1.5 * share) for share in (np.round(47 * level) / 47, level)],
        "repaired noise": [1 / (0.4 + noise), 1 / (0.4 + 0 * noise)],
        "soft-edges": [1 / (0.5 - 0.4 * share) for share in edge],
        "anti-aliased": [fine.reshape(96, 8, 144, 8).mean((1, 3)), fine[4::8, 4::8]],
    }


@pytest.mark.parametrize("note", depths())
def test_a_fault_of_depth_that_is_repaired_is_said(note, tmp_path):
    color = color_exr(tmp_path / "a.exr", texture(144, 96))
    lens = ("--focal-length", "100mm", "--fnumber", "2", "--focus", "2m")
    lens += ("--sensor-width", "4mm") * (note == "soft-edges")
    for name, metres, said in zip(("bad", "good"), depths()[note], (True, False), strict=True):
        depth = depth_exr(tmp_path / f"{name}.exr", metres.astype(np.float32))
        out = ("-o", tmp_path / name, "--outputs", "render,coc")
        ran = succeed("render", color, depth, *lens, *out, "-v", "--json")
        dry = ("render", color, depth, *lens, *out, "--dry-run", "--overwrite")
        for words in (dry, ("info", depth, *lens)):
            assert (note in run(*words).out) is said
        assert (note in ran.err) is said
        assert (note in ran.json["pictures"][0]["depth_note"]) is said
        for kind in ("render", "coc"):  # maps show the depth as it is given
            told = header(tmp_path / name / kind / "a.exr")["defocus:depth_read_as"]
            assert (note in told) is (said and kind == "render")


def test_what_a_file_cannot_hold_is_a_warning(tmp_path):
    color = color_exr(tmp_path / "c.exr", np.full((HEIGHT, WIDTH, 3), 1e6, np.float32))
    ran = render(color, depth_exr(tmp_path / "z.exr"), "-o", tmp_path / "out", "--json")
    assert len(ran.json["pictures"][0]["warnings"]) == 1
    assert "c: warning: " in ran.err


def test_warnings_of_a_batch_are_summed_up_by_their_kind(tmp_path):
    jobs = jobs_file(tmp_path, "a", "b", "c", text=JOBS.replace('"coc"', '"render"'))
    for stem, light in (("a", 1e6), ("b", 2e6)):
        color_exr(tmp_path / "rgb" / f"{stem}.exr", np.full((HEIGHT, WIDTH, 3), light, np.float32))
    ran = succeed("batch", jobs, "-o", tmp_path / "out", "--json")
    ((kind, count),) = ran.json["warnings"].items()
    assert count == 4
    assert "4 with warnings in the journal" in ran.err
    assert f"  warning: {kind} (and 3 more like it)\n" in ran.err

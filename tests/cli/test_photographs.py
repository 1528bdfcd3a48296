"""Photographs as people have them: a first picture of one line."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import color_exr, depth_exr, pair, ramp, refused, run, texture
from depth_files import gdepth, png
from image_files import save

SIZE = (120, 160)


def photo(folder: Path) -> Path:
    return save(folder / "photo.png", (texture(*SIZE[::-1]) * 255).astype(np.uint8))


def disparity(*, dtype: Any = np.uint8) -> Any:
    numbers = np.full(SIZE, 10)
    numbers[40:90, 60:120] = 180
    return (numbers * (257 if dtype == np.uint16 else 1)).astype(dtype)


def taken(said: str) -> str:
    """The options that a first picture was taken with."""
    (options,) = re.findall(r"relative depth, taken with (--[^;]*)(?:;|$)", said.splitlines()[0])
    return options


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_first_picture_takes_one_line_and_says_how_it_was_taken(
    dtype: Any, tmp_path: Path
) -> None:
    files = photo(tmp_path), png(tmp_path / "z.png", disparity(dtype=dtype), dtype)
    ran = run("render", *files, "-o", tmp_path / "a.png")
    assert ran.code == 0, ran.err
    assert taken(ran.err) == "--blur 3px --focus-at 89,64"
    again = run("render", *files, "-o", tmp_path / "b.png", *shlex.split(taken(ran.err)))
    assert "taken with" not in again.err
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    other = run("render", *files, "-o", tmp_path / "a.png", "--blur", "9px")
    assert taken(other.err) == "--focus-at 89,64"
    black = run("render", *files, "-o", tmp_path / "a.png", "--invert", "--blur", "9px")
    assert taken(black.err) == "--focus-at 59,51"


def test_a_phones_photograph_is_one_file_and_one_line(tmp_path: Path) -> None:
    depth = png(tmp_path / "d.png", 255 - disparity()[::2, ::2], np.uint8).read_bytes()
    picture = (texture(*SIZE[::-1]) * 255).astype(np.uint8)
    kind = {"Format": "RangeInverse", "Near": 0.5, "Far": 25.0}
    file = gdepth(tmp_path / "a.jpg", depth, picture=picture, **kind)
    ran = run("render", file, "-o", tmp_path / "a.png")
    assert (ran.code, taken(ran.err)) == (0, "--blur 3px --focus-at 89,65"), ran.err
    file = gdepth(tmp_path / "m.jpg", depth, picture=picture, **kind, Units="m")
    refused(run("render", file, "-o", tmp_path / "m.png"), 2, "missing-option", "focal-length")


@pytest.mark.parametrize("given", ["", "--fnumber 2", "--focus 2m", "--lens @hexagon-50"])
def test_metric_depth_gets_one_error_with_a_command_that_runs(given: str, tmp_path: Path) -> None:
    files = color_exr(tmp_path / "a b.exr"), depth_exr(tmp_path / "z.exr")
    ran = run("render", *files, "-o", tmp_path / "out", *given.split())
    refused(ran, 2, "missing-option")
    command = shlex.split(ran.err.partition("run: ")[2])
    assert command[:2] == ["defocus", "render"]
    assert run(*command[1:]).code == 0, command
    assert (tmp_path / "out" / "render" / "a b.exr").exists()


def test_batches_never_guess(tmp_path: Path) -> None:
    for stem in "ab":
        save(tmp_path / "rgb" / f"{stem}.png", (texture() * 255).astype(np.uint8))
        (tmp_path / "z").mkdir(exist_ok=True)
        png(tmp_path / "z" / f"{stem}.png", ramp() * 60, np.uint8)
    folders, out = (tmp_path / "rgb", tmp_path / "z"), ("-o", tmp_path / "out")
    refused(run("render", *folders, *out), 2, "missing-option", "focal-length")
    refused(run("render", *folders, *out, "--blur", "8px"), 2, "missing-option", "blur")
    color, depth = pair(tmp_path)
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(f'[inputs]\ncolor = "{color}"\ndepth = "{depth}"\n[lens]\nblades = 5\n')
    refused(run("batch", jobs, *out), 2, "missing-option", "focal-length")

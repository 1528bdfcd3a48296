"""Steadiness: what the frames of a shot decide together."""

from pathlib import Path

import numpy as np
import pytest
from batches import records
from command_line import color_exr, depth_exr, photograph, render, succeed
from shots import HEIGHT, WIDTH, smooth, still

FOCAL = ("--focal-length", "50mm", "--fnumber", "2")


def test_frames_are_steady_and_each_is_the_same_alone_as_with_the_others(tmp_path):
    patterns = still(tmp_path)
    photograph(*patterns, "-o", tmp_path / "steady", "--exr-type", "float")
    photograph(*patterns, "-o", tmp_path / "one", "--frames", "3", "--exr-type", "float")
    name = Path("render") / "rgb.0003.exr"
    assert (tmp_path / "steady" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()
    notes = [record["depth_note"] for record in records(tmp_path / "steady")]
    assert all("as 3 frames, 0, 5, 9 of the shot decide" in note for note in notes)


def test_a_frame_without_noise_does_not_decide_for_itself(tmp_path):
    patterns = still(tmp_path, 6)
    depth_exr(tmp_path / "z.0003.exr", np.full((HEIGHT, WIDTH), 3.0, np.float32))
    photograph(*patterns, "-o", tmp_path / "out")
    assert all("repaired noise" in record["depth_note"] for record in records(tmp_path / "out"))


def test_depth_without_noise_makes_the_bytes_of_a_plain_batch(tmp_path):
    patterns = still(tmp_path, 2, noise=0.0)
    for out, words in (("a", ()), ("b", ("--no-steady",))):
        photograph(*patterns, "-o", tmp_path / out, *words)
    name = Path("render") / "rgb.0001.exr"
    assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def moving_focus(folder):
    """Frames whose depth goes from 2 m to 4 m."""
    for k, metres in enumerate((2.0, 2.5, 3.0, 3.5, 4.0)):
        color_exr(folder / f"rgb.{k:04}.exr", smooth())
        depth_exr(folder / f"z.{k:04}.exr", np.full((HEIGHT, WIDTH), metres, np.float32))
    return folder / "rgb.####.exr", folder / "z.####.exr"


@pytest.mark.parametrize("focus", [("--focus-at", "9,9"), ("--focus", "percentile(50)")])
def test_a_focus_that_depth_decides_is_one_for_the_shot(tmp_path, focus):
    patterns = moving_focus(tmp_path)
    cases: dict[tuple[str, ...], list[float]] = {
        (): [3000] * 5,
        ("--no-steady",): [2000, 2500, 3000, 3500, 4000],
    }
    for number, (words, foci) in enumerate(cases.items()):
        out = tmp_path / f"out{number}"
        succeed("render", *patterns, "-o", out, *FOCAL, *focus, *words)
        found = {each["sample_id"]: each["lens"]["focus_mm"] for each in records(out)}
        assert [found[f"rgb.{k:04}"] for k in range(5)] == pytest.approx(foci, rel=1e-6)


def test_a_tracked_point_is_followed(tmp_path):
    patterns = moving_focus(tmp_path)
    (tmp_path / "track.csv").write_text("frame,x,y\n0,3,4\n4,23,4\n")
    words = ("render", *patterns, *FOCAL, "--animate", tmp_path / "track.csv")
    succeed(*words, "-o", tmp_path / "own")
    foci = [record["lens"]["focus_mm"] for record in records(tmp_path / "own")]
    assert foci == pytest.approx([2000, 2500, 3000, 3500, 4000])
    assert records(tmp_path / "own")[2]["lens"]["focus_at_px"] == [13, 4]


def test_other_frames_are_inputs_of_the_journal_and_of_no_list(tmp_path):
    patterns = still(tmp_path, 4)
    ran = render(*patterns, "-o", tmp_path / "out", "--dry-run")
    assert "rgb.0001.exr, " in ran.err + ran.out
    assert "and 3 other frames of the shot" in ran.err + ran.out
    document = render(*patterns, "-o", tmp_path / "out", "--json").json
    assert not any(key.startswith("frame") for key in document["pictures"][0])
    assert "frame0_depth" in records(tmp_path / "out")[2]["inputs"]

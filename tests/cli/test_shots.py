"""Shots: numbered frames, a lens that moves, and what frames have in common."""

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import (
    HEIGHT,
    WIDTH,
    color_exr,
    depth_exr,
    files_under,
    pair,
    photograph,
    ramp,
    read_exr,
    refused,
    render,
    run,
    succeed,
    texture,
    write_exr,
)
from elements import write

FOCAL = ("--focal-length", "50mm")


def shot(folder, frames=4, first=1001):
    """The patterns of the colour and the depth frames of a shot."""
    for k in range(frames):
        color_exr(folder / f"rgb.{first + k}.exr", texture(seed=k))
        depth_exr(folder / f"z_{first + k}.exr", ramp() + 0.1 * k)
    return folder / "rgb.####.exr", folder / "z_%04d.exr"


PULL = "frame,focus,fnumber\n1001,1.5m,2\n1003,3m,8\n"


def picture(folder, frame):
    return read_exr(folder / "render" / f"rgb.{frame}.exr")["R"]


def test_frames_pair_up_by_number_and_keep_it(tmp_path):
    patterns = shot(tmp_path)
    photograph(*patterns, "-o", tmp_path / "out")
    assert files_under(tmp_path / "out") - {"metadata.jsonl"} == {
        f"render/rgb.{frame}.exr" for frame in range(1001, 1005)
    }
    again = render(*patterns, "-o", tmp_path / "out")
    assert again.err.count("done before") == 4


def test_frames_are_chosen_and_gaps_left_out(tmp_path):
    patterns, behind = shot(tmp_path), shot(tmp_path / "hidden")
    photograph(*patterns, "-o", tmp_path / "two", "--frames", "1001-1004x2", "--hidden", *behind)
    assert len(files_under(tmp_path / "two" / "render")) == 2
    (tmp_path / "z_1003.exr").unlink()
    ran = photograph(*patterns, "-o", tmp_path / "out", "--missing", "skip")
    assert "lacks 1 frame, 1003; left out" in ran.err
    assert len(files_under(tmp_path / "out" / "render")) == 3


def test_what_makes_no_shot_is_refused_before_any_work(tmp_path):
    color, depth = shot(tmp_path)
    behind = shot(tmp_path / "hidden")
    (tmp_path / "hidden" / "rgb.1002.exr").unlink()
    (tmp_path / "gap").mkdir()
    depth_exr(tmp_path / "gap" / "z_1001.exr")
    gap, lone = tmp_path / "gap" / "z_%04d.exr", tmp_path / "z_1001.exr"
    for words, exit_code, code, at in (
        ((color, depth, "--frames", "1-2"), 3, "missing-frames", "rgb.####.exr"),
        ((color, depth, "--frames", "all"), 2, "malformed", "frames"),
        ((color, depth, "--frames", "keys"), 2, "malformed", "frames"),
        ((color, depth, "--hidden", *behind), 3, "missing-frames", "rgb.####.exr"),
        ((color, gap), 3, "missing-frames", gap),
        ((color, lone), 3, "missing-frames", "z_1001.exr"),
        ((*pair(tmp_path), "--frames", "1"), 2, "idle-option", "frames"),
        ((*pair(tmp_path), "--missing", "skip"), 2, "idle-option", "missing"),
    ):
        refused(render(*words, "-o", tmp_path / "out"), exit_code, code, at)
    assert not (tmp_path / "out").exists()


def test_a_pull_gives_each_frame_what_the_command_line_would(tmp_path):
    patterns = shot(tmp_path)
    (tmp_path / "pull.csv").write_text(PULL)
    out = tmp_path / "out"
    succeed("render", *patterns, "-o", out, *FOCAL, "--animate", tmp_path / "pull.csv")
    for frame, focus, fnumber in ((1001, "1.5m", "2"), (1002, "2m", "4"), (1004, "3m", "8")):
        files = (tmp_path / f"rgb.{frame}.exr", tmp_path / f"z_{frame}.exr")
        lens = (*FOCAL, "--focus", focus, "--fnumber", fnumber)
        alone = tmp_path / f"alone{frame}"
        succeed("render", *files, "-o", alone, *lens)
        np.testing.assert_allclose(picture(out, frame), picture(alone, frame), atol=1e-3)


def test_the_lens_comes_from_metadata_and_what_is_missing_is_asked_for(tmp_path):
    color, depth = tmp_path / "rgb.0001.exr", tmp_path / "z.0001.exr"
    planes = {name: texture()[..., k].copy() for k, name in enumerate("RGB")}
    for frame, focus in ((1, 1.5), (2, 3.0)):
        attributes = {"focus": focus, "aperture": 2.0, "pinholeFocalLength": 50.0}
        write(color.with_name(f"rgb.000{frame}.exr"), planes, **attributes)
        depth_exr(depth.with_name(f"z.000{frame}.exr"))
    words = ("render", tmp_path / "rgb.#.exr", tmp_path / "z.#.exr", "--lens-from-metadata")
    words = tuple(str(word).replace(".#.", ".####.") for word in words)
    refused(run(*words, "-o", tmp_path / "out"), 2, "missing-option", "sensor-width")
    words = (*words, "--sensor-width", "36mm")
    ran = succeed(*words, "-o", tmp_path / "out", "-v")
    assert "focus 1.5m (focus)" in ran.err
    assert "focus 3m (focus)" in ran.err
    assert "50mm f/2, focus 3m" in ran.err
    ran = run(*words, "-o", tmp_path / "own", "--focus", "2m")
    assert "50mm f/2, focus 2m" in ran.err
    bare = ("render", *pair(tmp_path), "-o", tmp_path / "bare", "--lens-from-metadata")
    refused(run(*bare), 2, "missing-option", "focal-length")


def test_a_lone_pattern_is_of_files_that_hold_colour_and_depth(tmp_path):
    for frame in (1, 2):
        planes = {name: texture()[..., k].copy() for k, name in enumerate("RGB")}
        write_exr(tmp_path / f"both.{frame:04}.exr", **planes, Z=ramp())
    photograph(tmp_path / "both.####.exr", "-o", tmp_path / "out")
    ran = render(tmp_path / "both.####.png", "-o", tmp_path / "out")
    refused(ran, 3, "missing-frames", "both.####.png")


def test_shots_of_a_jobs_file(tmp_path):
    shot(tmp_path)
    (tmp_path / "more.csv").write_text("frame,fnumber\n1001,2\n1003,8\n")
    text = """
        [inputs]
        color = "rgb.####.exr"
        depth = "z_%04d.exr"
        frames = "1001-1003"
        [lens]
        focal-length = "50mm"
        [animate]
        file = "more.csv"
        focus = {1001 = "1.5m", 1003 = "3m"}
    """
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(text)
    succeed("batch", jobs, "-o", tmp_path / "out", "--processes", "1")
    (tmp_path / "pull.csv").write_text(PULL)
    words = (*FOCAL, "--animate", tmp_path / "pull.csv", "--frames", "1001-1003")
    patterns = (tmp_path / "rgb.####.exr", tmp_path / "z_%04d.exr")
    succeed("render", *patterns, "-o", tmp_path / "same", *words)
    for frame in (1001, 1002, 1003):
        assert np.array_equal(*(picture(tmp_path / out, frame) for out in ("out", "same")))
    for change, problem in (
        ('focal-length = "50mm"', "focal-length = 50"),
        ("[lens]", '[lens]\nfocus = "1m"'),
        ("[lens]", "[sweep]\nfnumber = [1, 2]\n[lens]"),
        ('frames = "1001-1003"', "frames = [1001]"),
        ('frames = "1001-1003"', 'missing = "no"'),
    ):
        jobs.write_text(text.replace(change, problem))
        assert run("batch", jobs, "-o", tmp_path / "none").code == 2
        assert not (tmp_path / "none").exists()


def test_a_contact_sheet_shows_some_frames(tmp_path):
    patterns = shot(tmp_path)
    ran = photograph(*patterns, "-o", tmp_path / "out", "--contact", "3")
    assert "contact sheet ->" in ran.err
    sheet = oiio.ImageBuf(str(tmp_path / "out" / "contact.png")).get_pixels(oiio.UINT8)
    assert sheet.shape == (2 * (HEIGHT + 26), 2 * 320, 3)
    lit = [sheet[y : y + HEIGHT, x : x + WIDTH].any() for y in (0, HEIGHT + 22) for x in (0, 320)]
    assert lit == [True, True, True, False]  # three frames, and an empty place
    photograph(*patterns, "-o", tmp_path / "out", "--contact", "1")
    assert oiio.ImageBuf(str(tmp_path / "out" / "contact.png")).spec().width == 320
    ran = render(*patterns, "-o", tmp_path / "coc", "--contact", "3", "--outputs", "coc")
    refused(ran, 2, "idle-option", "contact")


def test_of_a_shot_frames_gaps_and_sizes_are_told_in_a_line(tmp_path):
    color, depth = shot(tmp_path, 5)
    (tmp_path / "z_1004.exr").unlink()
    color_exr(tmp_path / "rgb.1003.exr", texture(12, 8))
    assert succeed("info", color, depth).out.splitlines() == [
        f"{color}: 5 frames, 1001-1005; no gaps; 24x16 in 4 frames, 1001-1002, 1004-1005; "
        "12x8 in 1 frame, 1003",
        f"{depth}: 4 frames, 1001-1003, 1005; 1 frame, 1004 missing; 24x16",
    ]
    _, of_depth = run("info", color, depth, "--json").json["shots"]
    assert (of_depth["frames"], of_depth["gaps"]) == ([1001, 1002, 1003, 1005], [1004])
    assert [each["size"] for each in of_depth["sizes"]] == [[24, 16]]


@pytest.mark.parametrize(
    "attributes",
    [{"pinholeFocalLength": 1e38}, {"focus": 1e-38}, {"sensorPhotositePitch": 1e38}],
    ids=lambda each: next(iter(each)),
)
def test_metadata_out_of_range_are_named_by_file_and_attribute(attributes, tmp_path):
    planes = {name: np.ones((8, 8), np.float32) for name in "RGBZ"}
    rectangle = ((0, 0), (35, 23))
    known = {"focus": 2.0, "pinholeFocalLength": 50.0, "sensorAcquisitionRectangle": rectangle}
    known = {"sensorPhotositePitch": 1000.0, **known}
    file = write(tmp_path / "a.exr", planes, **known | attributes)
    words = ("--lens-from-metadata", "--fnumber", "2", "--depth-unit", "m")
    ran = run("render", file, file, "-o", tmp_path / "out", *words)
    refused(ran, 2, "malformed", next(iter(attributes)))
    assert "a.exr" in ran.err

"""Photographs as people have them: a first picture of one line."""

import re
import shlex

import numpy as np
import pytest
from command_line import color_exr, depth_exr, pair, ramp, read_exr, refused, run, succeed, texture
from depth_files import gdepth, png
from image_files import save

SIZE = (120, 160)


def photo(folder):
    return save(folder / "photo.png", (texture(*SIZE[::-1]) * 255).astype(np.uint8))


def disparity(*, dtype=np.uint8):
    numbers = np.full(SIZE, 10)
    numbers[40:90, 60:120] = 180
    return (numbers * (257 if dtype == np.uint16 else 1)).astype(dtype)


def taken(said):
    """The options that a first picture was taken with."""
    (options,) = re.findall(r"relative depth, taken with (--[^;]*)(?:;|$)", said.splitlines()[0])
    return options


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_first_picture_takes_one_line_and_says_how_it_was_taken(dtype, tmp_path):
    files = photo(tmp_path), png(tmp_path / "z.png", disparity(dtype=dtype), dtype)
    ran = succeed("render", *files, "-o", tmp_path / "a.png")
    assert taken(ran.err) == "--blur 3px --focus-at 89,64"
    again = run("render", *files, "-o", tmp_path / "b.png", *shlex.split(taken(ran.err)))
    assert "taken with" not in again.err
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    other = run("render", *files, "-o", tmp_path / "a.png", "--blur", "9px")
    assert taken(other.err) == "--focus-at 89,64"
    reversed_ = png(tmp_path / "r.png", np.iinfo(dtype).max - disparity(dtype=dtype), dtype)
    ran = succeed("render", files[0], reversed_, "-o", tmp_path / "r.png.png")
    assert taken(ran.err) == "--blur 3px --focus-at 89,64 --invert"
    assert "--no-invert" in ran.err
    chosen = ("--blur", "9px", "--focus-at", "89,64")
    alone = run("render", files[0], reversed_, "-o", tmp_path / "c.png", *chosen)
    assert taken(alone.err) == "--invert"
    folders = [tmp_path / name for name in ("colors", "depths")]
    for folder, file in zip(folders, (files[0], reversed_), strict=True):
        folder.mkdir()
        (folder / f"a{file.suffix}").write_bytes(file.read_bytes())
        (folder / f"b{file.suffix}").write_bytes(file.read_bytes())
    both = run("render", *folders, "-o", tmp_path / "all", *chosen)
    assert both.err.count("black is near, but white is taken as near; give --invert") == 2
    black = run("render", *files, "-o", tmp_path / "a.png", "--invert", "--blur", "9px")
    assert taken(black.err) == "--focus-at 59,59"


def test_all_of_the_subject_is_in_focus_unless_something_says_the_focus(tmp_path):
    leaning = disparity()
    leaning[40:90, 60:120] += (np.arange(50) // 4).astype(np.uint8)[:, None]
    files = photo(tmp_path), png(tmp_path / "z.png", leaning, np.uint8)
    ran = succeed("render", *files, "-o", tmp_path / "o", "--outputs", "coc")
    assert taken(ran.err).endswith("--sharp-range 180..192")
    radius = read_exr(tmp_path / "o/coc/photo.exr")["coc"]
    assert (radius[40:90, 60:120] == 0).all()
    assert (radius[:40] > 2.9).all()
    lens = tmp_path / "opening.toml"
    lens.write_text("blades = 6")
    for given in ("--focus-at 90,60", "--focus-value 185", f"--lens {lens}"):
        words = ("--overwrite", "--blur", "3px", *given.split())
        ran = run("render", *files, "-o", tmp_path / "b.png", *words)
        assert (ran.code, "sharp" in ran.err + ran.out) == (0, False), given


def test_a_share_of_the_longer_side_is_a_blur_and_the_line_says_the_radii_that_there_are(tmp_path):
    files = photo(tmp_path), png(tmp_path / "z.png", disparity(), np.uint8)
    focus = ("--focus-value", "10", "--outputs", "coc")
    share = succeed("render", *files, "-o", tmp_path / "a", *focus, "--blur", "2.5%")
    pixels = succeed("render", *files, "-o", tmp_path / "b", *focus, "--blur", "4px")
    first, second = (read_exr(tmp_path / name / "coc/photo.exr")["coc"] for name in "ab")
    np.testing.assert_array_equal(first, second)
    assert all("blur of 4px" in ran.out + ran.err for ran in (share, pixels))
    sharp = ("--sharp-range", "100..180", "--focus-value", "150", "--blur", "4px")
    ran = succeed("render", *files, "-o", tmp_path / "c", *sharp, "--outputs", "coc")
    assert "CoC 0.00 to 4.00 px" in ran.out + ran.err, "the card of 180 is sharp"
    refused(run("render", *files, "-o", tmp_path / "d", "--blur", "0%"), 2, "malformed", "blur")


def test_smaller_depth_is_guided_which_a_line_says_and_larger_refused_before_anything(tmp_path):
    color, small = photo(tmp_path), png(tmp_path / "z.png", disparity()[::2, ::2], np.uint8)
    ran = run("render", color, small, "-o", tmp_path / "a.png")
    assert taken(ran.err) == "--blur 3px --focus-at 89,65"
    assert "z.png: 80x60 px resized to 160x120 px, guided" in ran.err
    guided = run("render", color, small, "-o", tmp_path / "b.png", "--resize-depth", "guided")
    assert "resized to" not in guided.err, "who asks is told nothing"
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    large = png(tmp_path / "l.png", np.repeat(disparity(), 2, 1), np.uint8)
    refused(run("render", color, large, "-o", tmp_path / "c.png"), 3, "wrong-size", large)
    short = png(tmp_path / "s.png", disparity()[::4, ::2], np.uint8)
    refused(run("render", color, short, "-o", tmp_path / "c.png"), 3, "wrong-size", short)


def test_a_phones_photograph_is_one_file_and_one_line(tmp_path):
    depth = png(tmp_path / "d.png", 255 - disparity()[::2, ::2], np.uint8).read_bytes()
    picture = (texture(*SIZE[::-1]) * 255).astype(np.uint8)
    kind = {"Format": "RangeInverse", "Near": 0.5, "Far": 25.0}
    file = gdepth(tmp_path / "a.jpg", depth, picture=picture, **kind)
    ran = run("render", file, "-o", tmp_path / "a.png")
    assert (ran.code, taken(ran.err)) == (0, "--blur 3px --focus-at 89,65"), ran.err
    assert "--invert" not in ran.err, "the file says which end is near"
    file = gdepth(tmp_path / "m.jpg", depth, picture=picture, **kind, Units="m")
    refused(run("render", file, "-o", tmp_path / "m.png"), 2, "missing-option", "focal-length")


@pytest.mark.parametrize("given", ["", "--lens @hexagon-50"])
def test_metric_depth_gets_one_error_with_a_command_that_runs(given, tmp_path):
    files = color_exr(tmp_path / "a b.exr"), depth_exr(tmp_path / "z.exr")
    ran = run("render", *files, "-o", tmp_path / "out", *given.split())
    refused(ran, 2, "missing-option")
    command = shlex.split(ran.err.partition("run: ")[2])
    assert command[:2] == ["defocus", "render"]
    assert run(*command[1:]).code == 0, command
    assert (tmp_path / "out" / "render" / "a b.exr").exists()


def test_batches_never_guess(tmp_path):
    for stem in "ab":
        save(tmp_path / "rgb" / f"{stem}.png", (texture() * 255).astype(np.uint8))
        (tmp_path / "z").mkdir(exist_ok=True)
        png(tmp_path / "z" / f"{stem}.png", ramp() * 60, np.uint8)
    folders, out = (tmp_path / "rgb", tmp_path / "z"), ("-o", tmp_path / "out")
    ran = run("render", *folders, *out)
    refused(ran, 2, "missing-option", "focal-length")
    assert "of depth without a unit, --blur 2% and --focus-at X,Y" in ran.err
    refused(run("render", *folders, *out, "--blur", "8px"), 2, "missing-option", "blur")
    color, depth = pair(tmp_path)
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(f'[inputs]\ncolor = "{color}"\ndepth = "{depth}"\n[lens]\nblades = 5\n')
    refused(run("batch", jobs, *out), 2, "missing-option", "focal-length")


def subject(folder):
    """A photograph of a subject before a plane, depth that is 3 px too fat, and its matte."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    coverage = np.clip(40.5 - np.hypot(y - 60, x - 80), 0, 1)
    rgb = np.rint(255 * (0.2 + 0.6 * coverage))[..., None].repeat(3, 2).astype(np.uint8)
    fat = np.where(np.hypot(y - 60, x - 80) < 43, 200, 40)
    matte = np.rint(255 * coverage)[..., None].astype(np.uint8)
    depth = png(folder / "z.png", fat, np.uint8)
    return save(folder / "a.png", rgb), depth, save(folder / "matte.png", matte)


def test_a_matte_stands_in_jobs_files_and_in_the_journal(tmp_path):
    color, depth, matte = subject(tmp_path)
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(
        f'[inputs]\ncolor = "{color.name}"\ndepth = "{depth.name}"\nmatte = "{matte.name}"\n'
        '[lens]\nblur = "6px"\nfocus-value = 200\n[outputs]\nformat = "png"\n'
    )
    succeed("batch", jobs, "-o", tmp_path / "out", "--processes", "1")
    again = ("render", color, depth, "--matte", matte, "--blur", "6px", "--focus-value", "200")
    succeed(*again, "-o", tmp_path / "b.png")
    made = tmp_path / "out" / "render" / "a.png"
    assert made.read_bytes() == (tmp_path / "b.png").read_bytes()
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    save(matte, np.uint8(255 * (np.hypot(y - 60, x - 80) < 39))[..., None])
    succeed("batch", jobs, "-o", tmp_path / "out", "--processes", "1")
    assert made.read_bytes() != (tmp_path / "b.png").read_bytes(), "another matte, another picture"


@pytest.mark.parametrize(
    ("samples", "code"),
    [
        (np.zeros((60, 80, 1), np.uint8), ""),
        (np.zeros((9, 80, 1), np.uint8), "wrong-size"),
        ((texture(*SIZE[::-1]) * 255).astype(np.uint8), "not-one-channel"),
        (np.full((*SIZE, 1), 2, np.float32), "out-of-range"),
    ],
)
def test_a_matte_is_grey_and_of_the_shape_of_the_picture(samples, code, tmp_path):
    color, depth, _ = subject(tmp_path)
    matte = save(tmp_path / "m.tif", samples)
    words = ("--matte", matte, "--blur", "6px", "--focus-value", "200", "--no-invert")
    ran = run("render", color, depth, *words, "-o", tmp_path / "out.png")
    if code:
        refused(ran, 3, code, matte)
    else:
        assert ran.code == 0, ran.err

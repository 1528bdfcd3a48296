"""Each option of ``defocus render`` does what its name says."""

from pathlib import Path

import numpy as np
import pytest
from command_line import (
    LENS,
    PITCH,
    color_exr,
    depth_exr,
    files_under,
    header,
    pair,
    photograph,
    ramp,
    read_exr,
    render,
    succeed,
    texture,
)
from image_files import multi_part

from defocus_cli.commands.render import command
from defocus_core.io.images.raster import read_samples

SIZE = 64
ASKED = {"focal-length": "50mm", "fnumber": "2", "focus": "2m"}


def lens(**changes):
    """The options of `command_line.LENS` with some changed, or left out if None."""
    named = {**ASKED, **{name.replace("_", "-"): value for name, value in changes.items()}}
    return [word for name, value in named.items() if value for word in (f"--{name}", value)]


def coc(files, out, *args):
    succeed("render", *files, "-o", out, "--outputs", "coc", "--overwrite", *args)
    return read_exr(out / "coc" / f"{files[0].stem}.exr")["coc"]


def spot(folder, out, *args):
    """The image of a point of light far beyond the focus, [SIZE, SIZE]."""
    light = np.zeros((SIZE, SIZE, 3), np.float32)
    light[SIZE // 2, SIZE // 2] = 1000
    color = color_exr(folder / "light.exr", light)
    depth = depth_exr(folder / "far.exr", np.full((SIZE, SIZE), np.inf, np.float32))
    # r = A f / (s − f) / (2 p) = 16 px
    asked = lens(fnumber=f"{50 / 35.1}", sensor_width="1.8mm")
    succeed("render", color, depth, "-o", out, *asked, "--exr-type", "float", *args)
    return read_exr(out / "render" / "light.exr")["G"]


def reach(image):
    """How far a spot reaches from the middle, in px: left, right, up, down."""
    rows, columns = np.nonzero(image > image.max() / 2)
    middle = SIZE // 2
    left, right = middle - columns.min(), columns.max() - middle
    return int(left), int(right), int(middle - rows.min()), int(rows.max() - middle)


def test_blade_rotation_turns_it_counter_clockwise(tmp_path):
    args = ("--blades", "3", "--blade-rotation", "90")
    left, right, up, down = reach(spot(tmp_path, tmp_path / "out", *args))
    assert up == pytest.approx(16, abs=2)
    assert down == pytest.approx(8, abs=1)
    assert left == right == pytest.approx(16 * np.sin(np.pi / 3), abs=2)


def assert_depth(radius, metres):
    expected = 50 * 50 / (2 * 1950) * (1 - 2 / metres) / (2 * PITCH)
    np.testing.assert_allclose(radius, expected, atol=1e-5)


def planes(seed, prefix=""):
    rgb = texture(seed=seed)
    return {prefix + name: rgb[..., index].copy() for index, name in enumerate("RGB")}


def sharp(color, out, *args):
    """The red that is rendered with everything in focus: what was read."""
    depth = depth_exr(color.with_name("flat.exr"), np.full_like(ramp(), 2))
    photograph(color, depth, "-o", out, "--overwrite", "--exr-type", "float", *args)
    return read_exr(out / "render" / f"{color.stem}.exr")["R"]


def test_part_says_which_part_is_rendered_and_where_the_depth_is(tmp_path):
    color = multi_part(tmp_path / "p.exr", sun=planes(0), lamp=planes(1))
    for part in (0, 1):
        rendered = sharp(color, tmp_path / "out", "--part", str(part))
        np.testing.assert_allclose(rendered, planes(part)["R"], atol=1e-6)
    depth = multi_part(tmp_path / "z.exr", a={"Z": ramp()}, b={"Z": ramp() * 2})
    files = (color_exr(tmp_path / "c.exr"), depth)
    assert_depth(coc(files, tmp_path / "out", *LENS, "--part", "1"), ramp() * 2)


def test_machine_options_are_recorded(tmp_path):
    machine = ("--quality", "high", "--device", "cpu", "--threads", "3", "--tile", "64")
    ran = render(*pair(tmp_path), "-o", tmp_path / "out", *machine, "-v", "--json")
    assert "cpu (torch), 3 threads, high" in ran.err
    picture = ran.json["pictures"][0]
    assert (picture["device"], picture["quality"]) == ("cpu", "high")
    assert header(tmp_path / "out" / "render" / "a.exr")["defocus:device"] == "cpu"
    assert '"tile":64' in (tmp_path / "out" / "journal.jsonl").read_text()


def test_more_quality_is_another_picture(tmp_path):
    files, pictures = pair(tmp_path), []
    for quality in ("standard", "high"):
        out = tmp_path / quality
        wide = ("--fnumber", "0.5", "--quality", quality)
        photograph(*files, "-o", out, *wide)
        pictures.append(read_exr(out / "render" / "a.exr")["G"])
    assert np.abs(pictures[0] - pictures[1]).max() > 1e-3


def test_preview_shows_the_picture_as_it_looks(tmp_path):
    color = color_exr(tmp_path / "c.exr", np.full((16, 24, 3), 0.2140, np.float32))
    render(color, depth_exr(tmp_path / "z.exr"), "-o", tmp_path / "out", "--preview")
    assert files_under(tmp_path / "out") == {"render/c.exr", "render/c.preview.png"}
    samples = read_samples(tmp_path / "out" / "render" / "c.preview.png")
    assert samples.dtype == np.uint8
    assert np.abs(samples.astype(int) - 127).max() <= 1  # sRGB of 21.4 % light


def test_a_lower_jpeg_quality_makes_a_smaller_and_less_accurate_file(tmp_path):
    args = (*pair(tmp_path), "--format")
    render(*args, "png", "-o", tmp_path / "exact")
    exact = read_samples(tmp_path / "exact" / "render" / "a.png")
    sizes, errors = [], []
    for quality in ((), ("--jpeg-quality", "95"), ("--jpeg-quality", "50")):
        out = tmp_path / f"out{len(sizes)}"
        photograph(*args, "jpg", "-o", out, *quality)
        samples = read_samples(out / "render" / "a.jpg")
        sizes.append((out / "render" / "a.jpg").stat().st_size)
        errors.append(float(np.abs(samples.astype(float) - exact).mean()))
    assert sizes[0] == sizes[1] > sizes[2]
    assert errors[0] == errors[1] < errors[2] / 1.5


def test_every_option_is_tested_somewhere():
    tests = "".join(p.read_text() for p in Path(__file__).parents[1].rglob("test_*.py"))
    names = [max(param.opts, key=len) for param in command.params if param.opts[0][0] == "-"]
    assert len(names) > 20
    for name in names:
        short = {"--out": '"-o"', "--verbose": '"-v"'}.get(name, name)
        assert short in tests or name[2:].replace("-", "_") in tests, name

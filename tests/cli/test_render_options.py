"""Each option of ``defocus render`` does what its name says."""

from pathlib import Path

import numpy as np
from command_line import color_exr, depth_exr, files_under, header, pair, photograph, render
from image_files import samples_of

from defocus_cli.commands.render import command


def test_machine_options_are_recorded(tmp_path):
    machine = ("--quality", "high", "--device", "cpu", "--threads", "3", "--tile", "64")
    ran = render(*pair(tmp_path), "-o", tmp_path / "out", *machine, "-v", "--json")
    assert "cpu (torch), 3 threads, high" in ran.err
    picture = ran.json["pictures"][0]
    assert (picture["device"], picture["quality"]) == ("cpu", "high")
    assert header(tmp_path / "out" / "render" / "a.exr")["defocus:device"] == "cpu"
    assert '"tile":64' in (tmp_path / "out" / "journal.jsonl").read_text()


def test_preview_shows_the_picture_as_it_looks(tmp_path):
    color = color_exr(tmp_path / "c.exr", np.full((16, 24, 3), 0.2140, np.float32))
    render(color, depth_exr(tmp_path / "z.exr"), "-o", tmp_path / "out", "--preview")
    assert files_under(tmp_path / "out") == {"render/c.exr", "render/c.preview.png"}
    samples = samples_of(tmp_path / "out" / "render" / "c.preview.png")
    assert samples.dtype == np.uint8
    assert np.abs(samples.astype(int) - 127).max() <= 1  # sRGB of 21.4 % light


def test_a_lower_jpeg_quality_makes_a_smaller_and_less_accurate_file(tmp_path):
    args = (*pair(tmp_path), "--format")
    render(*args, "png", "-o", tmp_path / "exact")
    exact = samples_of(tmp_path / "exact" / "render" / "a.png")
    sizes, errors = [], []
    for quality in ((), ("--jpeg-quality", "95"), ("--jpeg-quality", "50")):
        out = tmp_path / f"out{len(sizes)}"
        photograph(*args, "jpg", "-o", out, *quality)
        samples = samples_of(out / "render" / "a.jpg")
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

"""What an EXR output carries of its input, and what it is said not to."""

from fractions import Fraction
from typing import Any

import numpy as np
import OpenEXR
from command_line import (
    HEIGHT,
    WIDTH,
    header,
    photograph,
    ramp,
    read_exr,
    refused_input,
    render,
    run,
)
from elements import write
from image_files import SCANLINE, box

from defocus_core.io.exr.header import Raw, read_headers

DEEP = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
X, Y = 5, -7  # of the display window's first pixel
DISPLAY = (X, Y, X + WIDTH - 1, Y + HEIGHT - 1)


def planes(names, height, width):
    rng = np.random.default_rng(1)
    return {name: 1 + rng.random((height, width), np.float32) for name in names}


def test_overscan_is_read_and_cropped_to_the_display_window_which_is_written_back(tmp_path, out):
    whole = planes("RGB", HEIGHT + 7, WIDTH + 5) | {"Z": np.full((HEIGHT + 7, WIDTH + 5), 2.0, "f")}
    data = box(X - 2, Y - 3, X + WIDTH + 2, Y + HEIGHT + 3)
    path = write(tmp_path / "a.exr", whole, dataWindow=data, displayWindow=box(*DISPLAY))
    ran = render(path, "-o", out, "-v", "--exr-type", "float", "--outputs", "render,coc")
    note = "overscan 2 px left, 3 top, 3 right, 4 bottom"
    assert ran.err.count(note) == 2, "of colour and depth"
    assert "warning" not in ran.err
    assert run("info", path).out.count(note) == 2
    for kind in ("render", "coc"):
        told = header(out / kind / "a.exr")
        for window in ("dataWindow", "displayWindow"):
            assert np.ravel(told[window]).tolist() == list(DISPLAY)
    seen = whole["R"][3 : 3 + HEIGHT, 2 : 2 + WIDTH]  # all of it is in focus
    np.testing.assert_array_equal(read_exr(out / "render" / "a.exr")["R"], seen)


def test_a_part_that_no_output_can_hold_is_said_to_be_left_out(tmp_path, depth, out):
    samples = np.empty((HEIGHT, WIDTH), dtype=object)
    for index in np.ndindex(samples.shape):
        samples[index] = np.ones(2, np.float32)
    parts = [
        OpenEXR.Part({"name": "rgb", **SCANLINE}, planes("RGB", HEIGHT, WIDTH)),
        OpenEXR.Part({"name": "samples", **DEEP}, {"mask": samples}),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    left_out = "part samples, which is deep, left out"
    ran = photograph(tmp_path / "a.exr", depth, "-o", out, "--outputs", "render,left")
    assert ran.err.count(f"a: warning: {left_out}\n") == 1
    for more in (("--format", "png"), ("--outputs", "coc")):
        args = (tmp_path / "a.exr", depth, "-o", out / more[1], *more)
        assert left_out not in render(*args).err


def test_attributes_of_any_type_and_text_come_back_as_they_were(tmp_path, depth, out):
    said: dict[str, Any] = {
        "framesPerSecond": Fraction(24000, 1001),
        "ours": OpenEXR.OpaqueAttribute(b"\1\2\xff", "madeHere"),
        "blob": OpenEXR.Bytes(b"xyz", "note"),
        "a name of more than 31 bytes, like those of some": 1.5,
        "owner": "J?rgen",
        "files": ["a", "J?rgen" * 40],
    }
    path = write(tmp_path / "a.exr", planes("RGB", HEIGHT, WIDTH), **said)
    path.write_bytes(path.read_bytes().replace(b"J?rgen", b"J\xfcrgen"))
    (given,) = read_headers(path)
    assert given.attributes["owner"] == Raw("string", b"J\xfcrgen")
    photograph(path, depth, "-o", out)
    (told,) = read_headers(out / "render" / "a.exr")
    assert {name: told.attributes[name] for name in said} == {
        name: given.attributes[name] for name in said
    }
    assert render(out / "render" / "a.exr", depth, "-o", tmp_path / "again").code == 0


def test_a_thumbnail_stays_behind_as_it_shows_the_picture_in_focus(tmp_path, depth, out):
    thumbnail = OpenEXR.PreviewImage(2, 1)
    path = write(tmp_path / "a.exr", planes("RGB", HEIGHT, WIDTH), preview=thumbnail)
    ran = render(path, depth, "-o", out, "-v")
    assert "its thumbnail, which is sharp, left out" in ran.err
    assert "preview" not in header(out / "render" / "a.exr")


def test_a_name_that_is_not_utf_8_is_not_called_damage(tmp_path, depth, out):
    for name in ("mask", "about"):
        channels = planes("RGB", HEIGHT, WIDTH) | {"mask": ramp()}
        path = write(tmp_path / f"{name}.exr", channels, about=1.0)
        path.write_bytes(path.read_bytes().replace(name.encode(), b"\xff" * len(name)))
        refused_input(render(path, depth, "-o", out), path, "not-utf-8")

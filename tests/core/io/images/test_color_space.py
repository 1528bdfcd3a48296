"""What a file says of its colours is taken, or it is said that it is not."""

import struct

import numpy as np
import pytest
from command_line import depth_exr, header, render, run, texture
from image_files import png_chunk, raw_png, save
from refusals import refuses

from defocus_core import read_color

PHOTOGRAPH = (texture() * 255).astype(np.uint8)
DEEP = (texture() * 65535).astype(np.uint16)


def profile(name):
    """An ICC profile of a display, with no more than its name."""
    text = name.encode() + b"\0"
    described = b"desc" + bytes(4) + struct.pack(">I", len(text)) + text + bytes(78)
    described += bytes(-len(described) % 4)
    signatures = (b"none", b"\2\x10\0\0", b"mntr", b"RGB ", b"XYZ ", b"acsp")
    white = (0xF6D6, 0x10000, 0xD32D)
    head = struct.pack(">I4s4s4s4s4s12x4s28x3I48x", 144 + len(described), *signatures, *white)
    return head + struct.pack(">I4sII", 1, b"desc", 144, len(described)) + described


@pytest.mark.parametrize("name", ["Display P3", "sRGB IEC61966-2.1"])
@pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
def test_a_profile_without_a_known_curve_is_said_not_to_be_applied(tmp_path, suffix, name):
    path = save(tmp_path / f"wide.{suffix}", PHOTOGRAPH, ICCProfile=profile(name))
    depth = depth_exr(tmp_path / "z.exr")
    ran = render(path, depth, "-o", tmp_path / "out", "-v", "--json", "--exr-type", "float")
    assert f"colour profile '{name}' is not applied; convert it" in ran.err
    assert len(ran.json["pictures"][0]["warnings"]) == 1
    assert "  colour: 8-bit, taken as sRGB" in ran.err
    assert f"'{name}' not applied" in run("info", path).out
    told = header(tmp_path / "out" / "render" / "wide.exr")["defocus:color_read_as"]
    assert told == f"8-bit, taken as sRGB, its colour profile '{name}' not applied"


def coded(path, *code):
    return raw_png(path, DEEP, png_chunk(b"cICP", bytes([*code, 0, 1])))


@pytest.mark.parametrize(
    ("code", "told", "unheeded"),
    [
        ((1, 13), "sRGB", ""),
        ((12, 13), "sRGB, primaries Display P3", ""),
        ((9, 13), "sRGB, primaries Rec. 2020", ""),
        ((12, 8), "linear, primaries Display P3", ""),
        ((1, 1), "sRGB", "g24_rec709_display"),
    ],
)
def test_a_code_of_colours_is_taken_or_said(tmp_path, code, told, unheeded):
    color = read_color(coded(tmp_path / "a.png", *code))
    words = f", its colour space {unheeded} not applied" if unheeded else ""
    assert color.note == f"16-bit, taken as {told}{words}"
    assert len(color.warnings) == bool(unheeded)


@pytest.mark.parametrize(("code", "curve"), [(16, "PQ"), (18, "HLG")])
def test_a_curve_of_hdr_television_is_refused(tmp_path, code, curve):
    with refuses("unsupported", curve):
        read_color(coded(tmp_path / "a.png", 9, code))


def test_a_profile_that_is_none_is_said_and_left_out(tmp_path):
    path = save(tmp_path / "a.jpg", PHOTOGRAPH, ICCProfile=bytes(36) + b"acsp" + bytes(400))
    ran = render(path, depth_exr(tmp_path / "z.exr"), "-o", tmp_path / "b.png")
    assert (ran.code, "damaged and left out" in ran.err) == (0, True)
    assert b"iCCP" not in (tmp_path / "b.png").read_bytes()

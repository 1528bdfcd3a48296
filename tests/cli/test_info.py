"""``defocus info`` says what is in a file, as ``defocus render`` would read it."""

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import (
    HEIGHT,
    LENS,
    WIDTH,
    color_exr,
    depth_exr,
    pair,
    ramp,
    refused,
    render,
    run,
    write_exr,
)


def holed_depth(path):
    metres = ramp()
    metres[0, :3] = np.inf
    metres[1, :2] = 0
    metres[2, 0] = np.nan
    return depth_exr(path, metres)


def test_files_are_told_with_range_sky_holes_and_channels(tmp_path):
    files = (holed_depth(tmp_path / "z.exr"), color_exr(tmp_path / "c.exr"))
    depth, color = run("info", "--json", *files).json["files"]
    assert depth["size"] == [WIDTH, HEIGHT]
    assert depth["parts"][0]["channels"] == {"Z": "float"}
    assert depth["color"] is color["depth"] is None
    wanted = {"range_m": [1.0, 4.0], "sky_pixels": 3, "invalid_pixels": 3, "coc_px": None}
    assert {name: depth["depth"][name] for name in wanted} == wanted
    assert color["color"] == {"channels": ["R", "G", "B"], "nonfinite_pixels": 0}
    assert "no depth channel" in color["depth_note"]


def test_with_a_lens_the_blur_is_that_of_render(tmp_path):
    color, depth = color_exr(tmp_path / "c.exr"), depth_exr(tmp_path / "z.exr")
    (record,) = run("info", "--json", depth, *LENS).json["files"]
    ran = render(color, depth, "-o", tmp_path / "out", "--outputs", "coc", "--json")
    assert record["depth"]["coc_px"] == pytest.approx(ran.json["pictures"][0]["coc_px"])
    assert record["depth"]["lens"]["focus_mm"] == 2000


def test_people_are_told_on_stdout(tmp_path):
    ran = run("info", holed_depth(tmp_path / "z.exr"), color_exr(tmp_path / "c.exr"), *LENS)
    assert ran.err == ""
    for words in (
        f"z.exr: {WIDTH}x{HEIGHT}",
        "1 m to 4 m, 3 sky and 3 invalid pixels",
        "CoC: -",
        "50mm f/2, focus 2m, sensor 36mm",
        "colour: R, G, B",
    ):
        assert words in ran.out


@pytest.mark.parametrize("hole", [np.nan, np.inf, -np.inf])
def test_the_blur_of_relative_depth_is_that_of_its_valid_pixels(hole, tmp_path):
    numbers = np.tile(np.float32([1, 2, 5]), (6, 3))
    numbers[0, 0] = hole
    depth = depth_exr(tmp_path / "z.exr", numbers)
    (file,) = run("info", depth, "--blur", "6px", "--focus-value", "2", "--json").json["files"]
    assert file["depth"]["coc_px"] == pytest.approx([-6, 2])
    assert file["depth"]["invalid_pixels"] == 1


@pytest.mark.parametrize(("map_format", "suffix"), [("exr", ".exr"), ("tiff", ".tif")])
def test_maps_that_render_wrote_are_told_with_their_range_and_are_no_depth(
    map_format, suffix, tmp_path
):
    out, (color, depth) = tmp_path / "out", pair(tmp_path)
    kinds = ("--outputs", "coc,disparity,trust", "--map-format", map_format)
    render(color, depth, "-o", out, *kinds)
    for kind, title in (("coc", "CoC"), ("disparity", "disparity"), ("trust", "trust")):
        path = out / kind / f"a{suffix}"
        written = oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)
        (record,) = run("info", "--json", path, *LENS).json["files"]
        unit = "range" if kind == "trust" else "range_px"
        wanted = {"kind": kind, unit: [float(written.min()), float(written.max())]}
        assert record["maps"] == [wanted]
        assert record["color"] is record["depth"] is None
        told = run("info", path).out
        assert f"  {title} map (" in told
        assert f"{written.min():.2f} to {written.max():.2f}" in told
        assert "no depth" not in told
    refused(render(color, path, "-o", tmp_path / "again"), 3, "no-depth", path)


def test_what_is_not_finite_in_a_map_is_outside_its_range(tmp_path):
    map_ = ramp()
    map_[0, 0], map_[0, 1] = np.nan, np.inf
    path = write_exr(tmp_path / "coc.exr", coc=map_)
    assert run("info", "--json", path).json["files"][0]["maps"][0]["range_px"] == [1.0, 4.0]
    path = write_exr(tmp_path / "none.exr", coc=map_[:1, :2])
    assert run("info", "--json", path).json["files"][0]["maps"][0]["range_px"] is None
    assert "no finite pixel" in run("info", path).out


def test_a_pixel_outside_one_file_is_said_and_the_others_are_told(tmp_path):
    small = depth_exr(tmp_path / "small.exr", ramp(4, 4))
    ran = run("info", small, depth_exr(tmp_path / "z.exr"), *LENS[:4], "--focus-at", "9,9")
    assert (ran.code, ran.out.splitlines()[0]) == (2, f"{tmp_path / 'z.exr'}: {WIDTH}x{HEIGHT}")
    assert ran.err.startswith(f"defocus: --focus-at: 9,9 lies outside {small}")


def test_what_comes_after_a_missing_file_is_told_too(tmp_path):
    files = (tmp_path / "no.exr", depth_exr(tmp_path / "z.exr"), tmp_path / "nor.exr")
    ran = run("info", *files)
    assert ran.code == 3
    assert "1 m to 4 m" in ran.out
    assert [line for line in ran.err.splitlines() if "no such file" in line] == [
        line for line in ran.err.splitlines() if line
    ]
    assert len(ran.err.splitlines()) == 2
    ran = run("info", "--json", *files)
    assert (ran.code, len(ran.json["files"])) == (3, 1)


def test_a_depth_that_hardly_suits_the_lens_is_doubted(tmp_path):
    path = depth_exr(tmp_path / "z.exr", ramp() / 1000)  # metres taken for millimetres
    ran = run("info", path, *LENS)
    assert "  warning: depth is nearer than the focal length" in ran.out
    (record,) = run("info", "--json", path, *LENS).json["files"]
    (warning,) = record["depth"]["warnings"]
    assert warning in ran.out
    (record,) = run("info", "--json", depth_exr(tmp_path / "y.exr"), *LENS).json["files"]
    assert record["depth"]["warnings"] == []

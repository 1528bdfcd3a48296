"""``defocus render`` writes what was asked for, where it was asked for, and nothing else."""

import math

import numpy as np
import OpenEXR
import pytest
from command_line import (
    HEIGHT,
    WIDTH,
    color_exr,
    depth_exr,
    files_under,
    header,
    pair,
    photograph,
    ramp,
    read_exr,
    refused,
    render,
    run,
    texture,
    thin_lens_radius,
    write_exr,
)
from elements import write
from image_files import box, multi_part

from defocus_core.io.exr.header import read_headers
from defocus_core.request.output_kinds import KINDS

EVERYTHING = ",".join(KINDS)


def test_coc_is_the_signed_radius_in_px_and_disparity_the_distance_of_half_discs(tmp_path):
    photograph(*pair(tmp_path), "-o", tmp_path / "out", "--outputs", "coc,disparity")
    coc, disparity = (
        read_exr(tmp_path / "out" / kind / "a.exr")[kind] for kind in ("coc", "disparity")
    )
    assert coc.dtype == np.float32
    np.testing.assert_allclose(coc, thin_lens_radius(ramp() * 1e3), atol=1e-5)
    np.testing.assert_allclose(disparity, coc * (8 / (3 * math.pi)), rtol=1e-6)


def scene_exr(path):
    rgb = texture()
    ids = np.arange(WIDTH * HEIGHT, dtype=np.uint32).reshape(HEIGHT, WIDTH)
    return write_exr(path, R=rgb[..., 0], G=rgb[..., 1], B=rgb[..., 2], Z=ramp(), id=ids)


def test_one_exr_with_depth_is_as_good_as_two_files(tmp_path):
    scene = scene_exr(tmp_path / "scenes" / "a.exr")
    lens = ("--exr-type", "float")
    render(scene, "-o", tmp_path / "one", *lens)
    render(scene.parent, "-o", tmp_path / "many", *lens)
    render(*pair(tmp_path), "-o", tmp_path / "two", *lens)
    one, many, two = (read_exr(tmp_path / n / "render" / "a.exr") for n in ("one", "many", "two"))
    for name in "RGB":
        np.testing.assert_array_equal(one[name], two[name])
        np.testing.assert_array_equal(one[name], many[name])
    for name, sharp in read_exr(scene).items():
        if name in ("Z", "id"):  # carried as they are
            assert one[name].dtype == sharp.dtype
            np.testing.assert_array_equal(one[name], sharp)


def test_an_output_exr_lies_where_the_display_window_of_the_input_does(tmp_path):
    height = 40  # several chunks
    rgb, metres = texture(WIDTH, height), ramp(WIDTH, height)
    planes = {**dict(zip("RGB", np.moveaxis(rgb, 2, 0), strict=True)), "Z": metres}
    data, display = box(-7, -5, WIDTH - 8, height - 6), box(-5, -4, WIDTH - 10, height - 8)
    write(tmp_path / "a.exr", planes, dataWindow=data, displayWindow=display)
    render(tmp_path / "a.exr", "-o", tmp_path / "out", "--outputs", EVERYTHING)
    for kind in KINDS:
        path = tmp_path / "out" / kind / "a.exr"
        said = header(path)
        for name in ("dataWindow", "displayWindow"):
            np.testing.assert_array_equal(said[name], display)
    carried = read_exr(tmp_path / "out" / "render" / "a.exr")["Z"]
    np.testing.assert_array_equal(carried, metres[1:-2, 2:-2])


def test_colour_and_depth_may_be_parts_of_one_exr(tmp_path):
    rgb, metres = texture(), ramp()
    metres[0, 0] = 1e10
    combined = {f"View.Combined.{name}": rgb[..., index] for index, name in enumerate("RGB")}
    depth = {"View.Depth.Z": metres}
    scene = multi_part(tmp_path / "a.exr", **{"View.Combined": combined, "View.Depth": depth})
    ran = render(scene, "-o", tmp_path / "out", "--outputs", "render,coc", "--json")
    beyond = thin_lens_radius(np.array([1e15]))[0]
    coc = read_exr(tmp_path / "out" / "coc" / "a.exr")["coc"]
    assert coc[0, 0] == pytest.approx(beyond)
    assert ran.json["pictures"][0]["coc_px"][1] == pytest.approx(beyond)
    rendered = read_exr(tmp_path / "out" / "render" / "a.exr")
    np.testing.assert_array_equal(rendered["View.Depth.Z"], metres)


@pytest.mark.parametrize(
    ("name", "suffix"), [("png", "png"), ("png16", "png"), ("tif", "tif"), ("jpeg", "jpg")]
)
def test_the_format_is_that_of_images_and_maps_stay_exr(tmp_path, name, suffix):
    out = tmp_path / "out"
    render(*pair(tmp_path), "-o", out, "--format", name, "--outputs", "render,coc")
    assert files_under(out) == {f"render/a.{suffix}", "coc/a.exr"}
    record = run("info", "--json", out / "render" / f"a.{suffix}").json["files"][0]
    assert record["size"] == [WIDTH, HEIGHT]
    bits = "uint16" if name in ("png16", "tif") else "uint8"
    assert set(record["parts"][0]["channels"].values()) == {bits}


def codec(path):
    return read_headers(path)[0].compression


def test_the_codec_of_exr_is_zip_unless_another_is_asked_for(tmp_path):
    color, depth = pair(tmp_path)
    header = {"compression": OpenEXR.B44_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, read_exr(color)).write(str(color))
    for asked, image, exact in (
        *(((), "zip", "zip"), ("piz", "piz", "piz"), ("dwaa:100", "dwaa:100", "dwaa:100")),
        *(("ZIPS", "zips", "zips"), ("none", "none", "none"), ("input", "b44", "b44")),
    ):
        out = tmp_path / f"out{len(asked)}{image[:4]}"
        options = ("--compression", asked) * bool(asked)
        photograph(color, depth, "-o", out, "--outputs", "render,coc", *options)
        found = [codec(out / kind / "a.exr") for kind in ("render", "coc")]
        assert found == [image, exact], asked
    png = ("--outputs", "render", "--format", "png", "--compression", "piz")
    refused(render(color, depth, "-o", out, *png), 2, "idle-option", "compression")
    refused(render(color, depth, "-o", out, "--compression", "b44"), 2, "malformed", "compression")


def test_the_same_input_and_settings_give_the_same_bytes(tmp_path):
    files = pair(tmp_path)
    for name, threads in (("one", "1"), ("elsewhere/two", "2")):
        options = ("--outputs", EVERYTHING, "--threads", threads)
        photograph(*files, "-o", tmp_path / name, *options)
    for kind in KINDS:
        one = (tmp_path / "one" / kind / "a.exr").read_bytes()
        assert one == (tmp_path / "elsewhere" / "two" / kind / "a.exr").read_bytes()


def test_outputs_say_how_they_were_made(tmp_path):
    options = ("--outputs", "render,coc", "--blades", "6", "--blade-rotation", "15deg")
    render(*pair(tmp_path), "-o", tmp_path / "out", *options)
    for kind in ("render", "coc"):
        attributes = header(tmp_path / "out" / kind / "a.exr")
        said = {"focal_length": "50mm", "fnumber": "2", "sensor_width": "36mm", "focus": "2m"}
        said |= {"blades": "6", "blade_rotation": "15deg", "quality": "standard", "kind": kind}
        said |= {"color": "a.exr"}
        assert said == {name: attributes[f"defocus:{name}"] for name in said}
        assert f"defocus {attributes['defocus:version']}" in run("--version").out.splitlines()
        assert str(tmp_path) not in str(attributes)


def test_focus_at_a_pixel_is_focus_at_its_depth_and_at_the_sky_at_infinity(tmp_path):
    metres = ramp()
    metres[0, 0] = np.inf
    color, depth = color_exr(tmp_path / "a.exr"), depth_exr(tmp_path / "z.exr", metres)
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--outputs", "coc", "--json")
    ran = run("render", color, depth, "-o", tmp_path / "out", *lens, "--focus-at", "5,3")
    assert read_exr(tmp_path / "out" / "coc" / "a.exr")["coc"][3, 5] == 0
    record = ran.json["pictures"][0]["lens"]
    assert record["focus_mm"] == pytest.approx(ramp()[3, 5] * 1e3)
    assert record["focus_at_px"] == [5, 3]
    at = run("render", color, depth, "-o", tmp_path / "at", *lens, "--focus-at", "0,0")
    inf = run("render", color, depth, "-o", tmp_path / "inf", *lens, "--focus", "inf")
    assert at.json["pictures"][0]["lens"]["focus_mm"] == "inf"
    assert at.json["pictures"][0]["coc_px"] == inf.json["pictures"][0]["coc_px"]


def test_a_link_is_no_name_for_a_picture(color, depth, here):
    (here / "link.png").symlink_to(depth)
    before = depth.read_bytes()
    refused(render(color, depth, "-o", "link.png"), 3, "exists", "link.png")
    photograph(color, depth, "-o", "link.png", "--overwrite")
    assert (depth.read_bytes(), (here / "link.png").is_symlink()) == (before, False)

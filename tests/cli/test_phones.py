"""Photographs of phones are given once: their depth, and often a sharp original, is inside."""

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import refused, run, succeed
from depth_files import dynamic_depth, gdepth, multi_picture, of_apple, png
from image_files import save
from optional_libraries import heic, heic_with_auxiliary

from defocus_core import read_color

SIZE = (48, 64)
BLUR = ("--blur", "8px", "--focus-at", "5,5")
INVERSE = {"Format": "RangeInverse", "Near": 0.5, "Far": 25.0, "Mime": "image/png"}
LINEAR = {"Format": "RangeLinear", "Near": 1.0, "Far": 5.0}


def detail():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    checks = np.where((x // 4 + y // 4) % 2, 220, 40).astype(np.uint8)
    return np.repeat(checks[..., None], 3, 2)


def near_left(size=(24, 32), *, near=20):
    """A quarter as many numbers as the picture has pixels: the left half near, for GDepth dark."""
    numbers = np.full(size, 255 - near)
    numbers[:, : size[1] // 2] = near
    return numbers


def photo(folder, *, sharp=True, **properties):
    image = png(folder / "depth.png", near_left(), np.uint8).read_bytes()
    original = save(folder / "sharp.jpg", detail()).read_bytes() if sharp else b""
    blurred = np.full((*SIZE, 3), 130, np.uint8)
    return gdepth(folder / "a.jpg", image, picture=blurred, sharp=original, **properties)


def pixels(path):
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT))


def contrast(half):
    return float(half[8:-8, 6:-6].std())


@pytest.mark.parametrize("properties", [INVERSE, LINEAR, {**LINEAR, "Units": "m"}], ids=str)
def test_a_portrait_is_rendered_of_its_sharp_original(properties, tmp_path):
    file = photo(tmp_path, **properties)
    ran = succeed("render", file, *BLUR, "-o", tmp_path / "out.jpg")
    assert "a.jpg: the sharp picture inside it is rendered" in ran.err
    made = pixels(tmp_path / "out.jpg")
    assert contrast(made[:, :32]) > 4 * contrast(made[:, 32:]), "the near half is in focus"
    told = run("info", file, *BLUR).out
    assert "the sharp picture inside it" in told
    assert "GDepth depth image" in told


def test_depth_without_units_is_no_depth_in_metres(tmp_path):
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus-at", "5,5")
    ran = run("render", photo(tmp_path, **LINEAR), *lens, "-o", tmp_path / "out.jpg")
    refused(ran, 3, "unknown-unit")
    assert "GDepth without Units, which is relative; give --blur" in ran.err
    file = photo(tmp_path, **LINEAR, Units="m")
    succeed("render", file, *lens, "-o", tmp_path / "out.jpg")


@pytest.mark.parametrize("by_elements", [False, True])
@pytest.mark.parametrize("units", ["Meters", "None"])
def test_dynamic_depth_is_read_behind_the_photograph(by_elements, units, tmp_path):
    depth = png(tmp_path / "depth.png", near_left(), np.uint8).read_bytes()
    told = {"Format": "RangeInverse", "Near": 0.5, "Far": 25.0, "Units": units}
    file = dynamic_depth(
        tmp_path / "a.jpg", depth, picture=detail(), by_elements=by_elements, **told
    )
    succeed("render", file, *BLUR, "-o", tmp_path / "out.jpg")
    made = pixels(tmp_path / "out.jpg")
    assert contrast(made[:, :32]) > 4 * contrast(made[:, 32:]), "the near half is in focus"
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus-at", "5,5")
    ran = run("render", file, *lens, "-o", tmp_path / "b.jpg")
    assert (ran.code == 0) == (units == "Meters"), ran.err


_AUXILIARY = ("2020:aux:hdrgainmap", "2018:aux:portraiteffectsmatte", "2019:aux:semantichairmatte")
GAIN, PERSON, HAIR = (f"urn:com:apple:photo:{name}" for name in _AUXILIARY)
ENDS = {"FloatMinValue": 0.1, "FloatMaxValue": 2.0}


def grey(values):
    return np.repeat(values[..., None], 3, 2).astype(np.uint8)


@pytest.mark.parametrize("kind", ["disparity", "depth"])
@pytest.mark.parametrize("by_elements", [False, True])
def test_a_further_picture_of_a_jpeg_is_its_depth_if_it_says_so(kind, by_elements, tmp_path):
    values = near_left(near=235 if kind == "disparity" else 20)
    depth = of_apple(kind, by_elements=by_elements, **ENDS), grey(values)
    file = multi_picture(tmp_path / "a.jpg", detail(), [(of_apple(GAIN), detail()), depth])
    lens = ("--lens", "@portrait-85", "--sensor-width", "9mm", "--focus-at", "5,5")
    for words in (BLUR, ("--blur", "8px"), lens):
        succeed("render", file, *words, "-o", tmp_path / "b.png", "--overwrite")
        made = pixels(tmp_path / "b.png")
        assert contrast(made[:, :32]) > 4 * contrast(made[:, 32:]), "the near half is in focus"
    assert "Apple JPEG depth image" in run("info", file).out


@pytest.mark.parametrize("xmp", [of_apple(GAIN), "<x hdrgm:Version='1.0'/>", ""])
def test_a_gain_map_and_a_second_view_are_no_depth(xmp, tmp_path):
    file = multi_picture(tmp_path / "a.jpg", detail(), [(xmp, grey(near_left()))])
    ran = run("render", file, *BLUR, "-o", tmp_path / "out.jpg")
    refused(ran, 3, "no-depth")
    assert "none of the further pictures in it says that it is depth" in ran.err


def test_mattes_inside_a_photograph_are_its_matte(tmp_path):
    png(tmp_path / "depth.png", near_left(), np.uint8)
    matte = np.zeros(SIZE)
    matte[:, :30] = 255
    halves = grey(near_left()), grey(matte * 0.5), grey(matte)
    told = of_apple("disparity", **ENDS), of_apple(PERSON), of_apple(HAIR)
    jpeg = multi_picture(tmp_path / "a.jpg", detail(), zip(told, halves, strict=True))
    heic_file = heic_with_auxiliary(tmp_path / "a.heic", detail(), matte, PERSON)
    for files in ((jpeg,), (heic_file, tmp_path / "depth.png")):
        said = succeed("render", *files, *BLUR, "-o", tmp_path / "own.png", "--overwrite").err
        assert "the matte of a person inside it is used" in said
        made = []
        for given in (matte, np.roll(matte, 4, 1)):
            file = png(tmp_path / "matte.png", given, np.uint8)
            words = ("--matte", file, "-o", tmp_path / "given.png", "--overwrite")
            succeed("render", *files, *BLUR, *words)
            made.append(pixels(tmp_path / "given.png"))
        own, other = (np.abs(pixels(tmp_path / "own.png") - each).mean() for each in made)
        assert own < 0.25 * other, "as if its matte were given"


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_a_heic_is_rendered_of_its_own_depth(kind, tmp_path):
    pillow_heif = pytest.importorskip("pillow_heif")
    file = tmp_path / "a.heic"
    pillow_heif.from_bytes("RGB", SIZE[::-1], detail().tobytes()).save(str(file), quality=95)
    np.testing.assert_allclose(read_color(file).pixels[4, 4:8], 0.022, atol=0.02)
    values = near_left(near=20 if kind == 2 else 235).astype(np.uint8)
    said = {"representation_type": kind, "z_near": 0.5, "z_far": 9.0, "d_min": 0.1, "d_max": 2.0}
    lens = ("--focal-length", "70mm", "--fnumber", "1", "--sensor-width", "7mm", *BLUR[2:])
    with heic(values, np.asarray(pillow_heif.open_heif(str(file))), **said):
        for words in (BLUR, lens, ("--blur", "8px")):
            succeed("render", file, *words, "-o", tmp_path / "b.png", "--overwrite")
            made = pixels(tmp_path / "b.png")
            assert contrast(made[:, :32]) > 4 * contrast(made[:, 32:])
        assert "colour: R, G, B" in run("info", file, *BLUR).out
    with heic(values, detail(), representation_type=kind, d_min=None):
        succeed("render", file, *BLUR, "-o", tmp_path / "c.png")
        made = pixels(tmp_path / "c.png")
        assert contrast(made[:, :32]) > 4 * contrast(made[:, 32:]), "without ends, relative"


def test_colour_and_depth_side_by_side_are_the_pair_of_both(tmp_path):
    color, depth = detail(), np.repeat(near_left(SIZE)[..., None], 3, 2).astype(np.uint8)
    pair = save(tmp_path / "a.png", color), png(tmp_path / "z.png", depth, np.uint8)
    both = save(tmp_path / "both.png", np.hstack([color, depth]))
    succeed("render", *pair, *BLUR, "-o", tmp_path / "apart.png")
    succeed("render", both, both, *BLUR, "--depth-format", "rgbd", "-o", tmp_path / "beside.png")
    assert np.array_equal(pixels(tmp_path / "beside.png"), pixels(tmp_path / "apart.png"))

"""Written files: whole or absent, the same bytes again, and back to the same pixels."""

from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import succeed, write_exr
from elements import write
from image_files import box, from_srgb
from refusals import files_end_at, refuses

from defocus_core import read_color
from defocus_core.io.exr.writing import write_exr_image
from defocus_core.io.images import encode
from defocus_core.io.images.describe import describe
from defocus_core.io.images.encode import FORMATS, write_map
from defocus_core.io.images.primaries import primaries_attribute
from defocus_core.picture.preview import diverging, largest

SUFFIXES = (".exr", *FORMATS)


def picture(channels=3, shape=(20, 30)):
    """Linear pixels 0…1; premultiplied if there is alpha, which then has zeros."""
    pixels = np.random.default_rng(5).random((*shape, channels), np.float32)
    if channels == 4:
        pixels[0, :, 3] = 0
        pixels[..., :3] *= pixels[..., 3:]
    return pixels


def write_image(path, pixels, channels, *, attributes, exr_type="half", **told):
    planes = tuple(np.moveaxis(pixels, 2, 0))
    if path.suffix == ".exr":
        named = dict(zip(channels, planes, strict=True))
        return write_exr_image(path, named, exr_type, attributes)
    return encode.write_image(path, planes, channels, attributes=attributes, **told)


# The file, the channels, what `write_image` is told, and the most that a value may be off by. The
# curve of sRGB is at most 2.3 steep; with alpha, half a step of alpha comes on top.
HALF_STEP = {8: 2.4 / 510, 16: 2.4 / 131070}
ROUND_TRIPS = [
    *(("a.exr", channels, {}, 5e-4) for channels in ("Y", "RGB", "RGBA")),
    *(("a.exr", channels, {"exr_type": "float"}, 0.0) for channels in ("Y", "RGB", "RGBA")),
    *(
        (name, channels, {"bits": bits}, HALF_STEP[bits] * (1.5 if channels == "RGBA" else 1))
        for name, bits in (("a.png", 8), ("a.png", 16), ("a.tif", 16))
        for channels in ("Y", "RGB", "RGBA")
    ),
    ("a.webp", "YA", {}, 0.01),
    ("a.webp", "RGBA", {}, 0.01),
    ("a.jpg", "RGB", {}, 0.01),
    ("a.jpg", "RGBA", {}, 0.01),
]


@pytest.mark.parametrize(("name", "channels", "told", "within"), ROUND_TRIPS)
def test_what_is_written_comes_back(name, channels, told, within, tmp_path, capfd):
    exact = name == "a.exr" or "bits" in told
    pixels = picture(len(channels), (16, 16)) if exact else flat(channels)
    warnings = write_image(tmp_path / name, pixels, channels, attributes={}, **told)
    assert [each for each in warnings if "alpha" not in each] == []
    assert bool(warnings) == (name == "a.jpg" and "A" in channels), "it shows colour over black"
    color = read_color(tmp_path / name)
    kept = channels.removesuffix("A") if name == "a.jpg" else channels
    if name == "a.webp":  # holds grey as three colours
        pixels, kept = pixels[..., [0, 0, 0, 1]] if channels == "YA" else pixels, "RGBA"
    assert color.channels == tuple(kept)
    np.testing.assert_allclose(color.pixels, pixels[..., : len(kept)], atol=within, rtol=0)
    kinds = {channel.type for channel in describe(tmp_path / name).parts[0].channels}
    wanted = f"uint{told.get('bits', 8)}"
    assert kinds == {told.get("exr_type", "half") if name == "a.exr" else wanted}
    assert capfd.readouterr() == ("", "")


def flat(channels):
    """Even colour, which codecs that lose detail keep."""
    values = {"Y": 0.2, "R": 0.5, "G": 0.25, "B": 0.125, "A": 0.5}
    return np.full((16, 16, len(channels)), [values[c] for c in channels], np.float32)


def left_behind(directory):
    """Files, and directories that are named like one; those made for a file may stay."""
    return sorted(path.name for path in directory.rglob("*") if path.is_file() or path.suffix)


def test_what_half_cannot_hold_is_clamped_and_counted(tmp_path):
    pixels = picture()
    pixels[3, 4] = 1e6
    pixels[5, 6, 0] = -70_000
    path = tmp_path / "a.exr"
    (warning,) = write_image(path, pixels, "RGB", attributes={})
    assert warning.startswith("2 pixels beyond ±65504")
    assert read_color(path).pixels.max() == 65504
    assert write_image(path, pixels, "RGB", exr_type="float", attributes={}) == []


def test_alpha_is_written_unassociated(tmp_path):
    pixels = np.full((1, 1, 4), 0.5, np.float32)  # white, half covering
    for name in ("a.png", "a.tif"):
        write_image(tmp_path / name, pixels, "RGBA", bits=16, attributes={})
        config = oiio.ImageSpec()
        config.attribute("oiio:UnassociatedAlpha", 1)
        file: Any = oiio.ImageInput.open(str(tmp_path / name), config)
        assert file.read_image("uint16")[0, 0].tolist() == [65535, 65535, 65535, 32768]


def test_tifffile_reads_maps_and_pictures_without_further_codecs(tmp_path):
    tifffile = pytest.importorskip("tifffile")  # the tests install no imagecodecs
    depth = np.linspace(1, 9, 48, dtype=np.float32).reshape(6, 8) ** 3
    write_map(tmp_path / "map.tif", depth)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "map.tif"), depth)
    write_image(tmp_path / "a.tif", np.ones((6, 8, 3), np.float32), "RGB", attributes={})
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.tif"), 65535)


def test_the_diverging_map_is_symmetric_about_focus():
    radius = np.array([[-8, -4, 0, 4, 8]], np.float32)
    near, half_near, focus, half_far, far = diverging(radius, largest(radius))[0]
    assert focus.tolist() == [1, 1, 1]
    np.testing.assert_allclose(half_near, (near + 1) / 2, rtol=1e-6)
    np.testing.assert_allclose(half_far, (far + 1) / 2, rtol=1e-6)
    assert near[0] > near[2]  # orange
    assert far[2] > far[0]  # blue
    # One scale for both sides: half as far from focus is half the colour.
    np.testing.assert_allclose(diverging(np.array([[-4, 8]], np.float32), 8.0)[0], [half_near, far])
    assert np.all(diverging(np.zeros((2, 2), np.float32), 0.0) == 1)


def test_overshoot_of_a_picture_within_white_is_no_loss(tmp_path):
    over = np.array([[[1.05, 0.5, -0.02]]], np.float32)
    for name in ("a.png", "a.jpg", "a.tif"):
        assert write_image(tmp_path / name, over, "RGB", attributes={}, has_clipped=False) == []
    p3 = primaries_attribute((0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290))
    green = np.array([[[0.0, 1.0, 0.0]]], np.float32)
    lost = write_image(tmp_path / "a.png", green, "RGB", attributes=p3, has_clipped=False)
    assert len(lost) == 2, "sRGB has no such green"


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_is_clipped_is_counted(suffix, tmp_path):
    pixels = picture()
    pixels[2, 3], pixels[2, 5, 0] = 7, np.nan
    pixels[2, 4] = 1.0000002  # white, as blur returns it
    pixels[3, 3:5, 1] = -0.2
    pixels[3, 5] = -1e-7  # black, as blur returns it
    assert sorted(write_image(tmp_path / f"a{suffix}", pixels, "RGB", attributes={})) == [
        "1 pixel NaN, written as black",
        "1 pixel brighter than white shown as white",
        "2 pixels below black shown as black",
    ]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_that_cannot_grow_leaves_the_old_one_and_nothing_else(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_image(path, picture(), "RGB", attributes={})
    size = path.stat().st_size
    path.write_text("old")
    for limit in (0, 50, size // 3, size - 1):
        for place in (path, tmp_path / f"new/deep/a{suffix}"):
            with files_end_at(limit), refuses("unwritable", "File too large", path=place):
                write_image(place, picture(), "RGB", attributes={})
    assert path.read_text() == "old"
    assert left_behind(tmp_path) == [path.name]
    with files_end_at(2**23):
        write_image(path, picture(), "RGB", attributes={})


@pytest.mark.parametrize("name", ["a.png", "a.webp"])
def test_a_slope_of_8_bits_has_no_bands_and_what_is_not_smooth_keeps_its_bytes(name, tmp_path):
    """Each square of 16 px has the mean of the slope, which is 3 levels over all of it."""
    levels = np.linspace(100.2, 103.4, 256, dtype=np.float32) + np.zeros((64, 1), np.float32)
    pixels = from_srgb(levels.astype(np.float64) / 255).astype(np.float32)[..., None].repeat(3, 2)
    smooth = np.arange(64)[:, None] < 48 + np.zeros((1, 256))

    def written(**told):
        path = tmp_path / name
        write_image(path, pixels, "RGB", attributes={}, **told)
        return oiio.ImageBuf(str(path)).get_pixels(oiio.UINT16 if told.get("bits") else oiio.UINT8)

    plain, seen = written(), written(smooth=smooth)
    assert np.array_equal(seen, written(smooth=smooth))
    if name == "a.png":
        means = (seen[:48, :, 0] - levels[:48]).reshape(3, 16, 16, 16).mean((1, 3))
        assert np.abs(means).max() < 0.1
        assert np.array_equal(seen[48:], plain[48:])
        assert np.array_equal(written(bits=16), written(bits=16, smooth=smooth))
    pixels = from_srgb(np.rint(levels) / 255).astype(np.float32)[..., None].repeat(3, 2)
    assert np.array_equal(written(), written(smooth=np.ones_like(smooth))), "levels stay"


def test_pictures_are_dithered_where_they_are_blurred_alone(tmp_path):
    """The left half is in focus and keeps its bytes; the right half is a slope of two levels."""
    x = np.arange(96, dtype=np.float32) + np.zeros((40, 1), np.float32)
    planes = dict.fromkeys("RGB", 0.2 + np.float32(2e-4) * x)
    file = write_exr(tmp_path / "a.exr", **planes, Z=np.where(x < 48, 1, 2).astype("f4"))
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus", "1m", "--format", "png")
    seen = []
    for out in ("one", "two"):
        succeed("render", file, "-o", tmp_path / out, *lens)
        pixels = oiio.ImageBuf(str(tmp_path / out / "render" / "a.png")).get_pixels(oiio.UINT8)
        seen.append(pixels[..., 0].astype(float))
    light = 255 * (1.055 * planes["R"].astype(float) ** (1 / 2.4) - 0.055)
    assert np.array_equal(*seen)
    windows = {"displayWindow": box(5, 5, 80, 30), "dataWindow": box(0, 0, 95, 39)}
    window = write(tmp_path / "w.exr", {"Z": planes["R"], **planes}, **windows)
    succeed("render", window, "-o", tmp_path / "w", *lens, "--keep-overscan")
    assert np.array_equal(seen[0][:, :44], np.rint(light)[:, :44])
    assert not np.array_equal(seen[0][:, 56:80], np.rint(light)[:, 56:80])
    assert abs(float((seen[0] - light)[12:28, 56:72].mean())) < 0.1

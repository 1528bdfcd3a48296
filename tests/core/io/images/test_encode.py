"""Written files: whole or absent, the same bytes again, and back to the same pixels."""

from contextlib import suppress
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import header
from refusals import files_end_at, refuses

from defocus_core.errors import UsageProblem
from defocus_core.io.images.color import read_color
from defocus_core.io.images.describe import describe
from defocus_core.io.images.encode import FORMATS, display_encoded, write_image, write_map
from defocus_core.io.images.primaries import primaries_attribute
from defocus_core.io.safe_files import written_whole
from defocus_core.picture.preview import diverging, largest, write_preview, write_signed_preview

SUFFIXES = (".exr", *FORMATS)
ATTRIBUTES = {"defocus:focus": "2m"}


def picture(channels=3, shape=(20, 30)):
    """Linear pixels 0…1; premultiplied if there is alpha, which then has zeros."""
    pixels = np.random.default_rng(5).random((*shape, channels), np.float32)
    if channels == 4:
        pixels[0, :, 3] = 0
        pixels[..., :3] *= pixels[..., 3:]
    return pixels


def left_behind(directory):
    """Files, and directories that are named like one; those made for a file may stay."""
    return sorted(path.name for path in directory.rglob("*") if path.is_file() or path.suffix)


@pytest.mark.parametrize("channels", ["Y", "RGB", "RGBA"])
def test_exr_keeps_what_its_type_can(tmp_path, channels):
    pixels = picture(len(channels)) * 300
    for exr_type, dtype in (("half", np.float16), ("float", np.float32)):
        path = tmp_path / f"{exr_type}.exr"
        assert write_image(path, pixels, channels, exr_type=exr_type, attributes={}) == []
        color = read_color(path)
        assert color.channels == tuple(channels)
        np.testing.assert_array_equal(color.pixels, pixels.astype(dtype))
        assert {channel.type for channel in describe(path).parts[0].channels} == {exr_type}


def test_what_half_cannot_hold_is_clamped_and_counted(tmp_path):
    pixels = picture()
    pixels[3, 4] = 1e6
    pixels[5, 6, 0] = -70_000
    path = tmp_path / "a.exr"
    (warning,) = write_image(path, pixels, "RGB", attributes={})
    assert warning.startswith("2 pixels beyond ±65504")
    assert read_color(path).pixels.max() == 65504
    assert write_image(path, pixels, "RGB", exr_type="float", attributes={}) == []


def test_everything_else_in_an_exr_goes_through(tmp_path):
    extras = {
        "Z": picture()[..., 0] * 1e9,
        "id": np.arange(600, dtype=np.uint32).reshape(20, 30),
        "albedo.R": picture()[..., 1].astype(np.float16),
        "R": np.zeros((20, 30), np.float16),  # must not replace the image's own
    }
    attributes = {**ATTRIBUTES, "owner": "someone"}
    path = tmp_path / "a.exr"
    write_image(path, picture(), "RGB", attributes=attributes, extras=extras)
    color = read_color(path)
    assert attributes.items() <= header(path).items()
    np.testing.assert_array_equal(color.pixels, picture().astype(np.float16))
    for name in ("Z", "id", "albedo.R"):
        assert color.extras[name].dtype == extras[name].dtype
        np.testing.assert_array_equal(color.extras[name], extras[name])


@pytest.mark.parametrize(("name", "bits"), [("a.png", 8), ("a.png", 16), ("a.tif", 16)])
@pytest.mark.parametrize("channels", ["Y", "RGB", "RGBA"])
def test_display_formats_come_back_within_half_a_step(tmp_path, name, bits, channels):
    pixels = picture(len(channels))
    assert write_image(tmp_path / name, pixels, channels, bits=bits, attributes={}) == []
    color = read_color(tmp_path / name)
    assert color.channels == tuple(channels)
    # The curve's slope is at most 2.3; with alpha, half a step of alpha comes on top.
    step = (2.3 + (len(channels) == 4)) * 0.5 / (2**bits - 1)
    np.testing.assert_allclose(color.pixels, pixels, atol=1.01 * step)


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


def test_jpeg_shows_the_colour_over_black_and_says_so(tmp_path):
    pixels = np.broadcast_to(np.array([0.5, 0.25, 0.125, 0.5], "f"), (16, 16, 4))
    (warning,) = write_image(tmp_path / "a.jpg", pixels, "RGBA", attributes={})
    assert "alpha" in warning
    color = read_color(tmp_path / "a.jpg")
    assert color.channels == ("R", "G", "B")
    np.testing.assert_allclose(color.pixels, pixels[..., :3], atol=0.01)


def test_clipped_highlights_are_counted(tmp_path):
    pixels = picture()
    pixels[2, 3] = 7
    pixels[2, 4] = 1.0000002  # white, as blur returns it
    pixels[2, 5, 0] = np.nan
    unknown, above = write_image(tmp_path / "a.png", pixels, "RGB", attributes={})
    assert above == "1 pixel brighter than white shown as white"
    assert unknown == "1 pixel NaN, written as black"


def test_a_webp_holds_grey_as_three_colours_and_alpha(tmp_path):
    pixels = np.full((16, 16, 2), (0.2, 0.5), np.float32)
    write_image(tmp_path / "a.webp", pixels, "YA", attributes={})
    color = read_color(tmp_path / "a.webp")
    assert color.channels == ("R", "G", "B", "A")
    np.testing.assert_allclose(color.pixels[..., 1:], pixels[..., [0, 0, 1]], atol=0.01)


@pytest.mark.parametrize("suffix", FORMATS)
def test_clipped_negative_colours_are_counted(suffix, tmp_path):
    pixels = picture()
    pixels[2, 3:5, 1] = -0.2
    pixels[2, 5] = -1e-7  # black, as blur returns it
    (warning,) = write_image(tmp_path / f"a{suffix}", pixels, "RGB", attributes={})
    assert warning == "2 pixels below black shown as black"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_same_picture_makes_the_same_bytes_without_a_date(suffix, tmp_path):
    for name in "ab":
        path = tmp_path / f"{name}{suffix}"
        write_image(path, picture(), "RGB", bits=16, attributes=ATTRIBUTES)
        assert not oiio.ImageBuf(str(path)).spec().get_string_attribute("DateTime")
    assert path.read_bytes() == (tmp_path / f"a{suffix}").read_bytes()


def test_an_unknown_suffix_is_refused(tmp_path):
    with refuses("wrong-type", ".exr, .png", kind=UsageProblem):
        write_image(tmp_path / "a.gif", picture(), "RGB", attributes={})


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_that_cannot_grow_leaves_the_old_one_and_nothing_else(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_text("old")
    for place in (path, tmp_path / f"new/deep/a{suffix}"):
        with files_end_at(50), refuses("unwritable", "File too large", path=place):
            write_image(place, picture(), "RGB", attributes={})
    assert path.read_text() == "old"
    assert left_behind(tmp_path) == [path.name]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_unwritable_output_is_an_input_error(tmp_path, suffix):
    (tmp_path / "file").touch()
    (tmp_path / f"taken{suffix}").mkdir()
    for path in (tmp_path / f"file/a{suffix}", tmp_path / f"taken{suffix}"):
        with refuses("unwritable"):
            write_image(path, picture(), "RGB", attributes={})
    assert left_behind(tmp_path) == sorted(["file", f"taken{suffix}"])


def test_an_interrupted_write_leaves_what_was_there(tmp_path):
    path = tmp_path / "made/a.bin"
    with suppress(KeyboardInterrupt), written_whole(path) as file:
        file.write(b"half")
        raise KeyboardInterrupt
    assert left_behind(tmp_path) == []
    with written_whole(path) as file:
        file.write(b"whole")
        assert path.name not in left_behind(tmp_path)
    assert path.read_bytes() == b"whole"
    assert left_behind(tmp_path) == ["a.bin"]


def test_nothing_is_printed(tmp_path, capfd):
    for suffix in SUFFIXES:
        write_image(tmp_path / f"a{suffix}", picture(4), "RGBA", attributes=ATTRIBUTES)
    assert capfd.readouterr() == ("", "")


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


def test_previews_are_8_bit_png(tmp_path):
    write_preview(tmp_path / "a.png", picture(4) * 2)
    write_signed_preview(tmp_path / "b.png", picture(1)[..., 0] - 0.5)
    for name in ("a.png", "b.png"):
        channels = describe(tmp_path / name).parts[0].channels
        assert [(each.name, each.type) for each in channels] == [(c, "uint8") for c in "RGB"]


@pytest.mark.filterwarnings("error")
def test_the_largest_of_all_floats_is_white_without_a_word():
    glare = np.full((1, 1, 3), np.finfo(np.float32).max, np.float32)
    encoded, clipped, _ = display_encoded(glare, "RGB", 8, keep_alpha=True)
    assert (encoded == 255).all()
    assert clipped == 1


def test_rounding_where_nothing_is_seen_is_not_clipped():
    nearly_clear = np.array([[[5e-9, 0, 0, 1e-9], [0.2, 0, 0, 0.1]]], np.float32)
    encoded, clipped, _ = display_encoded(nearly_clear, "RGBA", 8, keep_alpha=True)
    assert clipped == 1, "the second one alone"
    assert encoded[0, :, 3].tolist() == [0, 26]


def test_overshoot_of_a_picture_within_white_is_no_loss(tmp_path):
    over = np.array([[[1.05, 0.5, -0.02]]], np.float32)
    for name in ("a.png", "a.jpg", "a.tif"):
        assert write_image(tmp_path / name, over, "RGB", attributes={}, has_clipped=False) == []
    p3 = primaries_attribute((0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290))
    green = np.array([[[0.0, 1.0, 0.0]]], np.float32)
    lost = write_image(tmp_path / "a.png", green, "RGB", attributes=p3, has_clipped=False)
    assert len(lost) == 2, "sRGB has no such green"

"""What happened to a picture is named, and what changes no value is not taken for a difference."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from command_line import run, succeed
from elements import write
from image_files import box, from_srgb, multi_part, save, to_srgb
from planted_faults import (
    HEIGHT,
    WIDTH,
    blurred,
    converted,
    halved,
    of_channel,
    planes,
    pulled,
    resized,
    scene,
    through_disc,
    warped,
)

from defocus_core import compare_images

Pixels = np.ndarray[Any, Any]
P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)


def _shifted(image, dx, dy):
    rows = (np.arange(HEIGHT) - dy).clip(0, HEIGHT - 1)
    columns = (np.arange(WIDTH) - dx).clip(0, WIDTH - 1)
    return image[rows][:, columns]


def _block(image, value):
    image = image.copy()
    image[10:14, 20:24] = value
    return image


def _cut(image):
    kept = np.zeros_like(image)
    kept[8:70, 5:100] = image[8:70, 5:100]
    return kept


def _encoded(image):
    return to_srgb(np.clip(image, 0, 1))


def _noise(image, amount):
    return amount * np.random.default_rng(1).standard_normal(image.shape)


# What is done, and words of the line.
FAULTS: dict[str, tuple[Callable[[Pixels], Pixels], str]] = {
    "right": (lambda a: _shifted(a, 1, 0), "shifted by (1, 0)"),
    "left and down": (lambda a: _shifted(a, -3, 2), "shifted by (-3, 2)"),
    "around": (lambda a: np.roll(a, -5, 0), "shifted by (0, -5)"),
    "half a pixel": (lambda a: (blurred(a, 1) + np.roll(blurred(a, 1), 1, 1)) / 2, "at edges"),
    "mirrored": (lambda a: a[:, ::-1], "flipped left to right"),
    "upside down": (lambda a: a[::-1], "flipped upside down"),
    "turned": (lambda a: a[::-1, ::-1], "rotated by 180°"),
    "BGR": (lambda a: a[..., ::-1], "channels swapped: R is B, B is R"),
    "GBR": (lambda a: a[..., [1, 2, 0]], "channels swapped: R is G, G is B, B is R"),
    "gamma 2 %": (lambda a: a**1.02, "another gamma: to the power 1.02"),
    "gamma 2.2": (lambda a: a ** (1 / 2.2), "another gamma: to the power 0.4545"),
    "encoded twice": (to_srgb, "another gamma: sRGB-encoded once more"),
    "a stop": (lambda a: 2 * a, "another exposure: x 2 (+1 EV)"),
    "2 % darker": (lambda a: 0.98 * a, "another exposure: x 0.98"),
    "warmer": (
        lambda a: a * np.float32([1.25, 1, 0.75]),
        "another exposure of each channel: R x 1.25 (+0.322 EV), B x 0.75 (-0.415 EV)",
    ),
    "clipped": (lambda a: np.minimum(a, 1), "clipped at 1,"),
    "8 bits": (
        lambda a: from_srgb(np.rint(_encoded(a) * 255) / 255),
        "clipped at 1, quantised to 8 bits",
    ),
    "8 bits, linear": (lambda a: np.rint(np.clip(a, 0, 1) * 255) / 255, "quantised to 8 bits"),
    "larger blur": (lambda a: blurred(a, 2), "softer by about"),
    "window of data": (_cut, "crop: 0 outside of 95x62 at 5,8"),
    "cut": (lambda a: a[8:70, 5:100], "crop: 95x62 at 5,8 of 128x90"),
    "half of the size": (lambda a: a[::2, ::2], "another size: 64x45"),
    "on its side": (np.rot90, "rotated by 90° to the left"),
    "NaN": (lambda a: _block(a, np.nan), "NaN in 16 pixels, the first at 20,10"),
    "Inf": (lambda a: _block(a, np.inf), "Inf in 16 pixels, the first at 20,10"),
    "negative": (lambda a: 1 - a, "inverted: x -1, +1 of light"),
    "black": (lambda a: 0 * a, "empty: R 0, G 0, B 0 everywhere"),
    "noise": (lambda a: a + _noise(a, 0.01), "noise of about 0.0"),
    # Of one channel.
    "red moved": (lambda a: of_channel(a, 0, warped(a, dx=0.8)), "R: shifted by (0."),
    "green offset": (lambda a: a + np.float32([0, 0.02, 0]), "G: offset or contrast: +0.02"),
    "blue noisy": (lambda a: of_channel(a, 2, a + _noise(a, 0.02)), "B: noise of about 0.0"),
    # Of colour spaces.
    **{
        name: (partial(converted, name), f"primaries or saturation: {name} instead of Rec. 709")
        for name in ("Rec. 2020", "Display P3", "ACES AP1", "ACES AP0")
    },
    "grey": (
        lambda a: (a @ np.float32([0.2126, 0.7152, 0.0722]))[..., None].repeat(3, axis=2),
        "primaries or saturation: saturation x 0",
    ),
    # Of rivals, which soften.
    "disc of 2 px": (through_disc, "softer by about 1.8 px"),
    "half, bilinear": (
        lambda a: resized(halved(a), a.shape, "triangle"),
        "lower resolution: half resolution, bilinear",
    ),
    "blurred down the frame": (pulled, "softer by about"),
    "sharpened": (lambda a: a + 0.6 * (a - blurred(a, 1)), "sharper by about"),
    # Small ones.
    "a tenth of a pixel": (lambda a: warped(a, dx=0.1), "shifted by (0.1"),
    "a twentieth of a pixel": (lambda a: warped(a, dx=0.05), "shifted by (0.05"),
    "blue enlarged": (lambda a: of_channel(a, 2, warped(a, scale=1.006)), "B: scaled by 1.006,"),
    "a little of light": (lambda a: a + 0.003, "offset or contrast: +0.00"),
}


def dark_border(image):
    image = image.copy()
    image[:6] = image[-5:] = image[:, :9] = 0.0
    return image


def windowed(path, image, data):
    """With the display window of the scene, whatever the data window is."""
    write(path, planes(image), dataWindow=data, displayWindow=box(0, 0, WIDTH - 1, HEIGHT - 1))


def narrow(path, image):
    """Less data than is shown, with 0 in what is not there."""
    windowed(path, image[6:-5, 9:], box(9, 6, WIDTH - 1, HEIGHT - 6))


def _wide(path, image):
    """More data than is shown."""
    padded = np.pad(image, ((4, 4), (8, 8), (0, 0)), constant_values=9.0)
    windowed(path, padded, box(-8, -4, WIDTH + 7, HEIGHT + 3))


def _parts(path, image, order="RGB"):
    """Each channel in a part of its own, in an order."""
    every = planes(image)
    multi_part(path, **{name: {name: every[name]} for name in order})


def _written(compression=None, dtype=np.float16, **header):
    codec = compression and getattr(OpenEXR, f"{compression}_COMPRESSION")
    header |= {"compression": codec} if codec else {}
    return lambda path, image: write(path, planes(image, dtype), **header)


def _tiles(path, image, tile=(32, 16)):
    save(path, image.astype(np.float16), tile=tile)


# Codecs that change no half.
_LOSSLESS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "HTJ2K32", "HTJ2K256")
# Ways to write the scene anew that change no value, by name.
BENIGN: dict[str, Callable[[Path, Pixels], Any]] = {
    **{f"codec {name}": _written(name) for name in _LOSSLESS},
    "tiles": _tiles,
    "smaller tiles": partial(_tiles, tile=(16, 16)),
    "float of half": _written(dtype=np.float32),
    "a float of half in PIZ": _written("PIZ", np.float32),
    "metadata": _written(comments="another day", owner="somebody else"),
    "owner and time": _written(owner="them", capDate="2001:01:01 00:00:00"),
    "more data than is shown": _wide,
    "a part for each channel": _parts,
    "parts in another order of channels": partial(_parts, order="BRG"),
    "lines from the bottom": _written(lineOrder=OpenEXR.DECREASING_Y),
}


def names(record):
    return [finding.name for finding in record.findings]


@pytest.fixture
def a(tmp_path):
    return write(tmp_path / "a.exr", planes(scene()))


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_fails_and_is_named(fault, tmp_path):
    change, words = FAULTS[fault]
    dtype = (np.float16, np.float32)[list(FAULTS).index(fault) % 2]
    a = write(tmp_path / "a.exr", planes(scene(), dtype))
    b = write(tmp_path / "b.exr", planes(change(scene()), dtype))
    ran = run("compare", a, b, "--json")
    assert (ran.code, ran.err) == (1, "")
    (pair,) = ran.json["pairs"]
    assert words in f"{pair['line']},"
    for finding in pair["findings"]:
        assert not compare_images(a, b, fail=[f"found:{finding['name']}"]).passes  # rules know it


def test_what_is_sharper_is_told_from_what_is_softer(a, tmp_path):
    b = write(tmp_path / "b.exr", planes(blurred(scene(), 2)))
    (finding,) = compare_images(b, a).findings
    assert finding.text == "sharper by about 3.9 px"


_OF_INTEGERS = ["right", "left and down", "mirrored", "upside down", "turned", "BGR", "cut"]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("fault", [*_OF_INTEGERS, "gamma 2.2", "a stop", "2 % darker"])
def test_faults_of_integers_are_named(fault, dtype, tmp_path):
    change, words = FAULTS[fault]
    top = np.iinfo(dtype).max
    stored = np.rint(to_srgb(scene().clip(0, 1)) * top).astype(dtype)
    if "stop" in fault or "darker" in fault:  # exposure is of light
        spoiled = to_srgb(np.clip(change(from_srgb(stored / top)), 0, 1))
    else:
        spoiled = change((stored / top).astype(np.float32))
    a = save(tmp_path / "a.png", stored)
    b = save(tmp_path / "b.png", np.rint(spoiled * top).astype(dtype))
    ran = run("compare", a, b)
    assert ran.code == 1
    # Factors and powers are as exact as the integers.
    assert (words if fault in _OF_INTEGERS else words.partition(":")[0]) in ran.out


def test_a_picture_of_16_bits_is_quantised_to_8_in_a_file_of_8_bits(tmp_path):
    encoded = to_srgb(scene().clip(0, 1))
    a = save(tmp_path / "a.png", np.rint(encoded * 65535).astype(np.uint16))
    b = save(tmp_path / "b.png", np.rint(encoded * 255).astype(np.uint8))
    record = compare_images(a, b)
    assert names(record) == ["quantised to 8 bits"]
    assert record.notes == ("R, G, B uint8 instead of uint16",)


def test_light_in_an_exr_and_in_a_png_are_compared_as_light(a, tmp_path):
    encoded = to_srgb(scene().clip(0, 1))
    b = save(tmp_path / "b.png", np.rint(encoded * 255).astype(np.uint8))
    record = compare_images(a, b)
    texts = [finding.text for finding in record.findings]
    assert texts == ["clipped at 1", "quantised to 8 bits (sRGB-encoded)"]
    assert record.encoding == "linear"


def test_views_that_were_swapped_are_named(tmp_path):
    left, right = planes(scene()), planes(np.roll(scene(), 3, 1) ** 1.3)
    for folder, first, second in (("a", left, right), ("b", right, left)):
        write(tmp_path / folder / "left" / "x.exr", first)
        write(tmp_path / folder / "right" / "x.exr", second)
        write(tmp_path / folder / "y_left.exr", first)
        write(tmp_path / folder / "y_right.exr", second)
        views = {f"left.{n}": p for n, p in first.items()}
        write(tmp_path / folder / "z.exr", views | {f"right.{n}": p for n, p in second.items()})
    ran = run("compare", tmp_path / "a", tmp_path / "b")
    assert ran.out.count("DIFFERENT: left and right swapped,") == 5


def test_a_missing_and_a_further_channel_are_named(tmp_path):
    whole = {**planes(scene()), "A": np.ones((HEIGHT, WIDTH), np.float16)}
    part = {name: plane for name, plane in whole.items() if name != "B"}
    a, b = write(tmp_path / "a.exr", whole), write(tmp_path / "b.exr", part)
    assert "DIFFERENT: missing channel B" in run("compare", a, b).out
    assert "DIFFERENT: further channel B" in run("compare", b, a).out
    loose = run("compare", a, b, "--fail", "max>100")
    assert loose.code == 1


def test_rounding_to_half_is_named(tmp_path):
    values = {
        name: plane * np.float32(1.0001) for name, plane in planes(scene(), np.float32).items()
    }
    a = write(tmp_path / "a.exr", values)
    b = write(tmp_path / "b.exr", {n: p.astype(np.float16) for n, p in values.items()})
    assert names(compare_images(a, b)) == ["rounded to half"]


@pytest.mark.parametrize("change", ["another picture", "a patch"])
def test_what_is_not_understood_gets_no_cause(change, a, tmp_path):
    spoiled = scene()
    if change == "a patch":
        spoiled[20:30, 50:61] = np.random.default_rng(3).random((10, 11, 3))
    else:
        spoiled = np.random.default_rng(3).random(spoiled.shape)
    b = write(tmp_path / "b.exr", planes(spoiled))
    record = compare_images(a, b)
    assert record.status == "different"
    place = ["in one region"] if change == "a patch" else []
    assert names(record) == place
    if place:
        assert record.window == (50, 20, 11, 10)
        assert "in one region of 11x10 at 50,20" in run("compare", a, b).out


@pytest.mark.parametrize("how", BENIGN)
def test_the_same_values_written_in_another_way_are_the_same(how, a, tmp_path):
    BENIGN[how](tmp_path / "b.exr", scene())
    ran = run("compare", a, tmp_path / "b.exr")
    assert (ran.code, ran.err) == (0, "")
    assert ran.out.startswith("b.exr: same")
    assert run("compare", tmp_path / "b.exr", a).code == 0
    assert compare_images(a, tmp_path / "b.exr").findings == ()


def test_what_differs_without_changing_a_value_is_noted(a, tmp_path):
    BENIGN["codec PIZ"](tmp_path / "b.exr", scene())
    assert compare_images(a, tmp_path / "b.exr").notes == ("compression PIZ instead of ZIP",)
    BENIGN["float of half"](tmp_path / "b.exr", scene())
    assert compare_images(a, tmp_path / "b.exr").notes == ("R, G, B float instead of half",)
    BENIGN["more data than is shown"](tmp_path / "b.exr", scene())
    (note,) = compare_images(a, tmp_path / "b.exr").notes
    assert note == "data window 144x98 at -8,-4 instead of 128x90 at 0,0"


def test_zero_outside_of_a_smaller_data_window_is_the_same(tmp_path):
    a = write(tmp_path / "a.exr", planes(dark_border(scene())))
    narrow(tmp_path / "b.exr", scene())
    assert compare_images(a, tmp_path / "b.exr").status == "same"
    narrow(tmp_path / "c.exr", 2 * scene())
    assert compare_images(a, tmp_path / "c.exr").status == "different"


def test_minus_zero_is_zero_and_nan_is_nan(tmp_path):
    image = scene()
    image[:4] = 0.0
    image[5, 6], image[7, 8], image[9, 9] = np.nan, np.inf, -np.inf
    a = write(tmp_path / "a.exr", planes(image))
    image[:4] = -0.0
    b = write(tmp_path / "b.exr", planes(image))
    record = compare_images(a, b)
    assert record.status == "same"
    assert record.notes == ("NaN in 1 pixel of both", "Inf in 2 pixels of both")


def test_metadata_counts_only_if_asked_for(a, tmp_path):
    b = tmp_path / "b.exr"
    BENIGN["metadata"](b, scene())
    assert "metadata: comments another day instead of nothing" in run("compare", a, b).out
    ran = run("compare", a, b, "--metadata")
    assert ran.code == 1
    assert "DIFFERENT" in ran.out


def test_the_same_numbers_in_other_primaries_are_a_warning(tmp_path):
    for folder, more in (("A", {}), ("B", {"chromaticities": P3})):
        write(tmp_path / folder / "a.exr", planes(scene()), **more)
    a, b = tmp_path / "A", tmp_path / "B"
    said = "a.exr: warning: other primaries declared: Display P3 instead of Rec. 709"
    ran = run("compare", a, b)
    assert (ran.code, ran.out.startswith(said)) == (0, True), ran.out
    assert run("compare", a, b, "--fail", "found:other primaries declared").code == 1
    assert run("compare", a / "a.exr", b / "a.exr").out.startswith(said)
    assert "primaries" not in run("compare", a, b, "--ignore-metadata", "chromaticities").out


@pytest.mark.parametrize(("samples", "other"), [("png", "tif"), ("png", "png16"), ("tif", "tiles")])
def test_integers_written_in_another_way_are_the_same(samples, other, tmp_path):
    values = (to_srgb(scene().clip(0, 1)) * 255).astype(np.uint8)
    a = save(tmp_path / f"a.{samples}", values)
    ways = {
        "tif": lambda: save(tmp_path / "b.tif", values, Compression="lzw"),
        "png16": lambda: save(tmp_path / "b.png", values.astype(np.uint16) * 257),
        "tiles": lambda: save(tmp_path / "b.tif", values, tile=(16, 16)),
    }
    assert compare_images(a, ways[other]()).status == "same"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("swap", [False, True])
def test_nan_and_inf_on_one_side_fail_whatever_the_thresholds(value, swap, a, tmp_path):
    image = scene()
    image[40, 60] = value
    b = write(tmp_path / "b.exr", planes(image))
    sides = (b, a) if swap else (a, b)
    ran = run("compare", *sides, "--fail", "max>1e9", "--fail", "psnr<0")
    assert ran.code == 1
    assert ("NaN in 1 pixel" if np.isnan(value) else "Inf in 1 pixel") in ran.out
    assert "elsewhere equal, worst at 60,40" in ran.out


def test_infinities_of_another_sign_differ(tmp_path):
    image = scene()
    image[40, 60] = np.inf
    a = write(tmp_path / "a.exr", planes(image))
    image[40, 60] = -np.inf
    b = write(tmp_path / "b.exr", planes(image))
    assert compare_images(a, b).status == "different"


def test_renders_by_another_fnumber_have_another_coc(tmp_path):
    folder = Path(__file__).parents[3] / "sample_scenes" / "spheres"
    for fnumber in ("2", "4"):
        lens = ["--focal-length", "75mm", "--sensor-width", "54mm", "--focus", "1.6m"]
        words = ["--fnumber", fnumber, "-o", tmp_path / fnumber]
        succeed("render", folder / "rgb.exr", folder / "depth.exr", *lens, *words)
    files = [tmp_path / fnumber / "render" / "rgb.exr" for fnumber in ("2", "4")]
    (finding,) = compare_images(*files).findings
    assert finding.name == "another CoC"
    assert "sharper" in finding.text
    assert "fnumber 4 instead of 2" in finding.text


def test_what_rounding_hides_is_too_small_to_name(tmp_path):
    shown = np.rint(to_srgb(scene().clip(0, 1)) * 255).astype(np.uint8)
    steps = np.random.default_rng(2).random(shown.shape) < 0.2
    a = save(tmp_path / "a.png", shown.clip(1, 254))
    b = save(tmp_path / "b.png", shown.clip(1, 254) + steps)
    record = compare_images(a, b)
    assert names(record) == ["too small to name"]


def test_what_is_softer_and_sharper_in_places_is_told(a, tmp_path):
    """The left half gets blurrier and the right half, blurred in A, gets sharper."""
    half = np.arange(WIDTH)[None, :, None] < WIDTH // 2
    one = np.where(half, scene(), blurred(scene(), 3))
    other = np.where(half, blurred(scene(), 3), scene())
    a = write(tmp_path / "one.exr", planes(one))
    b = write(tmp_path / "other.exr", planes(other))
    (finding,) = compare_images(a, b).findings
    assert {word.split()[0] for word in finding.text.split(", ")} == {"softer", "sharper"}


@pytest.mark.parametrize("light", [True, False], ids=["beside light", "alone"])
def test_depth_is_multiplied_or_offset_and_not_exposed(light, tmp_path):
    color = planes(scene()) if light else {}
    depth = 1 + 4 * scene()[..., 0].clip(0, 1)
    a = write(tmp_path / "a.exr", {**color, "Z": depth})
    texts = "multiplied: x 1000", "offset or contrast: +2 of its values"
    for change, text in zip((depth * 1000, depth + 2), texts, strict=True):
        b = write(tmp_path / "b.exr", {**color, "Z": change.astype(np.float32)})
        assert [f.text for f in compare_images(a, b).findings] == ["Z: " * light + text]


def _soft():
    """A picture without fine detail, as those of many pixels are, with a little grain."""
    y, x = np.mgrid[0:256, 0:384]
    light = 0.4 + 0.2 * np.sin(y / 31) * np.cos(x / 43)
    grain = 1 + 0.01 * np.random.default_rng(3).standard_normal((256, 384))
    return (light * grain)[..., None] * np.float32([1, 0.8, 0.6])


def _brighter_patch(image):
    b = image.copy()
    b[128:192, 192:256] *= 1.3
    return b


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda a: a[::2, ::2].repeat(2, axis=0).repeat(2, axis=1), "lower resolution"),
        (_brighter_patch, "in one region"),
    ],
    ids=["pixels left out", "a patch"],
)
def test_what_befalls_a_soft_picture_is_told(change, name, tmp_path):
    a = write(tmp_path / "a.exr", planes(_soft(), np.float32))
    b = write(tmp_path / "b.exr", planes(change(_soft()), np.float32))
    assert names(compare_images(a, b)) == [name]

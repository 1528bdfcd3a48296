"""Colour files: what they hold, in linear light, premultiplied."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from elements import write
from image_files import from_srgb, multi_part, png_chunk, random_planes, raw_png, save, write_deep
from refusals import refuses

from defocus_core import read_color
from defocus_core.io.images.color import BRIGHTEST, Color, require_finite
from defocus_core.io.images.describe import describe
from defocus_core.renderer.engine import scene

SHAPE = (6, 7)


def integers(bits, channels):
    dtype = np.uint8 if bits == 8 else np.uint16
    return np.random.default_rng(3).integers(0, 2**bits, (*SHAPE, channels), dtype)


def gamma_png(path, samples, gamma):
    declared = png_chunk(b"gAMA", round(100_000 / gamma).to_bytes(4, "big"))
    return raw_png(path, samples, declared)


DEEP, HALF = integers(16, 3), np.full((*SHAPE, 4), 128, np.uint8)
LINEAR = np.random.default_rng(4).random((*SHAPE, 3), np.float32) * 50


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    ("suffix", "channels"),
    [*(("png", each) for each in ("Y", "YA", "RGB", "RGBA")), ("tif", "RGB"), ("tif", "RGBA")],
)
def test_integers_are_srgb_and_alpha_is_multiplied_in_linear_light(
    dtype, suffix, channels, tmp_path
):
    top, count = np.iinfo(dtype).max, len(channels)
    samples = integers(8 * np.dtype(dtype).itemsize, count)
    samples[0, 0, -1] = 0
    color = read_color(save(tmp_path / f"a.{suffix}", samples))
    shares = samples / top
    light = from_srgb(shares)
    if "A" in channels:
        alpha = shares[..., -1:]
        light = np.concatenate([light[..., :-1] * alpha, alpha], axis=2)
    assert color.channels == tuple(channels)
    assert color.pixels.dtype == np.float32
    np.testing.assert_allclose(color.pixels, light, rtol=1e-6)


@pytest.mark.parametrize(
    ("write", "light", "note"),
    [
        (lambda f: gamma_png(f / "a.png", DEEP, 1.0), 1.0, "16-bit, taken as linear"),
        (lambda f: gamma_png(f / "a.png", DEEP, 1.8), 1.8, "16-bit, taken as the power 1.8"),
        (lambda f: save(f / "a.tif", LINEAR), LINEAR, "float, taken as linear"),
        (lambda f: save(f / "a.hdr", LINEAR), LINEAR, "float, taken as linear"),
        # white, half covering
        (lambda f: save(f / "a.tif", HALF, oiio__UnassociatedAlpha=0), HALF / 255, ""),
    ],
)
def test_other_curves_are_those_that_the_file_says(write, light, note, tmp_path):
    path = write(tmp_path)
    if isinstance(light, float):
        light = (DEEP / 65535) ** light
    color = read_color(path)
    rgbe_step = 64 / 256 if path.suffix == ".hdr" else 0
    np.testing.assert_allclose(color.pixels, light, rtol=1e-4, atol=rgbe_step)
    assert (color.note.startswith(note), color.warnings) == (True, ())


@pytest.mark.parametrize(
    ("turn", "shape"),
    [*((turn, SHAPE) for turn in range(1, 9)), *((turn, (1030, 1100)) for turn in (2, 4, 6, 7))],
)
def test_a_photograph_comes_upright(tmp_path, turn, shape):
    """Be it of one strip of rows or of two."""
    upright = (np.arange(shape[0] * shape[1]) % 251).astype(np.uint8).reshape(*shape, 1)
    # EXIF: where row 0 and column 0 of the stored image are seen.
    undo: Any = {
        1: lambda a: a,
        2: lambda a: a[:, ::-1],
        3: lambda a: a[::-1, ::-1],
        4: lambda a: a[::-1],
        5: lambda a: a.swapaxes(0, 1),
        6: lambda a: np.rot90(a, 1),
        7: lambda a: a[::-1, ::-1].swapaxes(0, 1),
        8: lambda a: np.rot90(a, -1),
    }[turn]
    stored = np.ascontiguousarray(undo(upright))
    path = save(tmp_path / "a.tif", stored, Orientation=turn)
    np.testing.assert_allclose(read_color(path).pixels, from_srgb(upright / 255), rtol=1e-6)
    assert (describe(path).height, describe(path).width) == shape


def test_exr_colour_is_taken_as_it_is(tmp_path):
    planes = random_planes("RGBA")
    ids = np.arange(24 * 32, dtype=np.uint32).reshape(24, 32)
    path = tmp_path / "a.exr"
    write(path, {**planes, "Z": planes["R"], "id": ids}, owner="someone")
    color = read_color(path)
    np.testing.assert_array_equal(color.pixels, np.stack([planes[c] for c in "RGBA"], axis=2))
    assert color.channels == ("R", "G", "B", "A")
    assert color.attributes["owner"].value == b"someone"
    assert set(color.extras) == {"Z", "id"}
    np.testing.assert_array_equal(color.extras["id"], ids)
    assert color.extras["Z"].dtype == np.float16


def layered(path, *layers):
    planes: dict[str, Any] = {}
    for seed, layer in enumerate(layers):
        dot = f"{layer}." if layer else ""
        planes |= {f"{dot}{n}": p for n, p in random_planes("RGB", seed=seed).items()}
    return write(path, planes)


def test_several_colour_layers_are_listed_and_chosen_by_name(tmp_path):
    path = layered(tmp_path / "a.exr", "ViewLayer.Emit", "ViewLayer.DiffCol")
    with refuses("ambiguous", "DiffCol, ViewLayer.Emit", "‹color-layer›", path=path):
        read_color(path)
    expected = random_planes("RGB", seed=1)
    for name in ("ViewLayer.DiffCol", "viewlayer.diffcol"):
        color = read_color(path, layer=name)
        np.testing.assert_array_equal(color.pixels[..., 1], expected["G"])
        assert color.channels == ("R", "G", "B")
        assert set(color.extras) == {f"ViewLayer.Emit.{c}" for c in "RGB"}
    with refuses("no-such-channel", "it has ViewLayer.DiffCol", path=path):
        read_color(path, layer="beauty")


def test_parts_are_listed_and_chosen_by_number_or_name(tmp_path):
    left, right = random_planes("RGB", seed=0), random_planes("RGB", seed=1)
    path = multi_part(tmp_path / "a.exr", left=dict(left), right=dict(right))
    with refuses("ambiguous", "left/RGB, right/RGB", "‹part›", path=path):
        read_color(path)
    for chosen in ({"part": 1}, {"layer": "right"}, {"layer": "right/RGB"}):
        color = read_color(path, **chosen)
        np.testing.assert_array_equal(color.pixels[..., 0], right["R"])
        np.testing.assert_array_equal(color.extras["left.R"], left["R"])
    with refuses("no-such-part", path=path):
        read_color(path, part=2)


@pytest.mark.parametrize(("bits", "channels", "own", "other"), [(16, 1, 1, 0), (8, 3, 2, 8)])
def test_white_as_0_beyond_8_bit_and_lab_are_refused(bits, channels, own, other, tmp_path):
    path = save(tmp_path / "a.tif", integers(bits, channels))
    data = path.read_bytes()
    photometric = struct.pack("<HHII", 262, 3, 1, own)
    assert photometric in data
    path.write_bytes(data.replace(photometric, struct.pack("<HHII", 262, 3, 1, other)))
    with refuses("unsupported", path=path):
        read_color(path)


@pytest.mark.parametrize(
    ("wrong", "code", "words"),
    [
        ({(1, 2): np.inf, (2, 0): np.nan}, "not-finite", ["in 2 pixels", "at 2,1"]),
        ({(2, 1): 3e38}, "out-of-range", ["in 1 pixel", "at 1,2"]),
        ({(2, 1): -1e31}, "out-of-range", ["in 1 pixel", "at 1,2"]),
    ],
)
def test_light_that_is_not_finite_or_too_bright_to_be_summed_is_refused(wrong, code, words):
    """It made NaN in `left`, or an error of the renderer that named no file."""
    plane = np.full((3, 4), 1e30, np.float32)
    color = Color((plane * 0, plane, plane), ("R", "G", "B"), Path("a.exr"))
    require_finite(color)
    for place, value in wrong.items():
        plane[place] = value
    with refuses(code, *words, path=color.path):
        require_finite(color)
    assert BRIGHTEST == scene.BRIGHTEST


def test_describe_reads_headers_only(tmp_path):
    z = {"Z": np.ones((24, 32), np.float32)}
    info = describe(multi_part(tmp_path / "a.exr", rgba=random_planes("RGB"), depth=z))
    assert (info.width, info.height) == (32, 24)
    named = [(part.index, part.name, part.deep) for part in info.parts]
    assert named == [(0, "rgba", False), (1, "depth", False)]
    kinds = [{c.name: c.type for c in part.channels} for part in info.parts]
    assert kinds == [dict.fromkeys("BGR", "half"), {"Z": "float"}]
    png = describe(save(tmp_path / "a.png", integers(16, 2)))
    assert [(c.name, c.type) for c in png.parts[0].channels] == [("Y", "uint16"), ("A", "uint16")]
    np.save(tmp_path / "a.npy", np.ones((2, 3), np.float32))
    ((channel,),) = (part.channels for part in describe(tmp_path / "a.npy").parts)
    assert (channel.name, channel.type) == ("Z", "float32")
    write_deep(tmp_path / "deep.exr")
    assert describe(tmp_path / "deep.exr").parts[0].deep

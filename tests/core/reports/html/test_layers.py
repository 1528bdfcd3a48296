"""Packed values are those that were packed, whatever the way."""

import zlib

import numpy as np
import pytest

from defocus_core.compare.picture import of_planes
from defocus_core.reports.html import layers


def unpacked(packed, channels, base=None):
    """As the script of the report does it: [C, H, W]."""
    width, height = packed.size
    data = np.frombuffer(zlib.decompress(packed.payload), np.uint8).astype(np.uint16)
    count = data.size // 2
    steps = (data[:count] + (data[count:] << 8)).reshape(channels, height, width)
    bits = steps + base if packed.base else np.cumsum(steps, axis=2, dtype=np.uint16)
    if packed.ends:
        return packed.ends[0] + bits / 65535 * (packed.ends[1] - packed.ends[0])
    return bits.view(np.float16).astype(np.float64) * packed.scale


@pytest.fixture
def planes():
    rng = np.random.default_rng(0)
    values = rng.normal(0, 100, (3, 21, 34)).astype(np.float16)
    values[0, 3, 4], values[1, 0, 0], values[2, 20, 33] = np.nan, np.inf, -0.0
    return list(values)


def test_a_layer_like_another_is_stored_as_their_difference(planes):
    bits = layers.half_bits(planes, 1.0)
    changed = [plane.copy() for plane in planes]
    changed[1][4:6, 4:6] = 7.0
    packed = layers.pack(layers.half_bits(changed, 1.0), (0, 0, 34, 21), 1.0, ("a", bits))
    alone = layers.pack(layers.half_bits(changed, 1.0), (0, 0, 34, 21), 1.0)
    assert packed.base == "a"
    assert len(packed.payload) < len(alone.payload) / 5
    assert np.array_equal(unpacked(packed, 3, bits), np.stack(changed), equal_nan=True)


def test_what_is_beyond_half_is_scaled_and_not_clamped():
    plane = np.array([[1e9, -3e7, 0.0]])
    scale = layers.scale_of([plane])
    packed = layers.pack(layers.half_bits([plane], scale), (0, 0, 3, 1), scale)
    assert unpacked(packed, 1)[0] == pytest.approx(plane, rel=1e-3)


@pytest.mark.parametrize("greatest", [255, 65535])
def test_values_of_integer_files_are_kept_as_integers(greatest):
    whole = np.random.default_rng(0).integers(0, greatest + 1, (2, 21, 34))
    pictures = [of_planes({"Y": (each / greatest).astype(np.float32)}, "x") for each in whole]
    drawn = [layers.draw(key, key, each, ["Y"]) for key, each in zip("ab", pictures, strict=True)]
    drawn += layers.difference_of(*drawn)[0]
    a, b, difference = layers.valued_layers(drawn)
    assert unpacked(a.values, 1)[0] * greatest == pytest.approx(whole[0])
    assert unpacked(b.values, 1)[0] * greatest == pytest.approx(whole[1])
    assert difference.values is None


def test_a_tiny_difference_keeps_its_digits():
    plane = np.array([[3e-9, 1e-9, 0.0]])
    scale = layers.scale_of([plane], least=0.0)
    packed = layers.pack(layers.half_bits([plane], scale), (0, 0, 3, 1), scale)
    assert unpacked(packed, 1)[0] == pytest.approx(plane, rel=1e-3)


def test_heat_has_the_range_of_what_differs_and_not_of_a_few_lights():
    """Half differ by 0.02, two in a hundred, lamps, by 4."""
    a = np.zeros((100, 100), np.float32)
    b = a.copy()
    b[:50], b[:2] = 0.02, 4.0
    drawn = [layers.draw("x", "x", of_planes({"Y": each}, "x"), ["Y"]) for each in (a, b)]
    assert layers.difference_of(*drawn)[1] == 2**-5

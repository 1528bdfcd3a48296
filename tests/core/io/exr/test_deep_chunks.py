"""Deep samples of every compression are those that were written; promises are counted first."""

import struct

import numpy as np
import OpenEXR
import pytest
from counting import calls
from deep_files import write_deep_samples
from refusals import refuses

from defocus_core.io.exr.deep_layers import MAX_LAYERS, _fractions, merge_samples
from defocus_core.io.exr.deep_samples import DeepSamples, count_samples, read_deep_samples
from defocus_core.io.exr.header import raw_headers, read_headers
from defocus_core.io.exr.windows import Window

CODECS = ("NO", "ZIPS")


def part(seed, codec, name=""):
    """A deep part of 0 to 5 samples a pixel, noisy and even ones; and its channels."""
    noise = np.random.default_rng(seed)
    counts = noise.integers(0, 6, (9, 7))
    planes = {"A": np.float16, "R": np.float16, "Z": np.float32, "id": np.uint32}
    channels = {}
    for channel, kind in planes.items():
        pixels = np.empty(counts.shape, object)
        for at in np.ndindex(pixels.shape):
            values = noise.random(counts[at]) * 9 * (at[0] % 2) + 1
            pixels[at] = (values / 10 if channel == "A" else values).astype(kind)
        channels[channel] = pixels
    header = {
        "type": OpenEXR.deepscanline,
        "compression": getattr(OpenEXR, f"{codec}_COMPRESSION"),
        "dataWindow": (np.array([3, -2], np.int32), np.array([9, 6], np.int32)),
    }
    return OpenEXR.Part(header, dict(channels), name), channels


@pytest.mark.parametrize("codec", CODECS)
def test_samples_of_each_compression_are_what_was_written(codec, tmp_path):
    parts = [part(seed, codec, name) for seed, name in enumerate(("a", "b"))]
    for number, chosen in enumerate((parts[:1], parts)):
        path = tmp_path / f"{number}.exr"
        OpenEXR.File([each for each, _ in chosen]).write(str(path))
        for header, (_, channels) in zip(read_headers(path), chosen, strict=True):
            samples = read_deep_samples(path, header)
            counts = np.bincount(samples.pixel, minlength=63).reshape(9, 7)
            assert np.array_equal(counts, np.vectorize(len)(channels["Z"]))
            nearest_first = [np.argsort(each, kind="stable") for each in channels["Z"].ravel()]
            for name, pixels in channels.items():
                ordered = map(np.take, pixels.ravel(), nearest_first)
                assert np.array_equal(samples.values[name], np.concatenate([*ordered])), name


@pytest.mark.parametrize(("promised", "code"), [(1 << 60, "too-large"), (1 << 20, "damaged")])
def test_what_chunks_promise_is_counted_before_it_is_allocated(promised, code, tmp_path):
    samples = [{"R": 1.0, "G": 0.5, "B": 0.2, "A": 1.0, "Z": 2.0}]
    path = write_deep_samples(tmp_path / "a.exr", [[samples] * 8] * 8)
    (header,) = read_headers(path)
    with path.open("r+b") as file:
        raw_headers(file)
        (chunk,) = struct.unpack("<Q", file.read(8))
        file.seek(chunk + 20)
        file.write(struct.pack("<Q", promised))
    with refuses(code):
        read_deep_samples(path, header)


def test_chunks_lie_where_they_say(tmp_path):
    """One chunk in the place of all would be as many samples as the header likes."""
    path = write_deep_samples(tmp_path / "a.exr", [[[{"A": 1.0, "Z": 2.0}]] * 8] * 8, ("A", "Z"))
    (header,) = read_headers(path)
    with path.open("r+b") as file:
        raw_headers(file)
        first = file.read(8)
        file.seek(-8, 1)
        file.write(8 * first)
    with refuses("damaged"):
        read_deep_samples(path, header)


def test_a_pixel_of_many_samples_is_merged_at_once():
    """A row of a file of 60 kB may hold millions; one merge a step took minutes."""
    count, generator = 50_000, np.random.default_rng(0)
    pixel, depth = np.zeros(count, np.int32), np.sort(generator.uniform(1, 9, count))
    light = {name: generator.uniform(0, 1e-4, count).astype("f4") for name in "RA"}
    values = {**light, "Z": depth.astype("f4")}
    samples = DeepSamples(Window(0, 0, 0, 0), pixel, np.arange(count, dtype=np.int32), values)
    made: list[tuple[DeepSamples, int]] = []
    assert calls(lambda: made.append(merge_samples(samples, ("R", "A")))) < count
    ((few, crowded),) = made
    assert (crowded, few.maximum) == (1, MAX_LAYERS)
    shown = [float((each.values["R"] * _fractions(each)).sum()) for each in (samples, few)]
    assert shown[1] == pytest.approx(shown[0], rel=1e-5)  # 1 - alpha is a float


def test_samples_are_counted_and_none_is_decoded(tmp_path):
    one = {"R": 1.0, "G": 0.5, "B": 0.2, "A": 1.0, "Z": 2.0}
    path = write_deep_samples(tmp_path / "a.exr", [[[one] * 3, [one]], [[], [one] * 7]])
    path.write_bytes(path.read_bytes()[:-8] + bytes(8))  # of the last samples
    (header,) = read_headers(path)
    assert count_samples(path, header) == (7, 11)
    with refuses("damaged"):
        read_deep_samples(path, header)

"""OpenEXR files: native in, native out, and nothing damaged gets through unnoticed."""

import struct
from contextlib import nullcontext
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from command_line import header
from image_files import SCANLINE, box, random_planes
from refusals import refuses

from defocus_core.io.exr import reading
from defocus_core.io.exr.channel_choice import choose_color
from defocus_core.io.exr.header import (
    CODECS,
    Raw,
    codec_of,
    header_bytes,
    raw_headers,
    read_headers,
)
from defocus_core.io.exr.reading import read_parts
from defocus_core.io.exr.writing import write_exr


def test_every_pixel_type_comes_back_bit_for_bit(tmp_path):
    planes: dict[str, Any] = {
        "half": np.array([[0.1, 65504.0, -np.inf]], np.float16),
        "float": np.array([[0.1, 1e30, np.nan]], np.float32),
        "id": np.array([[0, 7, 2**32 - 1]], np.uint32),
    }
    write_exr(tmp_path / "a.exr", planes, {})
    (part,) = read_parts(tmp_path / "a.exr")
    kinds = {c.name: c.type for c in part.header.channels}
    assert kinds == {"half": "half", "float": "float", "id": "uint"}
    for name, plane in planes.items():
        assert part.channels[name].tobytes() == plane.tobytes()


def test_metadata_goes_through_and_structure_does_not(tmp_path):
    said = {"owner": "ünï", "isoSpeed": 100.0, "frame": 3, "worldToCamera": np.eye(4, dtype="f")}
    structure = {"compression": OpenEXR.PIZ_COMPRESSION, "name": "x", "chunkCount": 9}
    write_exr(tmp_path / "a.exr", random_planes("Y"), {**said, **structure})
    (part,) = read_parts(tmp_path / "a.exr")
    assert not structure.keys() & part.header.attributes.keys()
    write_exr(tmp_path / "b.exr", random_planes("Y"), part.header.attributes)
    assert (tmp_path / "b.exr").read_bytes() == (tmp_path / "a.exr").read_bytes()
    for name, value in said.items():
        np.testing.assert_array_equal(header(tmp_path / "b.exr")[name], value)


def test_a_claimed_size_is_checked_before_allocation(tmp_path):
    path = tmp_path / "a.exr"
    write_exr(path, random_planes("Y"), {})
    honest = path.read_bytes()
    window = struct.pack("<4i", 0, 0, 31, 23)
    for claim, code in [((999_999, 999_999), "too-large"), ((29_999, 29_999), "damaged")]:
        path.write_bytes(honest.replace(window, struct.pack("<4i", 0, 0, *claim)))
        with refuses(code, path=path):
            read_parts(path)


@pytest.mark.parametrize(
    "said",
    [
        {"compression": b""},
        {"pixelAspectRatio": struct.pack("<f", np.nan)},
        {"pixelAspectRatio": struct.pack("<f", -1)},
        {"dataWindow": bytes(12)},
        {"channels": b"Y"},
    ],
)
def test_an_attribute_without_meaning_is_damage(said, tmp_path):
    path = tmp_path / "a.exr"
    write_exr(path, random_planes("Y"), {})
    with path.open("rb") as file:
        (_, [attributes]) = raw_headers(file)
    wrong = {name: Raw(attributes[name].kind, value) for name, value in said.items()}
    path.write_bytes(header_bytes(attributes | wrong))
    with refuses("damaged", path=path):
        read_headers(path)


def test_a_part_lost_to_damage_is_an_error(tmp_path):
    # OpenEXR drops such a part with a print and shifts the others.
    path = tmp_path / "a.exr"
    parts = [
        OpenEXR.Part({"name": name, **SCANLINE}, random_planes("Y", seed=seed))
        for seed, name in enumerate(("first", "second"))
    ]
    OpenEXR.File(parts).write(str(path))
    path.write_bytes(path.read_bytes()[:-40])
    with refuses("damaged", path=path):
        read_parts(path)


COMPRESSIONS = [name for name in dir(OpenEXR) if name.endswith("_COMPRESSION")]


def tiles(width, height):
    described = OpenEXR.TileDescription()
    described.xSize, described.ySize = width, height
    return {"type": OpenEXR.tiledimage, "tiles": described, "compression": OpenEXR.ZIP_COMPRESSION}


def whole_by_openexr(path):
    """Every channel of every part as OpenEXR decodes it at once, put into the display window."""
    parts = []
    for part in OpenEXR.File(str(path), separate_channels=True).parts:
        (x0, y0), _ = part.header["dataWindow"]
        first, last = part.header["displayWindow"]
        planes = {}
        for name, channel in part.channels.items():
            held = np.zeros((2000, 2000), channel.pixels.dtype)  # its (0, 0) is at (-1000, -1000)
            height, width = channel.pixels.shape
            held[y0 + 1000 : y0 + 1000 + height, x0 + 1000 : x0 + 1000 + width] = channel.pixels
            planes[name] = held[first[1] + 1000 : last[1] + 1001, first[0] + 1000 : last[0] + 1001]
        parts.append(planes)
    return parts


def same_in_pieces(path, piece_bytes=3000):
    whole = whole_by_openexr(path)
    for pieces in (piece_bytes, 1 << 25):
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(reading, "STRIP", pieces)
            parts = read_parts(path)
        for part, planes in zip(parts, whole, strict=True):
            assert part.channels.keys() == planes.keys()
            for name, plane in planes.items():
                pixels = part.channels[name][:]
                assert pixels.dtype == plane.dtype
                np.testing.assert_array_equal(pixels, plane)


def mixed_planes(shape):
    """Types in an order that no two neighbours share, whole numbers beyond what float holds."""
    rng = np.random.default_rng(7)
    return {
        **random_planes("RGBA", shape),
        "S": rng.integers(0, 2**32, shape, dtype=np.uint32),
        "T": rng.random(shape, np.float32),
        "U": rng.random(shape, np.float32).astype(np.float16),
    }


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_all_compressions_are_the_same_in_pieces(compression, tmp_path):
    for kind, shape in (({"type": OpenEXR.scanlineimage}, (300, 20)), (tiles(16, 24), (70, 50))):
        header = {**kind, "compression": getattr(OpenEXR, compression)}
        OpenEXR.File(header, mixed_planes(shape)).write(str(tmp_path / "a.exr"))
        same_in_pieces(tmp_path / "a.exr")


@pytest.mark.parametrize("piece_bytes", [1, 20_000, 10**6])
def test_a_texture_with_its_smaller_copies_is_the_same_in_pieces_of_any_size(piece_bytes, tmp_path):
    texture = oiio.ImageBuf(oiio.ImageSpec(50, 70, 3, "float"))
    texture.set_pixels(oiio.ROI(), np.random.default_rng(4).random((70, 50, 3), np.float32))
    tiled = oiio.ImageSpec()
    tiled.tile_width, tiled.tile_height = 32, 16
    assert oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, texture, f"{tmp_path}/a.exr", tiled)
    same_in_pieces(tmp_path / "a.exr", piece_bytes)


def test_tiled_parts_and_windows_are_the_same_in_pieces(tmp_path):
    data, display = box(-5, 7, 44, 66), box(0, 0, 39, 79)
    windows = {"dataWindow": data, "displayWindow": display}
    parts = [
        OpenEXR.Part({"name": "lines", **SCANLINE, **windows}, random_planes("RGB", (60, 50))),
        OpenEXR.Part({"name": "tiles", **tiles(16, 24), **windows}, random_planes("Z", (60, 50))),
        OpenEXR.Part({"name": "after", **SCANLINE, **windows}, random_planes("Y", (60, 50))),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    same_in_pieces(tmp_path / "a.exr")


def test_channels_of_fewer_samples_than_pixels_are_refused(tmp_path):
    path, plane = tmp_path / "a.exr", random_planes("R", (24, 32))["R"]
    OpenEXR.File(dict(SCANLINE), {"Y": plane, "BY": OpenEXR.Channel(plane, 2, 2)}).write(str(path))
    assert not oiio.ImageInput.open(str(path)), "OpenImageIO reads it: it could be taken"
    oiio.geterror()
    with refuses("subsampled", "BY", "R, G and B", path=path):
        read_headers(path)


def test_limits_of_openimageio_are_not_those_of_exr_files(tmp_path):
    """It refuses pictures larger than memory, which are read in pieces, and 1025 channels."""
    names = [f"c{index}" for index in range(1030)]
    planes = {name: np.full((16, 36), index, np.float16) for index, name in enumerate(names)}
    OpenEXR.File(dict(SCANLINE), dict(planes)).write(str(tmp_path / "a.exr"))
    limits = {"limits:imagesize_MB": 1, "limits:channels": 1024}
    before = {name: oiio.get_int_attribute(name) for name in limits}
    try:
        for name, limit in limits.items():
            oiio.attribute(name, limit)
        (part,) = read_parts(tmp_path / "a.exr")
    finally:
        for name, limit in before.items():
            oiio.attribute(name, limit)
    assert all((part.channels[name][:] == plane).all() for name, plane in planes.items())


def test_pixels_of_an_aspect_that_none_has_are_refused(tmp_path):
    for aspect, refusal in ((1.0, False), (2.0, False), (11.0, True), (0.05, True)):
        path = tmp_path / f"{aspect}.exr"
        planes = random_planes("RGB", (4, 5))
        OpenEXR.File({**SCANLINE, "pixelAspectRatio": aspect}, planes).write(str(path))
        said = refuses("unsupported", f"{aspect:g} times", path=path) if refusal else nullcontext()
        with said:
            choose_color(path, read_headers(path), layer=None, part=None)


@pytest.mark.parametrize("name", [*CODECS, "dwaa:300"])
def test_each_codec_makes_the_file_that_openexr_writes_at_once(name, tmp_path):
    planes = random_planes("RGBZ", (600, 8))
    write_exr(tmp_path / "a.exr", planes, {}, compression=name)
    codec, level = codec_of(name)
    kind = {"compression": OpenEXR.Compression(codec.number), "type": OpenEXR.scanlineimage}
    OpenEXR.File({**kind, **level}, planes).write(str(tmp_path / "b.exr"))
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()
    assert read_headers(tmp_path / "a.exr")[0].compression == name

"""Headers of many parts, channels, views and attributes: work is linear in them, and they end."""

import struct

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import pytest
from counting import calls
from image_files import multi_part, random_planes
from refusals import refuses

from defocus_core import read_depth
from defocus_core.io.exr.header import MAGIC, MULTIPART, read_headers
from defocus_core.io.exr.reading import read_parts
from defocus_core.io.images.color import read_color
from defocus_core.io.images.describe import describe
from defocus_core.io.images.raster import read_pages


def attribute(name, kind, value):
    return b"%s\0%s\0%s%s" % (name.encode(), kind.encode(), struct.pack("<i", len(value)), value)


def part(*more, channels=3):
    listed = b"".join(b"c%d\0" % n + struct.pack("<i4x2i", 1, 1, 1) for n in range(channels))
    window = struct.pack("<4i", 0, 0, 7, 7)
    windows = (attribute(name, "box2i", window) for name in ("dataWindow", "displayWindow"))
    return b"".join([attribute("channels", "chlist", listed + b"\0"), *windows, *more, b"\0"])


NAMELESS = attribute("multiView", "stringvector", bytes(4 * 4_000_000))
MANY = [attribute(f"a{n}", "int", bytes(4)) for n in range(3000)]


@pytest.mark.parametrize(
    ("what", "flags", "header"),
    [
        ("channels", 0, part(channels=80_000)),
        ("channels", MULTIPART, part(channels=1000) * 5 + b"\0"),
        ("parts", MULTIPART, part() * 30_000 + b"\0"),
        ("views", 0, part(NAMELESS)),
        ("attributes in a part", 0, part(*MANY[:3000])),
        ("attributes", MULTIPART, part(*MANY[:1000]) * 20 + b"\0"),
    ],
    ids=["channels", "channels of all parts", "parts", "views", "attributes of a part", "of all"],
)
def test_a_header_of_more_than_any_picture_has_is_refused(what, flags, header, tmp_path):
    path = tmp_path / "a.exr"
    path.write_bytes(MAGIC + struct.pack("<I", 2 | flags) + header)
    with refuses("too-large") as caught:
        read_headers(path)
    assert caught.value.problem.endswith(what)


def read(path):
    describe(path)
    read_color(path, part=0)
    read_depth(path, channel="Z", part=0)


@pytest.mark.parametrize("of", ["channels", "parts"])
def test_work_is_linear_in_the_channels_and_parts_of_a_file(of, tmp_path):
    """A thousand channels and 200 parts are legal."""
    counts = []
    for count in (500, 1000) if of == "channels" else (100, 200):
        path, first = tmp_path / f"{count}.exr", random_planes("BGRZ", (2, 2))
        others = [f"layer{n}" for n in range(count)]
        if of == "channels":
            multi_part(path, first=first | {f"{name}.Z.X": first["Z"] for name in others})
        else:
            multi_part(path, first=first, **dict.fromkeys(others, first))
        counts.append(calls(lambda path=path: read(path)))  # type: ignore[misc]
    half, all_of_them = counts
    assert all_of_them < 2.2 * half


def test_a_look_at_the_colour_decodes_no_other_channel(tmp_path):
    """Of thousands of channels, to read all takes the square of their number."""
    path = multi_part(tmp_path / "a.exr", first=random_planes("BGRZ"), other=random_planes("N"))
    whole, alone = read_color(path), read_color(path, carried=False)
    assert set(whole.extras) == {"Z", "other.N"}
    assert not alone.extras
    assert all(map(np.array_equal, whole.planes, alone.planes))


def test_a_file_of_many_parts_is_opened_once_however_many(tmp_path):
    """To open it is to read all headers."""
    counts = []
    for count in (1, 20):
        path = tmp_path / f"{count}.exr"
        multi_part(path, **{f"p{n}": random_planes("Y") for n in range(count)})
        counts.append(calls(lambda path=path: read_parts(path), "open"))  # type: ignore[misc]
    assert counts[0] == counts[1] > 0


def test_a_tiff_of_more_pages_than_are_read_is_refused(tmp_path):
    file, page = oiio.ImageOutput.create("a.tif"), oiio.ImageSpec(2, 2, 3, "uint8")
    for count in (256, 257):
        path = str(tmp_path / f"{count}.tif")
        for number in range(count):
            assert file.open(path, page, "AppendSubimage" if number else "Create")
            assert file.write_image(np.zeros((2, 2, 3), np.uint8))
        file.close()
    assert len(read_pages(tmp_path / "256.tif")) == 256
    with refuses("too-large"):
        read_pages(tmp_path / "257.tif")

"""Small image files for the tests, written without the code under test."""

import zlib
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it


def to_srgb(light):
    """Values of sRGB of linear light in 0…1 (IEC 61966-2-1)."""
    light = np.maximum(light, 0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def from_srgb(value):
    """Linear light of sRGB values in 0…1."""
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


SCANLINE = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}


def random_planes(names, shape=(24, 32), seed=0):
    rng = np.random.default_rng(seed)
    return {name: rng.random(shape, np.float32).astype(np.float16) for name in names}


def box(x0, y0, x1, y1):
    return np.array([x0, y0], np.int32), np.array([x1, y1], np.int32)


def write_deep(path):
    samples = np.empty((4, 5), dtype=object)
    for index in np.ndindex(samples.shape):
        samples[index] = np.array([1.0, 2.0], np.float32)
    header = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    OpenEXR.File(header, {"Z": samples}).write(str(path))


def save(path, samples, **attributes):
    """Write samples as they are; ``a__b`` stands for the attribute a:b, and ``tile`` for a size."""
    path.parent.mkdir(exist_ok=True)
    height, width, channels = samples.shape
    names = {"float64": "double", "float32": "float", "float16": "half"}
    kind = names.get(samples.dtype.name, samples.dtype.name)
    oiio.attribute("tiff:half", 1)  # or half is written as float
    spec = oiio.ImageSpec(width, height, channels, kind)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.x, spec.y = attributes.pop("x", 0), attributes.pop("y", 0)
    spec.tile_width, spec.tile_height = attributes.pop("tile", (0, 0))
    for name, value in attributes.items():
        kinds = (oiio.TypeDesc(f"uint8[{len(value)}]"),) if isinstance(value, bytes) else ()
        value = np.frombuffer(value, np.uint8) if kinds else value
        spec.attribute(name.replace("__", ":"), *kinds, value)
    output: Any = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(samples)
    assert output.close()
    return path


def samples_of(path):
    """The samples of a picture of 8 bits."""
    return oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)


def png_chunk(kind, data):
    body = kind + data
    return len(data).to_bytes(4, "big") + body + zlib.crc32(body).to_bytes(4, "big")


def raw_png(path, samples, chunk):
    """A 16-bit RGB PNG whose only colour statement is ``chunk``."""
    height, width, _ = samples.shape
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in samples)
    head = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([16, 2, 0, 0, 0])
    body = png_chunk(b"IHDR", head) + chunk + png_chunk(b"IDAT", zlib.compress(rows))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body + png_chunk(b"IEND", b""))
    return path


def multi_part(path, **parts):
    made = [OpenEXR.Part({"name": name, **SCANLINE}, planes) for name, planes in parts.items()]
    OpenEXR.File(made).write(str(path))
    return path

"""Faults planted into a picture, each with the words that name it, and pairs that are the same."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from image_files import box, save

from defocus_core.compare.comparison import compare_pair
from defocus_core.compare.pairing import FilePair
from defocus_core.compare.record import CompareSettings
from defocus_core.compare.thresholds import Rules
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear
from defocus_core.io.images.primaries import NAMED, REC_709, between_primaries

Pixels = np.ndarray[Any, Any]
HEIGHT, WIDTH = 90, 128
_NO_RULES = Rules()
PRIMARIES = ("Rec. 2020", "Display P3", "ACES AP1", "ACES AP0")


def scene():
    """Discs of many sizes and colours before a slope, one brighter than 1: float32 [H, W, 3]."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    image = np.stack([0.1 + 0.3 * x / WIDTH, 0.2 + 0.2 * y / HEIGHT, 0.4 - 0.2 * x / WIDTH], 2)
    for _ in range(60):
        cx, cy, radius = rng.uniform(0, WIDTH), rng.uniform(0, HEIGHT), rng.uniform(2, 12)
        cover = np.clip(radius - np.hypot(x - cx, y - cy) + 0.5, 0, 1)[..., None]
        image = image * (1 - cover) + cover * rng.uniform(0.02, 0.9, 3)
    cover = np.clip(7 - np.hypot(x - 60, y - 40) + 0.5, 0, 1)[..., None]
    return (image * (1 - cover) + cover * (6.0, 5.0, 3.0)).astype(np.float16).astype(np.float32)


def blurred(image, sigma):
    reach = int(3 * sigma) + 1
    weights = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * sigma**2))
    weights /= weights.sum()
    for axis in (0, 1):
        pad = [(reach, reach) if axis == other else (0, 0) for other in range(image.ndim)]
        padded = np.pad(image, pad, mode="edge")
        steps = range(2 * reach + 1)
        length = image.shape[axis]
        image = sum(weights[k] * np.take(padded, range(k, k + length), axis=axis) for k in steps)
    return np.asarray(image, np.float32)


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
    return linear_to_srgb(np.clip(image, 0, 1))


def _of_channel(image, index, changed):
    image = image.copy()
    image[..., index] = changed[..., index]
    return image


def warped(image, degrees=0.0, scale=1.0, dx=0.0):
    """Turned and enlarged around the middle, bicubic by Catmull-Rom."""
    height, width = image.shape[:2]
    y, x = np.mgrid[0:height, 0:width] - np.float64([[[height - 1]], [[width - 1]]]) / 2
    c, s = np.cos(np.radians(degrees)) / scale, np.sin(np.radians(degrees)) / scale
    row = (c * y + s * x) + (height - 1) / 2
    column = (c * x - s * y) + (width - 1) / 2 - dx
    total = np.zeros_like(image)
    for k, j in product(range(-1, 3), repeat=2):
        top, left = np.floor(row) + k, np.floor(column) + j
        weight = _cubic(np.abs(row - top)) * _cubic(np.abs(column - left))
        pixel = image[top.clip(0, height - 1).astype(int), left.clip(0, width - 1).astype(int)]
        total += weight[..., None].astype(np.float32) * pixel
    return total


def _cubic(t):
    return np.where(t <= 1, (1.5 * t - 2.5) * t * t + 1, ((-0.5 * t + 2.5) * t - 4) * t + 2)


def converted(name, image):
    return image @ between_primaries(REC_709, NAMED[name]).T


def summed(image, kernel):
    """Through a kernel [k, k] of odd side, of any sum."""
    reach = len(kernel) // 2
    padded = np.pad(image, [(reach, reach), (reach, reach), (0, 0)], mode="edge")
    height, width = image.shape[:2]
    weights = np.ndenumerate(kernel / kernel.sum())
    total = sum(w * padded[y : y + height, x : x + width] for (y, x), w in weights if w)
    return np.asarray(total, np.float32)


def through_disc(image, radius=2.0):
    reach = int(np.ceil(radius))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return summed(image, np.clip(radius + 0.5 - np.hypot(y, x), 0, 1))


def _noise(image, amount):
    return amount * np.random.default_rng(1).standard_normal(image.shape)


def _along(image):
    return summed(image, 1.0 * (np.indices((9, 9))[0] == 4))


def halved(image):
    """Means of 2 x 2 pixels."""
    height, width = (side // 2 * 2 for side in image.shape[:2])
    return image[:height, :width].reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))


def doubled(small):
    """Twice the size, bilinear."""
    for axis in (0, 1):
        pad = [(1, 1) if axis == k else (0, 0) for k in range(3)]
        padded = np.pad(small, pad, mode="edge")
        parts = [padded.take(range(k, k + small.shape[axis]), axis) for k in range(3)]
        pair = [0.75 * parts[1] + 0.25 * parts[k] for k in (0, 2)]
        shape = [n * (2 if axis == k else 1) for k, n in enumerate(small.shape)]
        small = np.stack(pair, axis=axis + 1).reshape(shape)
    return small.astype(np.float32)


def median(image):
    steps = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1)]
    return np.median([np.roll(image, step, (0, 1)) for step in steps], axis=0).astype(np.float32)


def pulled(image, radii=(1.0, 2.0, 3.0)):
    """Blurred more and more down the frame."""
    pictures = np.stack([image, *(through_disc(image, radius) for radius in radii)])
    at = np.linspace(0, len(radii) - 1e-3, len(image))
    rows, low, share = np.arange(len(image)), at.astype(int), np.float32(at % 1)[:, None, None]
    return (1 - share) * pictures[low, rows] + share * pictures[low + 1, rows]


# What is done, and words of the line.
FAULTS: dict[str, tuple[Callable[[Pixels], Pixels], str]] = {
    "right": (lambda a: _shifted(a, 1, 0), "shifted by (1, 0)"),
    "left and down": (lambda a: _shifted(a, -3, 2), "shifted by (-3, 2)"),
    "around": (lambda a: np.roll(a, -5, 0), "shifted by (0, -5)"),
    "half a pixel": (
        lambda a: (blurred(a, 1) + np.roll(blurred(a, 1), 1, 1)) / 2,
        "another CoC or bokeh shape: blurred more",
    ),
    "mirrored": (lambda a: a[:, ::-1], "flipped left to right"),
    "upside down": (lambda a: a[::-1], "flipped upside down"),
    "turned": (lambda a: a[::-1, ::-1], "rotated by 180°"),
    "side by side": (lambda a: np.roll(a, WIDTH // 2, 1), "left and right swapped"),
    "BGR": (lambda a: a[..., ::-1], "channels swapped: R is B, B is R"),
    "GBR": (lambda a: a[..., [1, 2, 0]], "channels swapped: R is G, G is B, B is R"),
    "gamma 2 %": (lambda a: a**1.02, "another gamma: to the power 1.02"),
    "gamma 2.2": (lambda a: a ** (1 / 2.2), "another gamma: to the power 0.4545"),
    "encoded twice": (linear_to_srgb, "another gamma: sRGB-encoded once more"),
    "display gamma": (
        lambda a: srgb_to_linear(_encoded(a) ** 1.1),
        "clipped at 1, another gamma: to the power 1.1, sRGB-encoded",
    ),
    "a stop": (lambda a: 2 * a, "another exposure: x 2 (+1 EV)"),
    "2 % darker": (lambda a: 0.98 * a, "another exposure: x 0.98"),
    "warmer": (
        lambda a: a * np.float32([1.25, 1, 0.75]),
        "another exposure of each channel: R x 1.25, B x 0.75",
    ),
    "clipped": (lambda a: np.minimum(a, 1), "clipped at 1,"),
    "8 bits": (
        lambda a: srgb_to_linear(np.rint(_encoded(a) * 255) / 255),
        "clipped at 1, quantised to 8 bits",
    ),
    "8 bits, linear": (lambda a: np.rint(np.clip(a, 0, 1) * 255) / 255, "quantised to 8 bits"),
    "larger CoC": (lambda a: blurred(a, 2), "another CoC: blurred more"),
    "window of data": (_cut, "crop: 0 outside of 95x62 at 5,8"),
    "cut": (lambda a: a[8:70, 5:100], "crop: 95x62 at 5,8 of 128x90"),
    "half of the size": (lambda a: a[::2, ::2], "another size: 64x45"),
    "on its side": (np.rot90, "rotated by 90° to the left"),
    "NaN": (lambda a: _block(a, np.nan), "NaN in 16 pixels, the first at 20,10"),
    "Inf": (lambda a: _block(a, np.inf), "Inf in 16 pixels, the first at 20,10"),
    "negative": (lambda a: -a, "sign reversed"),
    "black": (lambda a: 0 * a, "empty: R 0, G 0, B 0 everywhere"),
    "noise": (lambda a: a + _noise(a, 0.01), "noise of about 0.0"),
    # Of one channel.
    "red moved": (lambda a: _of_channel(a, 0, warped(a, dx=0.8)), "R shifted by (0."),
    "green offset": (lambda a: a + np.float32([0, 0.02, 0]), "G raised blacks: +0.02 of light"),
    "blue noisy": (lambda a: _of_channel(a, 2, a + _noise(a, 0.02)), "B: noise of about 0.0"),
    # Of colour spaces.
    **{
        name: (partial(converted, name), f"other primaries: {name} instead of Rec. 709")
        for name in PRIMARIES
    },
    "grey": (
        lambda a: (a @ np.float32([0.2126, 0.7152, 0.0722]))[..., None].repeat(3, axis=2),
        "monochrome: 0.21 R +0.72 G +0.07 B",
    ),
    # Of rivals, which soften.
    "disc of 2 px": (through_disc, "another CoC: blurred more, everywhere alike, as by a radius"),
    "a line of 9 px": (_along, "motion blur: 9"),
    "half, bilinear": (lambda a: doubled(halved(a)), "lower resolution: half resolution, bilinear"),
    "median of neighbours": (median, "noise removed: smeared"),
    "blurred down the frame": (pulled, "another CoC or bokeh shape: blurred more"),
    "sharpened": (lambda a: a + 0.6 * (a - blurred(a, 1)), "sharpened: detail x 1.6"),
    # Small ones.
    "a tenth of a pixel": (lambda a: warped(a, dx=0.1), "shifted by (0.1"),
    "a twentieth of a pixel": (lambda a: warped(a, dx=0.05), "shifted by (0.05"),
    "blue enlarged": (
        lambda a: _of_channel(a, 2, warped(a, scale=1.006)),
        "B scaled by 1.006,",
    ),
    "a little of light": (lambda a: a + 0.003, "raised blacks: +0.003"),
}


def compared(a, b, rules=_NO_RULES, **settings):
    """The record of two files."""
    return compare_pair(FilePair(b.name, a, b), rules, CompareSettings(**settings))[0]


def write_planes(path, planes, compression=None, **header):
    """An EXR file in scan lines, ZIP compressed unless another codec is named."""
    codec = OpenEXR.ZIP_COMPRESSION if compression is None else compression
    settings = {"compression": codec, "type": OpenEXR.scanlineimage, **header}
    whole = {name: np.ascontiguousarray(plane) for name, plane in planes.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    OpenEXR.File(settings, whole).write(str(path))
    return path


def planes(image, dtype=np.float16):
    """The channels R, G and B of an image."""
    return {name: image[..., index].astype(dtype) for index, name in enumerate("RGB")}


def _tiles(path, image):
    save(path, image.astype(np.float16), tile=(32, 16))


def _wide(path, image):
    """More data than is shown."""
    data, display = box(-8, -4, WIDTH + 7, HEIGHT + 3), box(0, 0, WIDTH - 1, HEIGHT - 1)
    padded = planes(np.pad(image, ((4, 4), (8, 8), (0, 0)), constant_values=9.0))
    write_planes(path, padded, dataWindow=data, displayWindow=display)


def dark_border(image):
    image = image.copy()
    image[:6] = image[-5:] = image[:, :9] = 0.0
    return image


def narrow(path, image):
    """Less data than is shown, with 0 in what is not there."""
    inner = planes(image[6:-5, 9:])
    data, display = box(9, 6, WIDTH - 1, HEIGHT - 6), box(0, 0, WIDTH - 1, HEIGHT - 1)
    write_planes(path, inner, dataWindow=data, displayWindow=display)


def _codec(name):
    def write(path, image):
        write_planes(path, planes(image), getattr(OpenEXR, f"{name}_COMPRESSION"))

    return write


def _parts(path, image, order="RGB"):
    """Each channel in a part of its own, in an order."""
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
    every = planes(image)
    each = [(name, every[name]) for name in order]
    made = [OpenEXR.Part({"name": name, **header}, {name: plane}) for name, plane in each]
    OpenEXR.File(made).write(str(path))


def _described(path, image):
    write_planes(path, planes(image), comments="another day", owner="somebody else")


def _as_float(path, image):
    write_planes(path, planes(image, np.float32))


def _downwards(path, image):
    write_planes(path, planes(image), lineOrder=OpenEXR.DECREASING_Y)


def _small_tiles(path, image):
    save(path, image.astype(np.float16), tile=(16, 16))


# Codecs that change no half.
_LOSSLESS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "HTJ2K32", "HTJ2K256")
# Ways to write the scene anew that change no value, by name.
BENIGN: dict[str, Callable[[Path, Pixels], Any]] = {
    **{f"codec {name}": _codec(name) for name in _LOSSLESS},
    "tiles": _tiles,
    "float of half": _as_float,
    "metadata": _described,
    "more data than is shown": _wide,
    "a part for each channel": _parts,
    "parts in another order of channels": partial(_parts, order="BRG"),
    "lines from the bottom": _downwards,
    "smaller tiles": _small_tiles,
    "owner and time": lambda path, image: write_planes(
        path, planes(image), owner="them", capDate="2001:01:01 00:00:00"
    ),
    "a float of half in PIZ": lambda path, image: write_planes(
        path, planes(image, np.float32), OpenEXR.PIZ_COMPRESSION
    ),
}

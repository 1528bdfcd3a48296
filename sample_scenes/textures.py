"""Procedural textures: functions of coordinates in metres that return linear RGB [..., 3]."""

import math

import numpy as np
import numpy.typing as npt
from surfaces import Array, Bools, Texture

Paint = tuple[float, float, float]

# 5 x 7 dots a glyph, one row a number, the highest of its five bits on the left
GLYPHS = {
    "0": (14, 17, 19, 21, 25, 17, 14),
    "1": (4, 12, 4, 4, 4, 4, 14),
    "2": (14, 17, 1, 6, 8, 16, 31),
    "3": (14, 17, 1, 6, 1, 17, 14),
    "4": (2, 6, 10, 18, 31, 2, 2),
    "5": (31, 16, 30, 1, 1, 17, 14),
    "6": (6, 8, 16, 30, 17, 17, 14),
    "7": (31, 1, 2, 4, 8, 8, 8),
    "8": (14, 17, 17, 14, 17, 17, 14),
    "9": (14, 17, 17, 15, 1, 2, 12),
    "A": (4, 10, 17, 17, 31, 17, 17),
    "B": (30, 17, 17, 30, 17, 17, 30),
    "C": (14, 17, 16, 16, 16, 17, 14),
    "D": (30, 17, 17, 17, 17, 17, 30),
    "E": (31, 16, 16, 30, 16, 16, 31),
    "F": (31, 16, 16, 30, 16, 16, 16),
    "G": (14, 17, 16, 23, 17, 17, 14),
    "H": (17, 17, 17, 31, 17, 17, 17),
    "I": (14, 4, 4, 4, 4, 4, 14),
    "K": (17, 18, 20, 24, 20, 18, 17),
    "L": (16, 16, 16, 16, 16, 16, 31),
    "M": (17, 27, 21, 21, 17, 17, 17),
    "N": (17, 25, 21, 19, 17, 17, 17),
    "O": (14, 17, 17, 17, 17, 17, 14),
    "P": (30, 17, 17, 30, 16, 16, 16),
    "R": (30, 17, 17, 30, 20, 18, 17),
    "S": (15, 16, 16, 14, 1, 1, 30),
    "T": (31, 4, 4, 4, 4, 4, 4),
    "U": (17, 17, 17, 17, 17, 17, 14),
    "Y": (17, 17, 10, 4, 4, 4, 4),
    "/": (1, 1, 2, 4, 8, 16, 16),
    ".": (0, 0, 0, 0, 0, 12, 12),
    " ": (0, 0, 0, 0, 0, 0, 0),
}


def paint(code: int) -> Paint:
    """Linear RGB of a screen colour 0xRRGGBB."""
    screen = [(code >> shift & 255) / 255 for shift in (16, 8, 0)]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in screen)
    return red, green, blue


def mix(share: Array | Bools, below: Array | Paint, above: Array | Paint) -> Array:
    """`below` where share is 0, `above` where it is 1."""
    t = np.asarray(share, dtype=float)[..., None]
    start = np.asarray(below)
    return np.asarray(start + t * (np.asarray(above) - start))


def smooth(x: Array, start: float, stop: float) -> Array:
    """Smooth step from 0 at `start` to 1 at `stop`."""
    t = np.clip((x - start) / (stop - start), 0.0, 1.0)
    return np.asarray(t * t * (3 - 2 * t))


def chance(i: Array, j: Array, seed: int = 0) -> Array:
    """A fixed pseudo-random number in [0, 1) for each pair of whole numbers."""
    mixed = (i.astype(np.int64) * 73856093) ^ (j.astype(np.int64) * 19349663) ^ (seed * 83492791)
    bits: npt.NDArray[np.uint64] = mixed.astype(np.uint64)
    with np.errstate(over="ignore"):
        for factor in (0xFF51AFD7ED558CCD, 0xC4CEB9FE1A85EC53, 1):
            bits = (bits ^ (bits >> np.uint64(33))) * np.uint64(factor)
    return np.asarray((bits >> np.uint64(11)) / float(1 << 53))


def noise(u: Array, v: Array, seed: int = 0) -> Array:
    """Smooth value noise in [0, 1), one random number per unit cell."""
    i, j = np.floor(u), np.floor(v)
    a, b = smooth(u - i, 0, 1), smooth(v - j, 0, 1)
    top = (1 - a) * chance(i, j, seed) + a * chance(i + 1, j, seed)
    bottom = (1 - a) * chance(i, j + 1, seed) + a * chance(i + 1, j + 1, seed)
    return np.asarray((1 - b) * top + b * bottom)


def text(u: Array, v: Array, words: str, height: float) -> Bools:
    """Letters of `height`, their block centred on the origin; lines are separated by a slash-n."""
    lines = words.split("\n")
    width = max(len(line) for line in lines)
    dots = np.zeros((9 * len(lines) + 1, 6 * width + 3))
    for row, line in enumerate(lines):
        start = 3 * (width - len(line)) + 2
        for column, letter in enumerate(line):
            for k, bits in enumerate(GLYPHS[letter]):
                place = start + 6 * column
                dots[9 * row + k + 1, place : place + 5] = [bits >> n & 1 for n in (4, 3, 2, 1, 0)]
    x, y = u * 7 / height + dots.shape[1] / 2 - 0.5, v * 7 / height + dots.shape[0] / 2 - 0.5
    ink = (x >= 0) & (x < dots.shape[1] - 1) & (y >= 0) & (y < dots.shape[0] - 1)
    x, y = x[ink], y[ink]
    i, j = x.astype(int), y.astype(int)
    a, b = x - i, y - j
    top = (1 - a) * dots[j, i] + a * dots[j, i + 1]
    bottom = (1 - a) * dots[j + 1, i] + a * dots[j + 1, i + 1]
    # interpolated and cut, the dots grow together into rounded strokes
    ink[ink] = (1 - b) * top + b * bottom > 0.36
    return ink


def plain(colour: Paint) -> Texture:
    """One colour."""
    return lambda u, v: np.broadcast_to(np.asarray(colour), (*u.shape, 3))


def checker(size: float, dark: Paint, bright: Paint) -> Texture:
    """Checkerboard with squares of `size`."""
    return lambda u, v: mix((np.floor(u / size) + np.floor(v / size)) % 2, dark, bright)


def stripes(period: float, angle: float, dark: Paint, bright: Paint) -> Texture:
    """Stripes at `angle` degrees."""
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return lambda u, v: mix(((c * u + s * v) / period) % 1 < 0.5, dark, bright)


def rings(period: float, dark: Paint, bright: Paint) -> Texture:
    """Circles around the origin."""
    return lambda u, v: mix((np.hypot(u, v) / period) % 1 < 0.5, dark, bright)


def dots(period: float, ground: Paint, dot: Paint) -> Texture:
    """Round dots in staggered rows."""

    def texture(u: Array, v: Array) -> Array:
        row = np.floor(v / period)
        x = (u / period + 0.5 * (row % 2)) % 1 - 0.5
        return mix(np.hypot(x, v / period - row - 0.5) < 0.3, ground, dot)

    return texture


def lettered(words: str, height: float, ground: Texture, ink: Paint) -> Texture:
    """Letters on another texture."""
    return lambda u, v: mix(text(u, v, words, height), ground(u, v), ink)


def framed(half: tuple[float, float], margin: float, inside: Texture, frame: Paint) -> Texture:
    """A frame of width `margin` along the edge of a rectangle."""

    def texture(u: Array, v: Array) -> Array:
        edge = (np.abs(u) > half[0] - margin) | (np.abs(v) > half[1] - margin)
        return mix(edge, inside(u, v), frame)

    return texture


def planks(width: float, length: float, dark: Paint, bright: Paint) -> Texture:
    """Wooden boards along v, with grain and narrow gaps."""

    def texture(u: Array, v: Array) -> Array:
        board = np.floor(u / width)
        along = v / length + chance(board, 0 * board, 1)
        piece = np.floor(along)
        tone = chance(board, piece, 2)
        bend = 1.5 * noise(u / width + 7 * tone, v / length * 3 + 11 * tone, 3)
        grain = 0.5 + 0.5 * np.sin(2 * math.pi * (3 * u / width + 2 * bend + 5 * tone))
        wood = mix(
            0.55 * tone + 0.35 * grain * noise(u / width * 2, v / length * 2, 4), dark, bright
        )
        gap = (np.abs(u / width % 1 - 0.5) > 0.48) | (np.abs(along % 1 - 0.5) > 0.4965)
        return mix(gap, wood, np.asarray(dark) * 0.2)

    return texture


def bricks(width: float, height: float, dark: Paint, bright: Paint, mortar: Paint) -> Texture:
    """Brick wall in stretcher bond."""

    def texture(u: Array, v: Array) -> Array:
        row = np.floor(v / height)
        x = u / width + 0.5 * (row % 2)
        column = np.floor(x)
        tone = 0.7 * chance(column, row, 5) + 0.3 * noise(u / width * 4, v / height * 3, 6)
        joint = (np.abs(x - column - 0.5) * width > width / 2 - 0.006) | (
            np.abs(v / height - row - 0.5) * height > height / 2 - 0.006
        )
        return mix(joint, mix(tone, dark, bright), mortar)

    return texture

"""Kinds of faults, each from barely visible to strong: what is said of them is counted.

`KINDS` is the table: what is right to say, what is plausible, and what makes B of a picture by a
strength of 0 to 1. Pictures are rendered ones of scenes with known depth, held in memory.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
from planted_faults import blurred, doubled, halved, through_disc, warped

from defocus_core.compare.comparison import compare_pictures
from defocus_core.compare.findings.table import is_place
from defocus_core.compare.picture import DecodedPicture
from defocus_core.compare.record import CompareSettings
from defocus_core.compare.thresholds import PRESETS
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear

Pixels = np.ndarray[Any, Any]
_SAMPLES = Path(__file__).parents[2] / "sample_scenes"
SHARED = Path(__file__).parents[3] / "shared" / "truth"
SCENES = {
    **{name: _SAMPLES / name for name in ("spheres", "lights", "leaves", "floor", "layered")},
    **{f"traced {name}": SHARED / name for name in ("room", "cards", "night", "spheres", "fence")},
}
_SIZE = (240, 320)
# Says how light moved, where, that two tie, or that it is slight: no cause is claimed.
NO_CAUSE = ("spread otherwise", "softened", "too small to name")


@dataclass(frozen=True)
class Shot:
    """A picture [H, W, 3] of light, its planar depth [H, W] in m, its focal length in px."""

    light: Pixels
    depth: Pixels
    focal: float
    rng: np.random.Generator

    @property
    def shown(self):
        """Values of 8 bits, as 0…1."""
        return _rounded(linear_to_srgb(self.light.clip(0, 1)))

    @property
    def near(self):
        """Where the nearest third of the depths is, 0 or 1 [H, W]."""
        return (self.depth < np.quantile(self.depth, 0.33)).astype(np.float32)

    @property
    def yx(self):
        """Places of −1 … 1 down and across, [2, H, W]."""
        height, width = self.light.shape[:2]
        return np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)

    def noisy(self, amount=0.02):
        """With noise of photons."""
        noise = self.rng.standard_normal(self.light.shape)
        return self.light + amount * np.sqrt(np.maximum(self.light, 0.01)) * noise


@cache
def _scene(name):
    folder = SCENES[name]
    file = sorted(folder.glob("truth_*.exr"), key=lambda f: ("_left" in f.name, "_right" in f.name))
    light, depth = (
        oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT) for path in (file[0], folder / "depth.exr")
    )
    step = max(1, light.shape[0] // 270)
    height, width = (n // step * step for n in light.shape[:2])
    light = light[:height, :width].reshape(height // step, step, width // step, step, 3)
    light, depth = light.mean(axis=(1, 3)), depth[:height:step, :width:step, 0]
    top, left = (light.shape[0] - _SIZE[0]) // 2, (light.shape[1] - _SIZE[1]) // 2
    cut = (slice(top, top + _SIZE[0]), slice(left, left + _SIZE[1]))
    finite = depth[np.isfinite(depth)]
    depth = np.minimum(depth, finite.max())[cut]
    return light[cut].astype(np.float16).astype(np.float32), depth.astype(np.float32)


def shot(name, seed):
    light, depth = _scene(name)
    return Shot(light, depth, 1.4 * light.shape[1], np.random.default_rng(seed))


def _rounded(values, levels=255):
    return (np.rint(values.clip(0, 1) * levels) / levels).astype(np.float32)


def _between(low, high):
    """Of a strength, geometrically."""
    return lambda s: float(low * (high / low) ** s)


def rgb(image):
    return {name: image[..., k] for k, name in enumerate("RGB")}


# What makes A and B, as channels, of a shot by a strength.
Made = tuple[dict[str, Pixels], dict[str, Pixels]]
Make = Callable[[Shot, float], Made]


def of_light(change):
    """A of light, and B by a change of it."""
    return lambda m, s: (rgb(m.light), rgb(np.asarray(change(m, s), np.float32)))


def of_shown(change):
    """8 bits as a screen shows them, and a change of them, rounded again."""
    return lambda m, s: (rgb(m.shown), rgb(_rounded(np.asarray(change(m, s), np.float32))))


def of_depth(change):
    return lambda m, s: ({"Z": m.depth}, {"Z": np.asarray(change(m, s), np.float32)})


def within(change):
    """Only in a rectangle, of a quarter of the sides and more."""

    def made(m, s):
        b, (height, width) = m.light.copy(), m.light.shape[:2]
        y, x = m.rng.integers(0, height // 2), m.rng.integers(0, width // 2)
        cut = (slice(y, y + height // 3), slice(x, x + width // 3))
        b[cut] = change(m, s)[cut]
        return b

    return made


def _chromatic(m, s, low=0.0004, high=0.012):
    amount = _between(low, high)(s)
    return np.stack(
        [
            warped(m.light[..., :1], scale=1 + amount)[..., 0],
            m.light[..., 1],
            warped(m.light[..., 2:], scale=1 - amount)[..., 0],
        ],
        axis=2,
    )


_GLYPHS = {
    "D": "1111010001100011000110001100011110",
    "E": "11111100001111010000100001000011111",
    "R": "11110100011000111110101001001010001",
    "O": "01110100011000110001100011000101110",
    "F": "11111100001111010000100001000010000",
    "A": "01110100011000111111100011000110001",
    "T": "11111001000010000100001000010000100",
    "S": "01111100001000001110000010000111110",
}


def _text(word, size, scale, y, x):
    """Coverage [H, W] of letters of 5 x 7 squares of ``scale`` px, edges anti-aliased."""
    mask = np.zeros((*size,), np.float32)
    for k, letter in enumerate(word):
        bits = _GLYPHS[letter].ljust(35, "0")
        glyph = np.array([float(b) for b in bits], np.float32).reshape(7, 5)
        glyph = np.kron(glyph, np.ones((scale, scale), np.float32))
        top, left = y, x + k * 6 * scale
        part = mask[top : top + glyph.shape[0], left : left + glyph.shape[1]]
        part += glyph[: part.shape[0], : part.shape[1]]
    return blurred(mask[..., None], 0.4)[..., 0].clip(0, 1)


def _written(m, image, s, scale, color, opacity):
    height, width = image.shape[:2]
    y, x = m.rng.integers(0, height // 2), m.rng.integers(0, width // 4)
    cover = opacity * _text("STORED"[: 3 + int(3 * s)], (height, width), scale, y, x)[..., None]
    return image * (1 - cover) + cover * np.float32(color)


_COLORS = ((1, 1, 1), (0, 0, 0), (1, 0.8, 0.1), (0.1, 0.2, 0.8))


def _lettered(m, image, s):
    color = _COLORS[int(m.rng.integers(0, 4))]
    return _written(m, image, s, int(m.rng.integers(1, 4)), color, 0.6 + 0.4 * s)


def _watermarked(m, image, s):
    return _written(m, image, s, int(m.rng.integers(4, 9)), (1, 1, 1), _between(0.04, 0.4)(s))


def _garbage_line(m, image, s):
    b, row = image.copy(), int(m.rng.integers(0, len(image)))
    amount = _between(0.05, 1.0)(s)
    noise = m.rng.random(b[row].shape)
    b[row] = b[row] * (1 - amount) + amount * noise
    return b


def _bloom(m, s, wide=(4, 16)):
    sigma, light = m.rng.uniform(*wide), m.light
    bright = np.maximum(light - np.quantile(light, 0.98), 0)
    return light + _between(0.03, 0.6)(s) * blurred(bright, sigma)


def _radial(m, s):
    y, x = m.yx
    height, width = m.depth.shape
    focal = m.focal / _between(0.4, 3.0)(s)  # a wider angle is stronger
    return m.depth * np.sqrt(1 + (x * x * width**2 + y * y * height**2) / (4 * focal * focal))


def _ids(m):
    """Whole numbers of 12 slabs of depth, in blocks across."""
    order = np.digitize(m.depth, np.quantile(m.depth, np.linspace(0, 1, 7)[1:-1]))
    return (order * 2 + (m.yx[1] > 0)).astype(np.float32)


def _shuffled(m, s):
    ids = _ids(m)
    known, order = np.unique(ids), np.arange(len(np.unique(ids)))
    some = m.rng.permutation(len(known))[: max(2, round(s * len(known)))]
    order[some] = np.roll(order[some], 1)
    return {"id": ids}, {"id": known[order][np.searchsorted(known, ids)].astype(np.float32)}


def _resized(image, factor, how):
    height, width = image.shape[:2]
    for h, w in ((round(height * factor), round(width * factor)), (height, width)):
        buffer = oiio.ImageBuf(oiio.ImageSpec(image.shape[1], image.shape[0], 3, oiio.FLOAT))
        buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(image, np.float32))
        roi = oiio.ROI(0, w, 0, h, 0, 1, 0, 3)
        image = oiio.ImageBufAlgo.resize(buffer, filtername=how, roi=roi).get_pixels(oiio.FLOAT)
    return image


def _smaller(m, image, s):
    how = ("triangle", "lanczos3", "keys", "blackman-harris")[int(m.rng.integers(0, 4))]
    return _resized(image, 1 - _between(0.04, 0.75)(s), how)


def _jpeg(image, quality, subsampling="4:2:0"):
    import io

    from PIL import Image

    file = io.BytesIO()
    picture = Image.fromarray(np.rint(image * 255).astype(np.uint8))
    picture.save(file, "JPEG", quality=quality, subsampling=subsampling)
    return np.asarray(Image.open(file), np.float32) / 255


def _bilateral(image, strength=0.08):
    shown = linear_to_srgb(image.clip(0, 1)).mean(axis=2)
    total, weights = np.zeros_like(image), np.zeros((*shown.shape, 1), np.float32)
    for dy, dx in np.ndindex(5, 5):
        moved, beside = (np.roll(v, (dy - 2, dx - 2), (0, 1)) for v in (image, shown))
        weight = np.exp(-np.square((beside - shown) / strength))[..., None]
        total, weights = total + weight * moved, weights + weight
    return (total / weights).astype(np.float32)


def _denoised(m, s):
    noisy = m.noisy(_between(0.008, 0.06)(s)).astype(np.float32)
    clean = (m.light, _bilateral(noisy), blurred(noisy, 1.0))[int(m.rng.integers(0, 2))]
    return rgb(noisy), rgb(np.asarray(clean, np.float32))


def _cleaned_png(m, s):
    noise = _between(1.5, 8)(s) / 255 * m.rng.standard_normal(m.shown.shape)
    noisy = _rounded(m.shown + noise)
    clean = (m.shown, _rounded(_bilateral(noisy, 0.1)))[int(m.rng.integers(0, 2))]
    return rgb(noisy), rgb(clean)


def _grey_object(m, s):
    luma = (m.light @ np.float32([0.2126, 0.7152, 0.0722]))[..., None]
    share = (_between(0.1, 1.0)(s) * m.near)[..., None]
    return m.light * (1 - share) + share * luma


def _right_half_moved(m, s):
    half = m.light.shape[1] // 2
    b = m.light.copy()
    b[:, half:] = warped(m.light, dx=_between(0.1, 3)(s))[:, half:]
    return b


def _lights(m):
    y, x = m.yx
    cy, cx = m.rng.uniform(-0.7, 0.7, 2)
    return np.exp(-((y - cy) ** 2 + (x - cx) ** 2) / 0.15)[..., None]


def _environment(m, s):
    y, x = m.yx
    phase = m.rng.uniform(0, 6, 3)
    shade = np.stack(
        [np.sin(2.2 * x + 1.7 * y + p) * np.cos(1.3 * x - 2 * y + p) for p in phase], 2
    )
    return m.light * (1 + _between(0.03, 0.5)(s) * shade * (0.4 + m.near[..., None]))


def _rgba(m, change):
    y, x = m.yx
    alpha = (6 * (0.7 - np.hypot(x, y * 0.8))).clip(0, 1).astype(np.float32)
    made = {**rgb(m.light * alpha[..., None]), "A": alpha}
    b = change(made)
    return made, b


def _shrunk(plane, reach):
    for axis in (0, 1):
        parts = [np.roll(plane, k, axis) for k in range(-reach, reach + 1)]
        plane = np.min(parts, axis=0)
    return plane


def _eroded(m, s):
    reach = 1 + int(3.99 * s)
    return _rgba(m, lambda a: {n: _shrunk(p, reach) if n == "A" else p for n, p in a.items()})


def _no_specular(m, s):
    shine = np.maximum(m.light - np.quantile(m.light, 0.6 + 0.3 * (1 - s)), 0)
    diffuse = m.light - shine
    beauty = rgb(m.light)
    more = {
        f"{name}.{c}": layer[..., k]
        for name, layer in (("diffuse", diffuse), ("specular", shine))
        for k, c in enumerate("RGB")
    }
    return {**beauty, **more}, {**rgb(diffuse), **more}


def _sheared(m, s):
    height = m.light.shape[0]
    steps = np.rint(np.linspace(0, _between(2, 20)(s), height)).astype(int)
    return np.stack([np.roll(row, k, 0) for row, k in zip(m.light, steps, strict=True)])


def _barrel(m, s):
    y, x = m.yx
    height, width = m.depth.shape
    k = _between(0.001, 0.03)(s) * (x * x + y * y)
    row, col = ((v * (1 + k) + 1) / 2 * (n - 1) for v, n in ((y, height), (x, width)))
    from scipy.ndimage import map_coordinates

    return np.stack(
        [map_coordinates(m.light[..., c], [row, col], order=3, mode="nearest") for c in range(3)], 2
    )


def _object_moved(m, s):
    step = 1 + int(_between(1, 9)(s))
    mask = np.roll(m.near, step, 1)[..., None]
    return np.where(mask > 0, np.roll(m.light, step, 1), m.light)


def _dithered(m, s):
    return m.shown + _between(1, 8)(s) / 255 * (m.rng.random(m.shown.shape) - 0.5)


@dataclass(frozen=True)
class Kind:
    """A kind of fault: names that are right, names that mislead nobody, and what makes it."""

    right: tuple[str, ...]
    plausible: tuple[str, ...]
    make: Make
    dtype: str = "float16"


_REGION = (
    "in one region",
    "in shadows",
    "in highlights",
    "at edges",
    "out of focus only",
    "in focus only",
    "at silhouettes",
    "at the border",
)
_PNG = "uint8"
_COC = ("another CoC", "softened", "spread otherwise")
_NOISE = ("noise removed", "noise")

KINDS: dict[str, Kind] = {
    # Of the issue.
    "depth normalised": Kind(
        ("normalised",),
        ("multiplied", "offset"),
        of_depth(
            lambda m, s: (
                (m.depth - (1 - s) * m.depth.min())
                / (m.depth.max() * (1 + 2 * s) - (1 - s) * m.depth.min())
            )
        ),
        "float32",
    ),
    "inverse depth": Kind(
        ("normalised", "inverse"),
        ("another tone curve", "another gamma"),
        of_depth(lambda m, s: (1 / m.depth - 1 / m.depth.max() * (1 - s)) / (1 / m.depth.min())),
        "float32",
    ),
    "chromatic aberration": Kind(("chromatic aberration",), ("scaled",), of_light(_chromatic)),
    "chromatic, PNG": Kind(
        ("chromatic aberration",),
        ("scaled",),
        of_shown(lambda m, s: linear_to_srgb(_chromatic(m, s, 0.0015, 0.015).clip(0, 1))),
        _PNG,
    ),
    "text": Kind(("overlay",), _REGION, of_light(lambda m, s: _lettered(m, m.light, s))),
    "text, PNG": Kind(("overlay",), _REGION, of_shown(lambda m, s: _lettered(m, m.shown, s)), _PNG),
    "watermark": Kind(("overlay",), _REGION, of_light(lambda m, s: _watermarked(m, m.light, s))),
    "watermark, PNG": Kind(
        ("overlay",), _REGION, of_shown(lambda m, s: _watermarked(m, m.shown, s)), _PNG
    ),
    "6 bits in 8": Kind(
        ("quantised to",),
        (),
        of_shown(lambda m, s: _rounded(m.shown, 2 ** (7 - int(3.99 * s)) - 1)),
        _PNG,
    ),
    "6 bits": Kind(
        ("quantised to",),
        (),
        of_light(
            lambda m, s: srgb_to_linear(
                _rounded(linear_to_srgb(m.light.clip(0, 1)), 2 ** (7 - int(3.99 * s)) - 1)
            )
        ),
    ),
    "line of garbage": Kind(
        ("damaged lines",), _REGION, of_light(lambda m, s: _garbage_line(m, m.light, s))
    ),
    "line of garbage, PNG": Kind(
        ("damaged lines",), _REGION, of_shown(lambda m, s: _garbage_line(m, m.shown, s)), _PNG
    ),
    "bloom": Kind(("bloom",), ("raised blacks", "spread otherwise"), of_light(_bloom)),
    "bloom, PNG": Kind(
        ("bloom",),
        ("raised blacks", "spread otherwise"),
        of_shown(lambda m, s: linear_to_srgb(_bloom(m, s).clip(0, 1))),
        _PNG,
    ),
    "radial depth": Kind(("radial depth",), ("vignette",), of_depth(_radial), "float32"),
    "ids shuffled": Kind(("ids exchanged",), _REGION, _shuffled),
    "lift, PNG": Kind(
        ("raised blacks",),
        ("another tone curve",),
        of_shown(lambda m, s: m.shown + _between(1.5, 24)(s) / 255),
        _PNG,
    ),
    "lift of light, PNG": Kind(
        ("raised blacks",),
        ("another tone curve",),
        of_shown(
            lambda m, s: linear_to_srgb(
                (srgb_to_linear(m.shown) + _between(0.003, 0.06)(s)).clip(0, 1)
            )
        ),
        _PNG,
    ),
    "green offset, PNG": Kind(
        ("raised blacks", "another white", "another exposure"),
        ("another tone curve",),
        of_shown(lambda m, s: m.shown + _between(1.5, 20)(s) / 255 * np.float32([0, 1, 0])),
        _PNG,
    ),
    "noise removed": Kind(_NOISE, ("softened",), _denoised),
    "noise removed, PNG": Kind(_NOISE, ("softened",), _cleaned_png, _PNG),
    "resized and back": Kind(
        ("lower resolution",), _COC, of_light(lambda m, s: _smaller(m, m.light, s))
    ),
    "resized and back, PNG": Kind(
        ("lower resolution",), _COC, of_shown(lambda m, s: _smaller(m, m.shown, s)), _PNG
    ),
    "JPEG": Kind(
        ("compressed with losses",),
        ("too small to name",),
        of_shown(lambda m, s: _jpeg(m.shown, round(97 - 50 * s))),
        _PNG,
    ),
    # Local faults and global ones that nothing explains.
    "denoised tile": Kind(
        ("in one region", "noise removed"),
        _REGION,
        of_light(within(lambda m, s: _bilateral(m.light, _between(0.02, 0.2)(s)))),
    ),
    "blurred tile": Kind(
        ("in one region",),
        _REGION,
        of_light(within(lambda m, s: blurred(m.light, _between(0.5, 3)(s)))),
    ),
    "brighter tile": Kind(
        ("in one region",),
        _REGION,
        of_light(within(lambda m, s: m.light * (1 + _between(0.01, 0.5)(s)))),
    ),
    "grey object": Kind(_REGION, (), of_light(_grey_object)),
    "object brighter": Kind(
        _REGION, (), of_light(lambda m, s: m.light * (1 + _between(0.02, 1)(s) * m.near[..., None]))
    ),
    "right half moved": Kind(
        ("in one region", "another view or frame"), (), of_light(_right_half_moved)
    ),
    "light missing": Kind(
        _REGION, (), of_light(lambda m, s: m.light * (1 - _between(0.05, 0.9)(s) * _lights(m)))
    ),
    "environment rotated": Kind(_REGION, (), of_light(_environment)),
    "overscan cropped": Kind(
        ("scaled", "shifted"),
        (),
        of_light(lambda m, s: warped(m.light, scale=_between(1.005, 1.08)(s))),
    ),
    "cropped to black": Kind(
        ("crop",),
        _REGION,
        of_light(lambda m, s: m.light * (np.abs(m.yx).max(axis=0) < 0.99 - 0.2 * s)[..., None]),
    ),
    "alpha eroded": Kind(("eroded",), _REGION, _eroded),
    "specular missing": Kind(("missing layer",), _REGION, _no_specular),
    "object moved": Kind(
        ("another view or frame", "in one region"), _REGION, of_light(_object_moved)
    ),
    # That nobody named.
    "exposure": Kind(
        ("another exposure",), (), of_light(lambda m, s: m.light * (1 + _between(0.002, 0.5)(s)))
    ),
    "gamma, PNG": Kind(
        ("another gamma",),
        ("another tone curve", "another contrast"),
        of_shown(lambda m, s: m.shown ** (1 + _between(0.02, 0.6)(s))),
        _PNG,
    ),
    "white balance": Kind(
        ("another exposure",),
        (),
        of_light(
            lambda m, s: (
                m.light * np.float32([1 + _between(0.01, 0.3)(s), 1, 1 - _between(0.01, 0.3)(s)])
            )
        ),
    ),
    "gaussian blur": Kind(
        _COC, ("lower resolution",), of_light(lambda m, s: blurred(m.light, _between(0.35, 4)(s)))
    ),
    "sharpened, PNG": Kind(
        ("sharpened",),
        ("another CoC",),
        of_shown(lambda m, s: m.shown + _between(0.15, 2)(s) * (m.shown - blurred(m.shown, 1.2))),
        _PNG,
    ),
    "shift": Kind(
        ("shifted",), (), of_light(lambda m, s: warped(m.light, dx=_between(0.05, 2.5)(s)))
    ),
    "turned, PNG": Kind(
        ("rotated",), (), of_shown(lambda m, s: warped(m.shown, degrees=_between(0.1, 3)(s))), _PNG
    ),
    "rolling shutter": Kind(("another view or frame", "sheared"), ("shifted",), of_light(_sheared)),
    "lens distortion": Kind(("scaled", "another view or frame"), ("shifted",), of_light(_barrel)),
    "noise": Kind(("noise",), (), of_light(lambda m, s: m.noisy(_between(0.003, 0.06)(s)))),
    "dithered": Kind(("noise", "too small to name"), (), of_shown(_dithered), _PNG),
    "inverted, PNG": Kind(
        ("another tone curve", "sign reversed", "another contrast", "inverted"),
        (),
        of_shown(lambda m, s: 1 - m.shown),
        _PNG,
    ),
    "linear gradient": Kind(
        ("vignette",),
        _REGION,
        of_light(
            lambda m, s: m.light * (1 - _between(0.02, 0.5)(s) * (m.yx[1][..., None] + 1) / 2)
        ),
    ),
    "vignette": Kind(
        ("vignette",),
        (),
        of_light(
            lambda m, s: (
                m.light * (1 - _between(0.02, 0.5)(s) * np.square(m.yx).sum(axis=0)[..., None])
            )
        ),
    ),
    "saturation": Kind(
        ("another saturation",),
        (),
        of_light(
            lambda m, s: (lambda y: y + (1 - _between(0.03, 0.7)(s)) * (m.light - y))(
                (m.light @ np.float32([0.2126, 0.7152, 0.0722]))[..., None]
            )
        ),
    ),
    "larger disc": Kind(
        _COC,
        ("lower resolution",),
        of_light(lambda m, s: through_disc(m.light, _between(0.7, 6)(s))),
    ),
    "half resolution": Kind(
        ("lower resolution",), _COC, of_light(lambda m, s: doubled(halved(m.light)))
    ),
    "clipped": Kind(
        ("clipped",),
        (),
        of_light(lambda m, s: np.minimum(m.light, np.quantile(m.light, 0.999 - 0.3 * s))),
    ),
    "ghost": Kind(
        ("another view or frame", "doubled", "motion blur"),
        ("spread otherwise",),
        of_light(
            lambda m, s: (
                (1 - _between(0.03, 0.5)(s)) * m.light
                + _between(0.03, 0.5)(s) * np.roll(m.light, 9, 1)
            )
        ),
    ),
    "hot pixels": Kind(
        ("fireflies",),
        (),
        of_light(
            lambda m, s: m.light + _between(0.2, 20)(s) * (m.rng.random((*m.depth.shape, 1)) < 2e-4)
        ),
    ),
    "red moved": Kind(
        ("shifted", "chromatic aberration"),
        (),
        of_light(
            lambda m, s: np.concatenate(
                [warped(m.light[..., :1], dx=_between(0.1, 2)(s)), m.light[..., 1:]], 2
            )
        ),
    ),
}


def _decoded(planes, dtype, name):
    height, width = next(iter(planes.values())).shape
    stored = planes if dtype == _PNG else {n: p.astype(dtype) for n, p in planes.items()}
    kind = {"float16": "half", "float32": "float"}.get(dtype, dtype)
    types, gamma = dict.fromkeys(stored, kind), None if dtype == _PNG else 1.0
    return DecodedPicture(Path(name), width, height, stored, types, gamma=gamma)


def pair(kind, scene, strength, seed):
    """The record of a planted fault by the rules of a render."""
    row = KINDS[kind]
    sides = row.make(shot(scene, seed), strength)
    a, b = (_decoded(p, row.dtype, f"{n}.exr") for p, n in zip(sides, "ab", strict=True))
    return compare_pictures(kind, a, b, PRESETS["render"], CompareSettings())[0]


def judged(kind, record):
    """``right``, ``plausible``, ``wrong``, ``none`` or ``silent``, and what is said."""
    row = KINDS[kind]
    said = [finding.name for finding in record.findings]
    if not record.differing:
        return "right", said  # nothing changed
    if record.status == "same" and not said:
        return "silent", said
    if any(name.startswith(row.right) for name in said):
        return "right", said
    if not said or said == ["too small to name"]:
        return ("right" if row.right == _REGION else "none"), said
    if all(is_place(n) or n.startswith((*row.plausible, *NO_CAUSE)) for n in said):
        return "plausible", said
    return "wrong", said

"""Faults planted into pictures, from barely visible to strong, and the names that are right.

`KINDS` is the table: what is right to say, what is plausible, and what makes B of a picture by a
strength of 0 to 1. Pictures are rendered ones of scenes with known depth, held in memory.
"""

import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import torch
from elements import write
from image_files import from_srgb, save, to_srgb

from defocus_core import compare_images, render
from defocus_core.io.images.primaries import NAMED, REC_709, between_primaries

Pixels = np.ndarray[Any, Any]
HEIGHT, WIDTH = 90, 128
_SAMPLES = Path(__file__).parents[2] / "sample_scenes"
_TRUTH = Path(__file__).parents[3] / "shared" / "truth"
SCENES = {
    **{name: _SAMPLES / name for name in ("spheres", "lights", "leaves", "floor", "layered")},
    **{f"traced {name}": _TRUTH / name for name in ("room", "cards", "night", "spheres", "fence")},
}
_SIZE = (240, 320)
_LUMA = np.float32([0.2126, 0.7152, 0.0722])
# Says that a difference is slight: no cause is claimed.
NO_CAUSE = ("too small to name",)


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


def planes(image, dtype=np.float16):
    """The channels R, G and B of an image."""
    return {name: image[..., index].astype(dtype) for index, name in enumerate("RGB")}


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


def warped(image, scale=1.0, dx=0.0):
    """Enlarged around the middle, bicubic by Catmull-Rom."""
    height, width = image.shape[:2]
    middle = np.float64([[[height - 1]], [[width - 1]]]) / 2
    row, column = (np.mgrid[0:height, 0:width] - middle) / scale + middle - [[[0]], [[dx]]]
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


def through_disc(image, radius=2.0):
    reach = int(np.ceil(radius))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    kernel = np.clip(radius + 0.5 - np.hypot(y, x), 0, 1)
    padded = np.pad(image, [(reach, reach), (reach, reach), (0, 0)], mode="edge")
    height, width = image.shape[:2]
    weights = np.ndenumerate(kernel / kernel.sum())
    total = sum(w * padded[y : y + height, x : x + width] for (y, x), w in weights if w)
    return np.asarray(total, np.float32)


def halved(image):
    """Means of 2 x 2 pixels."""
    height, width = (side // 2 * 2 for side in image.shape[:2])
    return image[:height, :width].reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))


def resized(image, size, how):
    """By OpenImageIO."""
    buffer = oiio.ImageBuf(oiio.ImageSpec(image.shape[1], image.shape[0], 3, oiio.FLOAT))
    buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(image, np.float32))
    roi = oiio.ROI(0, size[1], 0, size[0], 0, 1, 0, 3)
    return oiio.ImageBufAlgo.resize(buffer, filtername=how, roi=roi).get_pixels(oiio.FLOAT)


def pulled(image, radii=(1.0, 2.0, 3.0)):
    """Blurred more and more down the frame."""
    pictures = np.stack([image, *(through_disc(image, radius) for radius in radii)])
    at = np.linspace(0, len(radii) - 1e-3, len(image))
    rows, low, share = np.arange(len(image)), at.astype(int), np.float32(at % 1)[:, None, None]
    return (1 - share) * pictures[low, rows] + share * pictures[low + 1, rows]


def of_channel(image, index, changed):
    image = image.copy()
    image[..., index] = changed[..., index]
    return image


@dataclass(frozen=True)
class Shot:
    """A picture [H, W, 3] of light, and what it was rendered of."""

    light: Pixels  # the picture
    depth: Pixels  # planar depth [H, W] in m
    sharp: Pixels  # the picture before it was blurred, with some lights more
    focal: float  # focal length in px
    rng: np.random.Generator  # for places and noise

    @property
    def shown(self):
        """Values of 8 bits, as 0…1."""
        return _rounded(to_srgb(self.light.clip(0, 1)))

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

    def rendered(self, scale=1.0, shift=0.0, **how):
        """The picture by radii · scale + shift px."""
        near = 1 / self.depth
        radius = np.median(near) - near
        radius = 5.5 * radius / np.abs(radius).max() * scale + shift
        picture = torch.from_numpy(np.ascontiguousarray(self.sharp.transpose(2, 0, 1)))
        radii = torch.from_numpy(radius.astype(np.float32))
        views = render(picture, radii, depth_repair="off", **how)
        return np.ascontiguousarray(views.render.numpy().transpose(1, 2, 0))


@cache
def _scene(name):
    folder = SCENES[name]
    file = sorted(folder.glob("truth_*.exr"), key=lambda f: ("_left" in f.name, "_right" in f.name))
    light, depth, sharp = (
        oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT)
        for path in (file[0], folder / "depth.exr", folder / "rgb.exr")
    )
    step = max(1, light.shape[0] // 270)
    height, width = (n // step * step for n in light.shape[:2])
    top, left = (n // step // 2 - side // 2 for n, side in zip((height, width), _SIZE, strict=True))
    cut = (slice(top, top + _SIZE[0]), slice(left, left + _SIZE[1]))
    light, sharp = (
        v[:height, :width, :3].reshape(height // step, step, width // step, step, 3)
        for v in (light, np.minimum(sharp, 8.0))
    )
    depth = depth[:height:step, :width:step, 0]
    depth = np.minimum(depth, depth[np.isfinite(depth)].max())[cut]
    light, sharp = (v.mean(axis=(1, 3))[cut].astype(np.float32) for v in (light, sharp))
    rng = np.random.default_rng(len(name))
    for _ in range(8):
        y, x = (rng.integers(4, side - 4) for side in _SIZE)
        sharp[y : y + 2, x : x + 2] = rng.uniform(2, 8.5) * np.float32([1, 0.9, 0.7])
    return light.astype(np.float16).astype(np.float32), depth.astype(np.float32), sharp


def shot(name, seed):
    light, depth, sharp = _scene(name)
    return Shot(light, depth, sharp, 1.4 * light.shape[1], np.random.default_rng(seed))


def _rounded(values, levels=255):
    return (np.rint(values.clip(0, 1) * levels) / levels).astype(np.float32)


def _between(low, high):
    """Of a strength, geometrically."""
    return lambda s: float(low * (high / low) ** s)


# What makes A and B, as channels, of a shot by a strength.
Made = tuple[dict[str, Pixels], dict[str, Pixels]]
Make = Callable[[Shot, float], Made]


def _rgb(image):
    return planes(image, np.float32)


def of_light(change):
    """A of light, and B by a change of it."""
    return lambda m, s: (_rgb(m.light), _rgb(np.asarray(change(m, s))))


def of_shown(change):
    """8 bits as a screen shows them, and a change of them, rounded again."""
    return lambda m, s: (_rgb(m.shown), _rgb(_rounded(np.asarray(change(m, s)))))


def of_depth(change):
    return lambda m, s: ({"Z": m.depth}, {"Z": np.asarray(change(m, s), np.float32)})


def of_render(how):
    """The scene rendered, and rendered with other options."""
    return lambda m, s: (_rgb(m.rendered()), _rgb(m.rendered(**how(s))))


def shown_as(make, noise=0.0):
    """A pair of light in 8 bits, with noise of B of so many steps."""

    def made(m, s):
        a, b = ({n: to_srgb(np.clip(v, 0, 1)) for n, v in side.items()} for side in make(m, s))
        steps = noise / 255 * m.rng.uniform(-1, 1, (len(b), *m.depth.shape))
        noisy = {n: v + step for (n, v), step in zip(b.items(), steps, strict=True)}
        return tuple({n: _rounded(v) for n, v in side.items()} for side in (a, noisy))

    return made


def within(change):
    """Only in a rectangle, of a quarter of the sides and more."""

    def made(m, s):
        b, (height, width) = m.light.copy(), m.depth.shape
        y, x = m.rng.integers(0, height // 2), m.rng.integers(0, width // 2)
        cut = (slice(y, y + height // 3), slice(x, x + width // 3))
        b[cut] = change(m, s)[cut]
        return b

    return made


def tones(curve):
    """A curve of the sRGB-encoded values below 1; light beyond keeps its distance to white."""

    def change(m, s):
        shown = curve(to_srgb(m.light.clip(0, 1)), s)
        return from_srgb(shown.clip(0, 1)) + np.maximum(m.light - 1, 0)

    return change


_COLORS = ((1, 1, 1), (0, 0, 0), (1, 0.8, 0.1), (0.1, 0.2, 0.8))


def _written(m, s):
    """With signs of 5 x 7 squares of one to three px, edges anti-aliased."""
    color, scale = _COLORS[int(m.rng.integers(0, 4))], int(m.rng.integers(1, 4))
    height, width = m.depth.shape
    y, x = m.rng.integers(0, height // 2), m.rng.integers(0, width // 4)
    cover = np.zeros((height, width, 1), np.float32)
    for k in range(3 + int(3 * s)):
        bits = m.rng.random((7, 5, 1)) < 0.5
        part = cover[y : y + 7 * scale, x + k * 6 * scale :][:, : 5 * scale]
        part += np.kron(bits, np.ones((scale, scale, 1)))[: part.shape[0], : part.shape[1]]
    cover = (0.6 + 0.4 * s) * blurred(cover, 0.4).clip(0, 1)
    return m.light * (1 - cover) + cover * np.float32(color)


def _radial(m, s):
    y, x = m.yx
    height, width = m.depth.shape
    focal = m.focal / _between(0.4, 3.0)(s)  # a wider angle is stronger
    return m.depth * np.sqrt(1 + (x * x * width**2 + y * y * height**2) / (4 * focal * focal))


def _shuffled(m, s):
    """Whole numbers of 12 slabs of depth, in blocks across; some exchanged."""
    slabs = np.digitize(m.depth, np.quantile(m.depth, np.linspace(0, 1, 7)[1:-1]))
    ids = (slabs * 2 + (m.yx[1] > 0)).astype(np.float32)
    known = np.unique(ids)
    order, some = np.arange(len(known)), m.rng.permutation(len(known))[: max(2, round(s * 12))]
    order[some] = np.roll(order[some], 1)
    return {"id": ids}, {"id": known[order][np.searchsorted(known, ids)].astype(np.float32)}


def _smaller(m, s):
    """Reduced and enlarged again by one filter of four."""
    how = ("triangle", "lanczos3", "keys", "blackman-harris")[int(m.rng.integers(0, 4))]
    size = [round(n * (1 - _between(0.04, 0.75)(s))) for n in m.depth.shape]
    return resized(resized(m.light, size, how), m.depth.shape, how)


def _jpeg(image, quality, subsampling="4:2:0"):
    from PIL import Image

    file = io.BytesIO()
    picture = Image.fromarray(np.rint(image * 255).astype(np.uint8))
    picture.save(file, "JPEG", quality=quality, subsampling=subsampling)
    return np.asarray(Image.open(file), np.float32) / 255


def _bilateral(image, strength=0.08):
    """Smeared as by a denoiser: means of neighbours that are alike."""
    shown = to_srgb(image.clip(0, 1)).mean(axis=2)
    total, weights = np.zeros_like(image), np.zeros((*shown.shape, 1), np.float32)
    for dy, dx in np.ndindex(5, 5):
        moved, beside = (np.roll(v, (dy - 2, dx - 2), (0, 1)) for v in (image, shown))
        weight = np.exp(-np.square((beside - shown) / strength))[..., None]
        total, weights = total + weight * moved, weights + weight
    return (total / weights).astype(np.float32)


def _denoised(m, s):
    noisy = m.noisy(_between(0.008, 0.06)(s)).astype(np.float32)
    clean = (m.light, _bilateral(noisy), blurred(noisy, 1.0))[int(m.rng.integers(0, 2))]
    return _rgb(noisy), _rgb(clean)


def _right_half_moved(m, s):
    half = m.light.shape[1] // 2
    b = m.light.copy()
    b[:, half:] = warped(m.light, dx=_between(0.1, 3)(s))[:, half:]
    return b


def _light_missing(m, s):
    (y, x), (cy, cx) = m.yx, m.rng.uniform(-0.7, 0.7, 2)
    lit = np.exp(-((y - cy) ** 2 + (x - cx) ** 2) / 0.15)[..., None]
    return m.light * (1 - _between(0.05, 0.9)(s) * lit)


def of_alpha(change):
    """A picture that is transparent beyond a soft disc; what is done to its light and alpha."""

    def made(m, s):
        y, x = m.yx
        alpha = (6 * (0.7 - np.hypot(x, y * 0.8))).clip(0, 1).astype(np.float32)
        light = m.light * alpha[..., None]
        image, other = change(light, alpha, s)
        return {**_rgb(light), "A": alpha}, {**_rgb(image), "A": np.asarray(other, np.float32)}

    return made


def _object_moved(m, s):
    step = 1 + int(_between(1, 9)(s))
    mask = np.roll(m.near, step, 1)[..., None]
    return np.where(mask > 0, np.roll(m.light, step, 1), m.light)


def _tile_gains(m, s):
    gains = 1 + _between(0.006, 0.03)(s) * m.rng.uniform(-1, 1, (20, 20))
    rows, columns = (np.arange(n) // 32 for n in m.depth.shape)
    return m.light * np.float32(gains[rows][:, columns])[..., None]


def _seams(m, s):
    """Lines, or bands, between tiles of another gain."""
    b = m.light.copy()
    period, wide, gain = ((32, 1, -1), (64, 4, 1))[int(m.rng.integers(0, 2))]
    for axis, length in enumerate(m.depth.shape):
        near = (np.arange(length) + wide // 2) % period < wide
        near[: period // 2] = False
        b[(near,) if axis == 0 else (slice(None), near)] *= 1 + gain * _between(0.02, 0.1)(s)
    return b


def _moved_by_sinc(m, s):
    """Moved by parts of a pixel by the phases of its frequencies."""
    phases = np.exp(-2j * np.pi * np.fft.fftfreq(m.light.shape[1]) * _between(0.2, 0.8)(s))
    moved = np.fft.ifft(np.fft.fft(m.light, axis=1) * phases[:, None], axis=1)
    return np.asarray(moved.real, np.float32)


def _dark_border(m, s):
    inner = np.abs(m.yx).max(axis=0) < 0.98 - 0.03 * s
    return m.shown * np.where(inner, 1.0, 0.5)[..., None]


def _bits(s):
    return 2 ** (7 - int(3.99 * s)) - 1


@dataclass(frozen=True)
class Kind:
    """A kind of fault: names that are right, what makes it, and names that mislead nobody."""

    right: tuple[str, ...]
    make: Make
    plausible: tuple[str, ...] = ()
    dtype: str = "float16"


_REGION = ("in one region", "in highlights", "at edges", "at silhouettes", "at the border")
_PNG = "uint8"
_COC = ("another CoC", "softer")
_SOFT = (*_COC, "sharper")
_NOISE = ("noise",)
_TONES = ("another tone curve", "another gamma", "offset or contrast")


def _light(right, change, plausible=()):
    return Kind(right, of_light(change), plausible)


def _shown(right, change, plausible=()):
    return Kind(right, of_shown(change), plausible, _PNG)


def _depth(right, change, plausible):
    return Kind(right, of_depth(change), plausible, "float32")


KINDS: dict[str, Kind] = {
    # Of depth and of numbers.
    "depth normalised": _depth(
        ("normalised",),
        lambda m, s: (
            (m.depth - (1 - s) * m.depth.min())
            / (m.depth.max() * (1 + 2 * s) - (1 - s) * m.depth.min())
        ),
        ("multiplied", "offset"),
    ),
    "inverse depth": _depth(
        ("normalised",),
        lambda m, s: (1 / m.depth - 1 / m.depth.max() * (1 - s)) / (1 / m.depth.min()),
        _TONES,
    ),
    "radial depth": _depth(("radial depth",), _radial, ()),
    "ids shuffled": Kind(("ids exchanged",), _shuffled, _REGION),
    # Of renders by other options.
    "f-number": Kind(_SOFT, of_render(lambda s: {"scale": 1 / (1 + _between(0.02, 0.5)(s))})),
    "focus moved": Kind(_SOFT, of_render(lambda s: {"shift": _between(0.3, 2)(s)})),
    # Of places.
    "text": _light(_REGION, _written),
    "blurred tile": _light(
        ("in one region", "softer"),
        within(lambda m, s: blurred(m.light, _between(0.5, 3)(s))),
        _REGION,
    ),
    "brighter tile": _light(
        ("in one region",), within(lambda m, s: m.light * (1 + _between(0.01, 0.5)(s))), _REGION
    ),
    "grey object": _light(
        _REGION,
        lambda m, s: (
            m.light
            + _between(0.1, 1.0)(s) * m.near[..., None] * ((m.light @ _LUMA)[..., None] - m.light)
        ),
    ),
    "object moved": _light(_REGION, _object_moved),
    "right half moved": _light(("in one region",), _right_half_moved, _REGION),
    "light missing": _light(_REGION, _light_missing),
    "seams": _light(("seams",), _seams),
    "gain of tiles": _light(("seams",), _tile_gains),
    "hot pixels": _light(
        ("fireflies",),
        lambda m, s: m.light + _between(0.2, 20)(s) * (m.rng.random((*m.depth.shape, 1)) < 2e-4),
    ),
    # Of alpha and passes.
    "divided by alpha": Kind(
        ("premultiplication",),
        of_alpha(lambda a, w, s: (np.where(w[..., None] > 0, a / w.clip(1e-6)[..., None], 0), w)),
    ),
    "multiplied by alpha": Kind(
        ("premultiplication",), of_alpha(lambda a, w, s: (a * w[..., None], w))
    ),
    # Of values in place.
    "exposure": _light(("another exposure",), lambda m, s: m.light * (1 + _between(0.002, 0.5)(s))),
    "noisy and brighter": Kind(
        ("another exposure",),
        lambda m, s: (_rgb(m.noisy()), _rgb(m.noisy() * (1 + _between(0.03, 0.3)(s)))),
        _NOISE,
    ),
    "white balance": _light(
        ("another exposure",),
        lambda m, s: m.light * (1 + _between(0.01, 0.3)(s) * np.float32([1, 0, -1])),
    ),
    "tone curve": _light(
        _TONES, tones(lambda v, s: v + _between(0.1, 0.8)(s) * v * (1 - v) * (v - 0.5))
    ),
    "veiled": _light(
        ("offset or contrast",), lambda m, s: m.light + _between(0.005, 0.06)(s) * (1 - m.light)
    ),
    "saturation": _light(
        ("primaries or saturation",),
        lambda m, s: (
            m.light
            + _between(0.03, 0.7)(s)
            * float(m.rng.choice([-1, 1]))
            * (m.light - (m.light @ _LUMA)[..., None])
        ),
    ),
    "primaries": _light(
        ("primaries or saturation",),
        lambda m, s: converted(("Rec. 2020", "Display P3", "ACES AP1")[int(2.99 * s)], m.light),
    ),
    "clipped": _light(
        ("clipped",), lambda m, s: np.minimum(m.light, np.quantile(m.light, 0.999 - 0.3 * s))
    ),
    "cut from below": _light(("clipped",), lambda m, s: np.maximum(m.light, 0.005 + 0.03 * s)),
    "6 bits": _light(
        ("quantised to",), lambda m, s: from_srgb(_rounded(to_srgb(m.light.clip(0, 1)), _bits(s)))
    ),
    "6 bits in 8": _shown(("quantised to",), lambda m, s: _rounded(m.shown, _bits(s))),
    "lift, PNG": _shown(
        ("offset or contrast",), lambda m, s: m.shown + _between(1.5, 24)(s) / 255, _TONES
    ),
    "gamma, PNG": _shown(
        ("another gamma",), lambda m, s: m.shown ** (1 + _between(0.02, 0.6)(s)), _TONES
    ),
    "inverted, PNG": _shown(("inverted",), lambda m, s: 1 - m.shown),
    # Of sharpness and of noise.
    "gaussian blur": _light(
        _COC, lambda m, s: blurred(m.light, _between(0.35, 4)(s)), ("lower resolution",)
    ),
    "focus pulled": _light(_COC, lambda m, s: pulled(m.light, np.arange(0.5, 2 + 3 * s, 0.5))),
    "resized and back": _light(("lower resolution",), _smaller, _COC),
    "sharpened, PNG": _shown(
        ("sharper",),
        lambda m, s: m.shown + _between(0.15, 2)(s) * (m.shown - blurred(m.shown, 1.2)),
        ("another CoC",),
    ),
    "noise removed": Kind(("softer",), _denoised, ("noise",)),
    "smeared": _light(("softer",), lambda m, s: _bilateral(m.light, _between(0.04, 0.2)(s))),
    "noise": _light(("noise",), lambda m, s: m.noisy(_between(0.003, 0.06)(s))),
    "dithered": _shown(
        ("noise", "too small to name"),
        lambda m, s: m.shown + _between(1, 8)(s) / 255 * (m.rng.random(m.shown.shape) - 0.5),
    ),
    "JPEG": _shown(
        ("compressed with losses",),
        lambda m, s: _jpeg(m.shown, round(97 - 50 * s)),
        ("too small to name",),
    ),
    # What photographs were misnamed for.
    "grain, PNG": _shown(
        ("noise",),
        lambda m, s: (
            m.shown + _between(3, 12)(s) / 255 * m.rng.standard_normal((*m.depth.shape, 1))
        ),
    ),
    "dark border, PNG": _shown(("at the border",), _dark_border, _REGION),
    "moved by sinc": _light(("shifted",), _moved_by_sinc),
    # Of geometry.
    "shift": _light(("shifted",), lambda m, s: warped(m.light, dx=_between(0.05, 2.5)(s))),
    "overscan cropped": _light(
        ("scaled", "shifted"), lambda m, s: warped(m.light, scale=_between(1.002, 1.08)(s))
    ),
}
# What is also done to pictures of 8 bits, and to those with noise of two steps.
_IN_8_BITS = ("text", "resized and back", "tone curve", "saturation", "seams", "hot pixels")
_NOISY = ("primaries", "focus pulled", "gaussian blur", "white balance", "overscan cropped")
for _names, _noise, _also in ((_IN_8_BITS, 0.0, ()), (_NOISY, 2.5, _NOISE)):
    for _name in _names:
        _kind = KINDS[_name]
        _make = shown_as(_kind.make, _noise)
        KINDS[f"{_name}, PNG"] = Kind(_kind.right, _make, (*_kind.plausible, *_also), _PNG)


def _flipped(m, s):
    """Last bits of half floats."""
    half = m.light.astype(np.float16)
    return (half.view(np.int16) + (m.rng.random(half.shape) < 0.1)).view(np.float16)


# What does not matter.
BENIGN: dict[str, Kind] = {
    "last bits": Kind(
        (),
        of_light(lambda m, s: m.light * (1 + m.rng.uniform(-2e-6, 2e-6, m.light.shape))),
        dtype="float32",
    ),
    "last bits, absolute": Kind(
        (),
        of_light(lambda m, s: m.light + m.rng.uniform(-2e-5, 2e-5, m.light.shape)),
        dtype="float32",
    ),
    "rounded to half": Kind(
        (),
        lambda m, s: (_rgb(m.rendered()), _rgb(m.rendered().astype(np.float16))),
        dtype="float32",
    ),
    "last bit of half": _light((), _flipped),
    "threads": Kind((), of_render(lambda s: {"threads": 2}), dtype="float32"),
    "tiles": Kind((), of_render(lambda s: {"tile": 64}), dtype="float32"),
    "minus zero": _light((), lambda m, s: np.where(m.light == 0, np.float32(-0.0), m.light)),
    "last step": _shown(
        (), lambda m, s: m.shown + (m.rng.random(m.shown.shape) < 0.02) / np.float32(255)
    ),
}


def pair(row, scene, strength, seed):
    """The record of a planted fault by the rules of a render."""
    with TemporaryDirectory() as folder:
        files = []
        for side, name in zip(row.make(shot(scene, seed), strength), "ab", strict=True):
            path, planes = Path(folder, name), side.items()
            if row.dtype == _PNG:
                samples = np.stack([np.rint(255 * plane) for _, plane in planes], 2)
                files.append(save(path.with_suffix(".png"), samples.astype(np.uint8)))
            else:
                stored = {n: plane.astype(row.dtype) for n, plane in planes}
                files.append(write(path.with_suffix(".exr"), stored))
        return compare_images(*files, like="render")


def judged(row, record):
    """``right``, ``plausible``, ``wrong``, ``none`` or ``silent``, and what is said."""
    said = [finding.name for finding in record.findings]
    if not record.differing:
        return "right", said  # nothing changed
    if record.status == "same" and not said:
        return "silent", said
    if any(name.startswith(row.right) for name in said):
        return "right", said
    if not said or said == ["too small to name"]:
        return ("right" if row.right == _REGION else "none"), said
    if all(n.startswith((*_REGION, *row.plausible, *NO_CAUSE)) for n in said):
        return "plausible", said
    return "wrong", said

"""Pairs of renders: faults of many kinds with the names that are right, and pairs that are benign.

Each is made from a sample scene that is rendered small. The seed chooses amounts, sides and places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it
import torch
from image_files import save
from planted_faults import (
    blurred,
    converted,
    doubled,
    halved,
    planes,
    pulled,
    summed,
    through_disc,
    warped,
    write_planes,
)

from defocus_core import Aperture, render
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear

Pixels = np.ndarray[Any, Any]
FOLDER = Path(__file__).parents[2] / "sample_scenes"
_GREATEST = 11.0  # px of the largest radius in a picture of 480 px


@dataclass(frozen=True)
class Source:
    """A scene: its sharp picture [H, W, 3], signed radius [H, W] px and disparity 0…1 [H, W]."""

    image: Pixels
    radius: Pixels
    near: Pixels

    def rendered(self, scale=1.0, shift=0.0, move=0.0, **how):
        """The picture by radii × scale + shift, its near parts moved by ``move`` px."""
        image, radius = self.image, self.radius
        if move:
            rows, columns = np.indices(radius.shape)
            x = (columns + np.rint(move * (self.near - 0.3)).astype(int)).clip(
                0, len(radius[0]) - 1
            )
            image, radius = image[rows, x], radius[rows, x]
        return _render(image, radius * scale + shift, **how)

    def half(self, nearest):
        """The picture rendered at half of the size, and enlarged again."""
        height, width = (side // 2 * 2 for side in self.radius.shape)
        small = _render(halved(self.image), self.radius[:height:2, :width:2] / 2)
        large = np.kron(small, np.ones((2, 2, 1), np.float32)) if nearest else doubled(small)
        pad = [(0, full - len_) for full, len_ in zip(self.radius.shape, large.shape, strict=False)]
        return np.pad(large, [*pad, (0, 0)], mode="edge")


def _render(image, radius, view="render", **how):
    picture = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))
    views = render(
        picture,
        torch.from_numpy(radius.astype(np.float32)),
        left_right=view != "render",
        quality="draft" if min(radius.shape) > 200 else "standard",
        depth_repair="off",
        **how,
    )
    return np.ascontiguousarray(getattr(views, view).numpy().transpose(1, 2, 0))


@cache
def source(name, step=2):
    """A sample scene, each side divided by ``step``, with lights of 8 and a half."""
    image, depth = (
        oiio.ImageBuf(str(FOLDER / name / file)).get_pixels(oiio.FLOAT)
        for file in ("rgb.exr", "depth.exr")
    )
    depth = depth[::step, ::step, 0]
    height, width = depth.shape
    image = np.minimum(image[: height * step, : width * step], 8.0)
    blocks = image.reshape(height, step, width, step, 3).mean(axis=(1, 3)).astype(np.float32)
    rng = np.random.default_rng(len(name))
    for _ in range(8):
        y, x = rng.integers(4, height - 4), rng.integers(4, width - 4)
        blocks[y : y + 2, x : x + 2] = rng.uniform(2, 8.5) * np.float32([1, 0.9, 0.7])
    near = 1.0 / depth
    focus = np.median(near)
    radius = focus - near
    radius *= _GREATEST / step / np.abs(radius).max()
    span = near.max() - near.min()
    return Source(blocks, radius.astype(np.float32), (near - near.min()) / span)


@dataclass
class Maker:
    """What changes a picture ``a`` [H, W, 3] of light may look at."""

    source: Source
    a: Pixels
    rng: np.random.Generator

    @property
    def size(self):
        return self.a.shape[0], self.a.shape[1]


Change = Callable[[Maker], Pixels]


def _tones(curve):
    """A curve of the sRGB-encoded values below 1; light beyond keeps its distance to white."""

    def change(m):
        shown = curve(linear_to_srgb(m.a.clip(0, 1)))
        return (srgb_to_linear(shown.clip(0, 1)) + np.maximum(m.a - 1, 0)).astype(np.float32)

    return change


def _vignette(m):
    height, width = m.size
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    return m.a * np.float32(1 - 0.12 * (x * x + y * y))[..., None]


def _saturated(amount):
    def change(m):
        luma = m.a @ np.float32([0.2126, 0.7152, 0.0722])
        return np.maximum(luma[..., None] + np.float32(amount) * (m.a - luma[..., None]), 0)

    return change


def _tile_gains(side):
    def change(m):
        gains = m.rng.uniform(0.985, 1.015, (20, 20))
        rows, columns = (np.arange(n) // side for n in m.size)
        return m.a * np.float32(gains[rows][:, columns])[..., None]

    return change


def _seams(period, wide, gain):
    def change(m):
        b = m.a.copy()
        for axis, length in enumerate(m.size):
            near = (np.arange(length) + wide // 2) % period < wide
            near[: period // 2] = False
            index = (near,) if axis == 0 else (slice(None), near)
            b[index] *= np.float32(gain)
        return b

    return change


def _tiles_exchanged(m):
    b, side = m.a.copy(), 32
    b[side : 2 * side, :side], b[:side, 2 * side : 3 * side] = (
        m.a[:side, 2 * side : 3 * side],
        m.a[side : 2 * side, :side],
    )
    return b


def _fields_exchanged(m):
    rows = np.arange(len(m.a)) ^ 1
    return m.a[rows.clip(0, len(m.a) - 1)]


def _halo(reach, gain):
    """Light of another strength on the far side of silhouettes."""

    def change(m):
        near = m.source.near > 0.5 * (m.source.near.max() + np.median(m.source.near))
        wide = summed(near[..., None].astype(np.float32), np.ones((2 * reach + 1,) * 2))[..., 0] > 0
        return m.a * np.where(wide & ~near, np.float32(gain), np.float32(1))[..., None]

    return change


def _fireflies(m):
    b = m.a.copy()
    for _ in range(7):
        b[m.rng.integers(0, len(b)), m.rng.integers(0, b.shape[1])] += m.rng.uniform(3, 30)
    return b


def _motion(reach, slanted=False):
    kernel = np.eye(2 * reach + 1) if slanted else np.zeros((2 * reach + 1,) * 2)
    kernel[reach] += not slanted
    return lambda m: summed(m.a, kernel)


def _s_curve(v):
    return v + np.float32(0.5) * v * (1 - v) * (v - np.float32(0.5))


def _resized(factor, how):
    """Means of squares of pixels, enlarged again by OpenImageIO."""

    def change(m):
        height, width = (n // factor * factor for n in m.size)
        cut = m.a[:height, :width]
        small = cut.reshape(height // factor, factor, width // factor, factor, 3).mean((1, 3))
        if how == "nearest":
            large = np.kron(small, np.ones((factor, factor, 1)))
        else:
            spec = oiio.ImageSpec(small.shape[1], small.shape[0], 3, oiio.FLOAT)
            buffer = oiio.ImageBuf(spec)
            buffer.set_pixels(oiio.ROI(), np.ascontiguousarray(small, np.float32))
            roi = oiio.ROI(0, width, 0, height, 0, 1, 0, 3)
            large = oiio.ImageBufAlgo.resize(buffer, filtername=how, roi=roi).get_pixels(oiio.FLOAT)
        return _padded(large, m.size)

    return change


def _padded(image, size):
    pad = [(0, n - k) for n, k in zip(size, image.shape, strict=False)]
    return np.pad(image, [*pad, (0, 0)], mode="edge").astype(np.float32)


def _noisy(image, rng, amount):
    """With noise of photons."""
    noise = rng.standard_normal(image.shape)
    return (image + amount * np.sqrt(np.maximum(image, 0.01)) * noise).astype(np.float32)


def _bilateral(image):
    """Smeared as by a denoiser: means of neighbours that are alike."""
    shown = linear_to_srgb(image.clip(0, 1)).mean(axis=2)
    total, weights = np.zeros_like(image), np.zeros((*shown.shape, 1), np.float32)
    for dy, dx in np.ndindex(7, 7):
        moved, beside = (np.roll(v, (dy - 3, dx - 3), (0, 1)) for v in (image, shown))
        weight = np.exp(-np.square((beside - shown) / 0.08))[..., None]
        total, weights = total + weight * moved, weights + weight
    return (total / weights).astype(np.float32)


def _of_channel(k, change):
    """What is done to one channel alone."""

    def changed(m):
        b = m.a.copy()
        b[..., k] = change(m)[..., k]
        return b

    return changed


def _ghost(m):
    return np.float32(0.6) * m.a + np.float32(0.4) * np.roll(m.a, 6, axis=1)


def _covered(m):
    """A block of the picture replaced by another part of it."""
    b, (height, width) = m.a.copy(), m.size
    b[height // 2 : height // 2 + 60, 20:110] = m.a[10:70, width // 2 : width // 2 + 90]
    return b


def _dropped(m):
    b = m.a.copy()
    b[m.rng.integers(0, len(b), 9), m.rng.integers(0, b.shape[1], 9)] = 0
    return b


# Kind, right names, change of light; kinds of which `planted_faults` has the like are not here.
# Kinds with a name that holds another word are in brackets.
_COC, _LIGHT, _SOFT = ("another CoC",), ("another exposure",), ("another CoC", "softened")
_FRAME, _BOKEH = ("another view or frame",), ("another bokeh shape",)
CHANGES: dict[str, tuple[tuple[str, ...], Change]] = {
    "f-number + 2 %": (_COC, lambda m: m.source.rendered(1 / 1.02)),
    "f-number + 20 %": (_COC, lambda m: m.source.rendered(1 / 1.2)),
    "focus moved": (_COC, lambda m: m.source.rendered(shift=0.6)),
    "radii doubled": (_COC, lambda m: m.source.rendered(2.0)),
    "half resolution": (("lower resolution",), lambda m: m.source.half(nearest=False)),
    "half resolution, nearest": (("lower resolution",), lambda m: m.source.half(nearest=True)),
    "left": ((*_FRAME, "left and right swapped"), lambda m: m.source.rendered(view="left")),
    "another frame": (_FRAME, lambda m: m.source.rendered(move=6.0)),
    "frame of a slow move": (_FRAME, lambda m: m.source.rendered(move=-3.0)),
    "slanted motion blur": (("motion blur",), _motion(3, slanted=True)),
    "moved while open": (
        ("motion blur", *_FRAME),
        lambda m: sum(m.source.rendered(move=float(v)) for v in range(-4, 5)) / np.float32(9),
    ),
    "five blades": (_BOKEH, lambda m: m.source.rendered(aperture=Aperture(blades=5))),
    "six blades turned": (
        _BOKEH,
        lambda m: m.source.rendered(aperture=Aperture(blades=6, rotation=15.0)),
    ),
    "shifted by a part": (("shifted",), lambda m: warped(m.a, dx=0.4)),
    "shifted by 0.05 px": (("shifted",), lambda m: warped(m.a, dx=0.05)),
    "turned a little": (("rotated",), lambda m: warped(m.a, degrees=0.5)),
    "enlarged by 0.2 %": (("scaled",), lambda m: warped(m.a, scale=1.002)),
    "fields exchanged": (("fields exchanged",), _fields_exchanged),
    "tiles exchanged": (("tiles exchanged",), _tiles_exchanged),
    "green tint": (_LIGHT, lambda m: m.a * np.float32([1, 1.03, 1])),
    "a tenth of a stop": (_LIGHT, lambda m: m.a * np.float32(2**0.1)),
    "tone curve": (("another tone curve",), _tones(_s_curve)),
    "filmic": (("another tone curve",), lambda m: m.a / (1 + m.a * np.float32(0.3))),
    "contrast": (("another contrast",), _tones(lambda v: 0.5 + 1.08 * (v - 0.5))),
    "veiled": (("raised blacks",), lambda m: m.a * np.float32(0.97) + np.float32(0.03)),
    "lifted": (("raised blacks",), _tones(lambda v: v + 0.01)),
    "vignette": (("vignette",), _vignette),
    "less saturated": (("another saturation",), _saturated(0.9)),
    "more saturated": (("another saturation",), _saturated(1.15)),
    "ACES AP1": (("other primaries",), lambda m: converted("ACES AP1", m.a)),
    "hue turned": (
        ("other primaries",),
        lambda m: m.a @ np.float32([[0.9, -0.1, 0.2], [0.2, 0.9, -0.1], [-0.1, 0.2, 0.9]]),
    ),
    "6 bits": (("quantised to 6 bits",), lambda m: np.round(m.a * 63) / np.float32(63)),
    "lines between tiles": (("seams",), _seams(32, 1, 0.97)),
    "bands between tiles": (("seams",), _seams(64, 4, 1.03)),
    "gain of tiles": (("seams",), _tile_gains(32)),
    "bright halo": (("halo",), _halo(3, 1.3)),
    "dark halo": (("halo",), _halo(2, 0.8)),
    "fireflies": (("fireflies",), _fireflies),
    "weak noise": (("noise",), lambda m: m.a + 0.004 * m.rng.standard_normal(m.a.shape)),
    "noise of photons": (("noise",), lambda m: _noisy(m.a, m.rng, 0.02)),
    "disc of 5 px": (_SOFT, lambda m: through_disc(m.a, 5)),
    "gaussian of 1 px": (_SOFT, lambda m: blurred(m.a, 1)),
    "focus pulled": (_COC, lambda m: pulled(m.a, np.arange(0.5, 4.1, 0.5))),
    "half, lanczos": (("lower resolution",), _resized(2, "lanczos3")),
    "quarter, bilinear": (("lower resolution",), _resized(4, "triangle")),
    "blue enlarged": (("scaled",), _of_channel(2, lambda m: warped(m.a, scale=1.006))),
    "red blurred": (_SOFT, _of_channel(0, lambda m: through_disc(m.a, 2))),
    "red clipped": (("clipped at 0.5",), _of_channel(0, lambda m: np.minimum(m.a, 0.5))),
    "ghost": ((*_FRAME, "motion blur", "doubled"), _ghost),
    "a block of another place": (("in one region", "tiles exchanged"), _covered),
    "dropped pixels": (("dropped pixels",), _dropped),
    "cut at 0.02 from below": (("clipped at",), lambda m: np.maximum(m.a, 0.02)),
    "smeared": (("noise removed",), lambda m: _bilateral(m.a)),
}
# What makes both sides of a pair of light: one side has other noise.
PAIRS: dict[str, tuple[tuple[str, ...], Callable[[Maker], tuple[Pixels, Pixels]]]] = {
    "noise removed": (("noise",), lambda m: (_noisy(m.a, m.rng, 0.03), m.a)),
    "denoised": (("noise",), lambda m: _denoised(m, _bilateral)),
    "another seed": (("noise",), lambda m: (_noisy(m.a, m.rng, 0.02), _noisy(m.a, m.rng, 0.02))),
    "noisy and brighter": (
        _LIGHT,
        lambda m: (_noisy(m.a, m.rng, 0.02), _noisy(m.a * 1.07, m.rng, 0.02)),
    ),
}


def _denoised(m, how):
    noisy = _noisy(m.a, m.rng, 0.03)
    return noisy, how(noisy)


# What is also done to pictures of 8 bits, sRGB-encoded, and to those with noise of ±2/255.
OF_INTEGERS = (
    *("turned a little", "a tenth of a stop", "tone curve", "vignette", "less saturated"),
    *("half resolution", "f-number + 20 %", "lines between tiles", "another frame", "left"),
    *("five blades", "fields exchanged", "tiles exchanged", "bright halo", "green tint", "lifted"),
    *("ACES AP1", "weak noise", "smeared", "focus pulled", "gaussian of 1 px"),
)


def _exr(path, image, alpha=None, dtype=np.float16):
    made = planes(image, dtype)
    if alpha is not None:
        made["A"] = alpha.astype(dtype)
    return write_planes(path, made)


def _eight(image):
    return np.rint(linear_to_srgb(image.clip(0, 1)) * 255).astype(np.uint8)


def _jpeg(folder, image, quality):
    """Samples of 8 bits as a JPEG of that quality has them."""
    file = save(
        folder / "lossy.jpg",
        image,
        Compression=f"jpeg:{quality}",
        jpeg__subsampling="4:4:4" if quality > 80 else "4:2:0",
    )
    return oiio.ImageBuf(str(file)).get_pixels(oiio.UINT8)


@dataclass(frozen=True)
class Pair:
    """Two files; ``right`` names of what happened, none if nothing that matters did."""

    kind: str
    right: tuple[str, ...]
    a: Path
    b: Path


def _lossy(folder, m, a, png):
    """Pairs of lossy codecs, alone and after something else."""
    pairs = []
    jpeg = ("compressed with losses",)
    shown = _eight(m.a)
    for quality in (60, 90):
        b = save(folder / f"jpeg{quality}.png", _jpeg(folder, shown, quality))
        pairs.append(Pair(f"JPEG of {quality}", jpeg, png, b))
    for kind in ("a tenth of a stop", "less saturated"):
        right, change = CHANGES[kind]
        b = save(folder / f"jpeg {kind}.png", _jpeg(folder, _eight(change(m)), 90))
        pairs.append(Pair(f"{kind}, then JPEG", right, png, b))
    for level in (100.0, 400.0):
        header = {"dwaCompressionLevel": level}
        file = folder / f"dwaa{level:.0f}.exr"
        b = write_planes(file, planes(m.a), OpenEXR.DWAA_COMPRESSION, **header)
        pairs.append(Pair(f"DWAA of {level:.0f}", jpeg, a, b))
    return pairs


def _with_alpha(folder, m):
    """A picture that is transparent at a soft disc, divided and multiplied by its alpha."""
    y, x = np.mgrid[-1 : 1 : m.size[0] * 1j, -1 : 1 : m.size[1] * 1j]
    alpha = np.clip(6 * (0.8 - np.hypot(x, y)), 0, 1).astype(np.float32)
    light = m.a * alpha[..., None]
    a = _exr(folder / "rgba.exr", light, alpha)
    divided = np.where(alpha[..., None] > 0, light / np.maximum(alpha, 1e-6)[..., None], 0)
    changed = {"un-premultiplied": divided, "premultiplied twice": light * alpha[..., None]}
    pairs = [
        Pair(kind, ("premultiplication",), a, _exr(folder / f"{kind}.exr", image, alpha))
        for kind, image in changed.items()
    ]
    of_alpha = {
        "alpha thinner": (("multiplied", "another exposure"), alpha * 0.9),
        "alpha blurred": (_SOFT, through_disc(alpha[..., None], 3)[..., 0]),
        "alpha to a power": (("another gamma", "another tone curve"), alpha**1.5),
    }
    pairs += [
        Pair(kind, right, a, _exr(folder / f"{kind}.exr", light, other))
        for kind, (right, other) in of_alpha.items()
    ]
    return [*pairs, Pair("no alpha", ("missing channel",), a, _exr(folder / "rgb.exr", light))]


def faults(folder, name):
    """Pairs with a fault each, of one scene."""
    scene = source(name)
    a = scene.rendered().astype(np.float16).astype(np.float32)
    m = Maker(scene, a, np.random.default_rng(0))
    a, png = _exr(folder / "a.exr", m.a), save(folder / "a.png", _eight(m.a))
    pairs = []
    for kind, (right, change) in CHANGES.items():
        b = change(m)
        pairs.append(Pair(kind, right, a, _exr(folder / f"{kind}.exr", b)))
        if kind in OF_INTEGERS:
            file = save(folder / f"{kind}.png", _eight(b))
            pairs.append(Pair(f"{kind}, 8 bits", right, png, file))
            noise = m.rng.uniform(-2.5, 2.5, b.shape)
            noisy = np.clip(np.rint(_eight(b) + noise), 0, 255).astype(np.uint8)
            pairs.append(Pair(f"{kind}, ±2", right, png, save(folder / f"{kind} 2.png", noisy)))
    for kind, (right, make) in PAIRS.items():
        sides = zip("ab", make(m), strict=True)
        pairs.append(Pair(kind, right, *(_exr(folder / f"{kind} {n}.exr", v) for n, v in sides)))
    return [*pairs, *_lossy(folder, m, a, png), *_with_alpha(folder, m)]


def benign(folder, name):
    """Pairs whose differences do not matter, of one scene."""
    scene, rng = source(name), np.random.default_rng(0)
    light = scene.rendered()
    half = light.astype(np.float16)
    a, full = _exr(folder / "a.exr", half), _exr(folder / "f.exr", light, dtype=np.float32)
    png = save(folder / "a.png", _eight(light))
    flips = (half.view(np.int16) + (rng.random(half.shape) < 0.1)).view(np.float16)
    images = {
        "last bits": (full, light * (1 + rng.uniform(-2e-6, 2e-6, light.shape)), np.float32),
        "last bits, absolute": (full, light + rng.uniform(-2e-5, 2e-5, light.shape), np.float32),
        "rounded to half": (full, half, np.float16),
        "last bit of half": (a, flips, np.float16),
        "threads": (full, scene.rendered(threads=2), np.float32),
        "tiles": (full, scene.rendered(tile=64), np.float32),
        "float of half": (a, half, np.float32),
        "minus zero": (a, np.where(half == 0, np.float16(-0.0), half), np.float16),
    }
    pairs = [
        Pair(kind, (), one, _exr(folder / f"{kind}.exr", b, dtype=dtype))
        for kind, (one, b, dtype) in images.items()
    ]
    shown = _eight(light)
    deep = save(folder / "16.png", shown.astype(np.uint16) * 257)
    jpeg = save(folder / "jpeg95.png", _jpeg(folder, shown, 97))
    steps = (rng.random(shown.shape) < 0.02).astype(np.uint8)
    step_png = save(folder / "steps.png", np.minimum(shown, 254) + steps)
    pairs += [
        Pair(kind, (), png, b)
        for kind, b in (("16 bits", deep), ("JPEG of 97", jpeg), ("last step", step_png))
    ]
    return pairs

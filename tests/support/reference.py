"""Slow oracles for the renderer: the thin lens evaluated one lens point at a time.

All in float64. A point that the pinhole sees at pixel q with signed radius r is seen through lens
point u (x right, y down, unit disc) at q + r u; the picture is the mean over u of what u sees
first. Nothing here shares code with the renderer.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor


def whole(x, y):
    """The full disc."""
    return x * x + y * y <= 1.0


def left(x, y):
    """The half of the disc that makes the LEFT picture."""
    return whole(x, y) & (x < 0)


def right(x, y):
    """The half of the disc that makes the RIGHT picture."""
    return whole(x, y) & (x >= 0)


def polygon(blades, rotation=0.0):
    """Regular polygon in the disc, a vertex at `rotation` degrees counter-clockwise from +x."""

    def inside(x, y):
        open_ = torch.ones_like(x, dtype=torch.bool)
        for k in range(blades):
            # the normal of an edge points between two vertices; y counts downwards
            normal = math.radians(rotation + (k + 0.5) * 360.0 / blades)
            reach = x * math.cos(normal) - y * math.sin(normal)
            open_ &= reach <= math.cos(math.pi / blades)
        return open_

    return inside


def both(one, other):
    """What is open in both."""
    return lambda x, y: one(x, y) & other(x, y)


def lens_points(side, pupil=whole):
    """Points [n, 2] of a lattice, `side` of them along a diameter, that lie in the pupil.

    The lattice is oblique, so that no r makes it fall in step with the pixels, and its right half
    mirrors its left half: together they are the whole, in equal numbers.
    """
    steps = (torch.arange(-side, side, dtype=torch.float64) + 0.5) * 2.0 / side
    b, a = torch.meshgrid(steps, steps, indexing="ij")
    c, s = math.cos(0.55), math.sin(0.55)
    x, y = (c * a - s * b).flatten(), (s * a + c * b).flatten()
    x, y = x[x < 0], y[x < 0]
    x, y = torch.cat([x, -x]), torch.cat([y, y])
    open_ = pupil(x, y)
    return torch.stack([x[open_], y[open_]], -1)


def kernel(r, pupil=whole, samples=32):
    """Share of the pupil, scaled by r, that falls into each pixel [k, k]; odd k, sum 1."""
    half = math.ceil(abs(r) + 0.5)
    k, n = 2 * half + 1, (2 * half + 1) * samples
    if abs(r) < 0.5:  # the whole pupil lies in one pixel
        return torch.nn.functional.pad(torch.ones(1, 1, dtype=torch.float64), [half] * 4)
    steps = ((torch.arange(n, dtype=torch.float64) + 0.5) / samples - k / 2) / r
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    count = pupil(x, y).to(torch.float64).reshape(k, samples, k, samples).sum((1, 3))
    return count / count.sum()


def convolve(image, psf):
    """Direct convolution of [C, H, W] with [k, k], zero outside."""
    weight = psf.flip(0, 1)[None, None]
    padded = torch.nn.functional.conv2d(image[:, None], weight, padding=psf.shape[-1] // 2)
    return padded[:, 0]


def one_plane(image, r, pupil=whole):
    """A plane of one signed radius: one convolution of a picture whose edge goes on."""
    psf = kernel(r, pupil)
    around = psf.shape[-1] // 2
    padded = torch.nn.functional.pad(image[None], [around] * 4, mode="replicate")[0]
    return convolve(padded, psf)[:, around:-around, around:-around]


def one_plane_within(image, r, pupil=whole):
    """A plane with nothing beyond the frame: one convolution, divided by the share inside it."""
    psf = kernel(r, pupil)
    return convolve(image, psf) / convolve(torch.ones_like(image[:1]), psf)


class Layer(NamedTuple):
    """Premultiplied colour [C, h, w], alpha [h, w] and the one signed radius of a flat layer."""

    color: Tensor
    alpha: Tensor
    r: float


def moved(image, dx, dy):
    """Picture [..., h, w] moved to the nearest pixel; what leaves comes back on the other side.

    Over many lens points that is the pupil seen through the box of a pixel: `kernel`.
    """
    return torch.roll(image, (round(dy), round(dx)), (-2, -1))


def composite(layers, size, u):
    """What lens point u sees of layers listed front to back: the middle [C, H, W] of the canvas."""
    H, W = size
    h, w = layers[0].alpha.shape
    total = torch.zeros_like(layers[0].color)
    through = torch.ones_like(layers[0].alpha)
    for color, alpha, r in layers:
        if min(h - H, w - W) < 2 * (abs(r) + 1):
            raise ValueError(f"canvas {h}×{w} for {H}×{W}: needs a margin above |r| = {abs(r)}")
        total += through * moved(color, r * u[0], r * u[1])
        through = through * (1 - moved(alpha, r * u[0], r * u[1]))
    top, start = (h - H) // 2, (w - W) // 2
    return total[:, top : top + H, start : start + W]


def layered(layers, points, size):
    """Thin-lens picture [C, H, W] of explicit flat layers, front to back, on a larger canvas.

    Nothing is hidden from this one: every layer is given whole, the last one opaque.
    """
    pictures = [composite(layers, size, (float(x), float(y))) for x, y in points]
    return torch.stack(pictures).mean(0)


def flatten(layers, size):
    """The pinhole's picture [C, H, W] of the layers and the signed radius [H, W] it sees first."""
    image = composite(layers, size, (0.0, 0.0))
    seen = torch.full(layers[0].alpha.shape, math.inf, dtype=torch.float64)
    for _, alpha, r in reversed(layers):
        seen = torch.where(alpha > 0.5, r, seen)
    top, start = ((n - m) // 2 for n, m in zip(seen.shape, size, strict=True))
    return image, seen[top : top + size[0], start : start + size[1]]

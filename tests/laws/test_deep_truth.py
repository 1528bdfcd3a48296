"""Path-traced hair thinner than a pixel: with samples known, pictures are closer to the truth."""

import math

import numpy as np
import pytest
import torch
from measures import inner, psnr
from surfaces import Array, Plane, Scene, Surface
from textures import plain
from torch import Tensor
from tracer import PINHOLE, Camera, Lens, photograph, sobol, view
from worlds import turned

from defocus_core import render, render_layers

CAMERA = Camera(width=120, height=88)
SAMPLES = 64


def wall(u: Array, v: Array) -> Array:
    """Fine waves in three colours."""
    k = 2 * math.pi * CAMERA.focal_px / (4.0 * 15)
    waves = [np.sin(k * u), np.sin(k * v + 1), np.sin(k * (u + v))]
    return np.asarray(0.45 + 0.35 * np.stack(waves, -1))


def hair(number: int, metres: float, width_px: float) -> Plane:
    """A straight hair at a depth of some metres."""
    rng = np.random.default_rng(number)
    scale = metres / CAMERA.focal_px
    x, y = (rng.uniform(-0.4, 0.4, 2) * (CAMERA.width, CAMERA.height)) * scale
    half = (80 * scale, width_px * scale / 2)
    tint = plain((0.9, 0.6 + 0.2 * rng.random(), 0.2))
    return Plane((x, y, metres), tint, *turned(rng.uniform(-70, 70)), half=half)


def deep(surfaces: list[Surface], lens: Lens) -> tuple[Tensor, Tensor, Tensor]:
    """Each surface alone as a layer: premultiplied colours, signed radii in px, coverage."""
    layers = []
    for surface in surfaces:
        views = [view(Scene([surface]), CAMERA, PINHOLE, offset=tuple(o)) for o in offsets()]
        seen = np.mean([each.seen for each in views], 0)
        depth = np.mean([np.where(each.seen, 1 / each.depth, 0) for each in views], 0)
        radius = lens.signed_radius(np.divide(seen, depth, where=seen > 0, out=np.ones_like(seen)))
        layers.append((np.mean([each.rgb for each in views], 0).transpose(2, 0, 1), radius, seen))
    color, radius, coverage = (
        torch.from_numpy(np.stack(each)) for each in zip(*layers, strict=True)
    )
    return color, radius, coverage


def offsets() -> Array:
    return sobol(2, SAMPLES, 5)


def flat(scene: Scene, lens: Lens) -> tuple[Tensor, Tensor]:
    """The picture that a renderer writes: colours over each pixel, depth of its middle."""
    rgb = np.mean([view(scene, CAMERA, PINHOLE, offset=tuple(o)).rgb for o in offsets()], 0)
    radius = lens.signed_radius(view(scene, CAMERA, PINHOLE).depth)
    return torch.from_numpy(rgb.transpose(2, 0, 1)), torch.from_numpy(radius)


@pytest.mark.parametrize(
    ("focus", "radius", "metres"), [(4.0, 3.0, 1.5), (1.5, 9.0, 1.4), (2.5, 6.0, 1.5)]
)
def test_hair_is_closer_to_the_truth_by_6_db_than_in_a_flat_picture(
    focus: float, radius: float, metres: float
) -> None:
    hairs = [hair(k, metres * (1 + 0.02 * k), 0.5) for k in range(12)]
    scene = Scene([*hairs, Plane((0.0, 0.0, 4.0), wall)])
    lens = Lens(focus, radius)
    truth = photograph(scene, CAMERA, lens, samples=512, seed=3).full.transpose(2, 0, 1)
    truth = inner(torch.from_numpy(truth), 12)
    layers = render_layers(*deep(scene.surfaces, lens)).render[:3]
    plain_picture = render(*flat(scene, lens)).render
    known, guessed = (psnr(inner(image, 12), truth) for image in (layers, plain_picture))
    assert known > guessed + 6
    assert known > 40

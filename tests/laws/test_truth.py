"""The renderer against ray-traced thin-lens photographs: traced here, and the sample scenes."""

import json
import math
from functools import cache
from pathlib import Path

import demo
import numpy as np
import OpenEXR
import pytest
import torch
from measures import inner, psnr
from surfaces import Plane, Scene
from tracer import PINHOLE, Camera, Lens, photograph, view

from defocus_core import DefocusLens, render

ROOT = Path(demo.__file__).parent
SMALL = Camera(width=96, height=64)


def waves(period, z):
    """Coloured waves that show `period` px long at z metres."""
    k = 2 * math.pi * SMALL.focal_px / (z * period)

    def texture(u, v):
        phases = (u + 0.3 * v, v + 1, 0.7 * (u - v))
        return 0.5 + 0.35 * np.stack([np.sin(k * phase) for phase in phases], -1)

    return texture


def tensor(picture):
    return torch.from_numpy(np.moveaxis(picture, -1, 0).copy())


def wall():
    return Plane((0.0, 0.0, 4.0), waves(18, 4.0))


def card():
    return Plane((-0.15, 0.0, 1.5), waves(12, 1.5), half=(0.2, 0.15))


COSINE, SINE = math.cos(0.7), math.sin(0.7)
WORLDS = {
    "slanted": (Scene([Plane((0, 0, 3.0), waves(16, 3.0), (COSINE, 0.0, SINE))]), Lens(3.0, 20.0)),
    "two cards": (
        Scene([card(), Plane((0.25, 0.05, 2.2), waves(10, 2.2), half=(0.25, 0.3)), wall()]),
        Lens(2.2, 12.0),
    ),
    "focus on the wall": (Scene([card(), wall()]), Lens(4.0, 5.0)),
    "focus on the card": (Scene([card(), wall()]), Lens(1.5, 12.0)),
}


@cache
def photographed(name):
    """Pinhole picture, its radii, and the thin-lens pictures: whole, left, right."""
    scene, lens = WORLDS[name]
    sharp = photograph(scene, SMALL, PINHOLE, samples=64, seed=1).full
    radius = torch.from_numpy(lens.signed_radius(view(scene, SMALL, PINHOLE).depth))
    pair = photograph(scene, SMALL, lens, samples=512, seed=2)
    return tensor(sharp), radius, [tensor(x) for x in (pair.full, pair.left, pair.right)]


@pytest.mark.parametrize(
    ("name", "quality", "at_least"),
    [
        # a steep slope, 0.13 px per px: coverage as if it were flat
        ("slanted", "standard", 44.0),
        ("slanted", "high", 44.0),
        # What the cards hide are waves as short as the blur is wide, of which no picture tells.
        ("two cards", "standard", 27.0),
        ("focus on the wall", "standard", 29.0),
        ("focus on the card", "standard", 31.0),
    ],
)
def test_a_photograph_of_planes(name, quality, at_least):
    sharp, radius, truths = photographed(name)
    border = math.ceil(float(radius.abs().max()))
    o = render(sharp, radius, quality=quality, left_right=True)
    values = []
    for picture, truth in zip(o.images, truths, strict=True):
        values.append(psnr(inner(picture, border), inner(truth, border)))
    assert values[0] > at_least
    assert values[0] > psnr(inner(sharp, border), inner(truths[0], border)) + 9
    # a slope's coverage through one half is not 1: what is cut or divided there is 6 to 9 dB
    assert min(values[1:]) > at_least - (9 if name == "slanted" else 3)


@pytest.mark.parametrize(
    ("name", "at_least"),  # dB; `input` is 22.0, 17.7, 24.3, 11.8, 22.7
    [("floor", 48.0), ("layered", 34.5), ("leaves", 33.5), ("lights", 23.0), ("spheres", 43.5)],
)
def test_a_sample_scene_is_near_its_truth(name, at_least):
    camera = json.loads((ROOT / name / "camera.json").read_text())
    shot, size = camera["shots"][0], (camera["width"], camera["height"])
    width = camera["sensor_width_mm"]
    lens = DefocusLens(
        camera["focal_length_mm"], shot["fnumber"], (width, width * size[1] / size[0]), size
    )
    lens.refocus(1000 * shot["focus_distance_m"])
    with OpenEXR.File(str(ROOT / name / "depth.exr"), separate_channels=True) as file:
        depth = torch.from_numpy(file.channels()["Z"].pixels.copy())
    sharp = demo.read_rgb(ROOT / name / "rgb.exr")
    o = render(tensor(sharp).float(), lens.signed_radius(1000 * depth), left_right=True)
    border = math.ceil(shot["max_coc_radius_px"])
    for picture, suffix in ((o.render, ""), (o.left, "_left"), (o.right, "_right")):
        truth = demo.read_rgb(ROOT / name / f"truth_{shot['name']}{suffix}.exr")
        value = demo.psnr(np.moveaxis(picture.double().numpy(), 0, -1), truth, border)
        assert value > at_least - (3.5 if suffix else 0.0)
        assert value > demo.psnr(sharp, truth, border) + 8

"""A light field that is summed to a defocused picture is explained by the lens that a fit finds."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from tracer import PINHOLE, thin_lens, view
from worlds import WORLDS

from defocus_core import fit, render
from defocus_core.evaluation import metrics

# Views of a camera array: a square grid, as far as the round opening reaches.
GRID = [(x / 4.5, y / 4.5) for x, y in product(range(-4, 5), repeat=2) if math.hypot(x, y) <= 4.5]
OFFSETS = ((0.25, 0.25), (0.75, 0.75), (0.25, 0.75), (0.75, 0.25))
MAX_DB = 1.0  # that the lens found may explain less than the lens known
WIDTH, HEIGHT = 120, 69


def tensor(picture):
    return torch.from_numpy(np.moveaxis(picture, -1, 0).astype(np.float32))


def test_the_fit_explains_a_summed_light_field_as_the_known_lens_does():
    world = WORLDS["floor"]()
    camera = replace(world.camera, width=WIDTH, height=HEIGHT)
    lens = thin_lens(camera, world.fnum, world.focus)
    shown = [view(world.scene, camera, PINHOLE, offset=offset).rgb for offset in OFFSETS]
    views = [
        view(world.scene, camera, lens, point, OFFSETS[number % 4]).rgb
        for number, point in enumerate(GRID)
    ]
    sharp, seen = tensor(np.mean(shown, 0)), tensor(np.mean(views, 0))
    depth = view(world.scene, camera, PINHOLE).depth
    radius = torch.from_numpy(lens.signed_radius(depth)).float()
    disparity = torch.from_numpy(1 / depth).float()
    found = fit(sharp, disparity, seen)
    border = math.ceil(float(radius.abs().max()))
    known, fitted = (
        metrics.measure(render(sharp, r).render, seen, radius, border=border).psnr
        for r in (radius, (found.strength * (found.focus - disparity)).float())
    )
    assert known > 30
    assert fitted > known - MAX_DB
    # so far do a gain and a magnification, which are found too, take a picture of 120 px
    assert found.focus == pytest.approx(1 / world.focus, rel=0.03)

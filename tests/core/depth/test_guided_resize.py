"""Depth of another size comes to the size of its picture with edges where the colours change."""

import math
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from torch.nn.functional import avg_pool2d, interpolate

from defocus_core import guided_depth

SIZE = (96, 128)
NEAR, FAR = 1.5, 6.0
SCENES = Path(__file__).parents[3] / "sample_scenes"


def disc(size=SIZE):
    """A textured disc before a textured wall, and its depth, both [.., H, W]."""
    y, x = (torch.arange(side, dtype=torch.float64) + 0.5 for side in size)
    is_near = (x - 0.52 * size[1]) ** 2 + (y[:, None] - 0.47 * size[0]) ** 2 < (0.3 * size[0]) ** 2
    waves = 0.1 * torch.sin(x / 3) * torch.sin(y[:, None] / 4)
    near = torch.tensor([0.7, 0.3, 0.1])[:, None, None] + waves
    wall = torch.tensor([0.2, 0.4, 0.6])[:, None, None] + waves
    return torch.where(is_near, near, wall), torch.where(is_near, NEAR, FAR).double()


def sampled(depth, step):
    return depth[step // 2 :: step, step // 2 :: step].contiguous()


def nearest(depth, size):
    return interpolate(depth[None, None], size, mode="nearest-exact")[0, 0]


@pytest.mark.parametrize("step", [2, 3, 4])
def test_edges_lie_where_the_colours_change(step):
    image, depth = disc()
    small = sampled(depth, step)
    found = nearest(small, SIZE), guided_depth(small, image)
    wrong = [((resized - depth).abs() > 1e-6).sum() for resized in found]
    assert wrong[1] < wrong[0] / 4


@pytest.mark.parametrize("step", [2, 3, 4])
def test_no_depth_is_invented_between_surfaces(step):
    image, depth = disc()
    found = guided_depth(sampled(depth, step), image)
    off = torch.minimum((found - NEAR).abs(), (found - FAR).abs())
    assert off.max() < 1e-6


def test_sky_stays_sky_up_to_its_edge():
    image, depth = disc()
    depth[depth == FAR] = math.inf
    found = guided_depth(sampled(depth, 2), image)
    assert bool((found > 0).all())
    assert bool((torch.isinf(found) | ((found - NEAR).abs() < 1e-6)).all())
    assert (torch.isinf(found) != torch.isinf(depth)).sum() < 20


def test_slopes_go_on_up_to_an_edge():
    """Planes stay planes: their disparity is linear in the pixels."""
    image, depth = disc()
    x = torch.arange(SIZE[1], dtype=torch.float64)
    slanted = torch.where(depth == NEAR, 0.6 + 0.001 * x, 0.1 + 0.0005 * x)
    small = avg_pool2d(slanted[None, None], 1, stride=2)[0, 0]  # coarse pixels at 2 x, for x + 0.5
    found = 1 / guided_depth(1 / small, image)
    right = (found - (slanted - torch.where(depth == NEAR, 0.0005, 0.00025))).abs() < 1e-3
    assert right[:, 2:-2].double().mean() > 0.985


def test_ramps_become_steps():
    image, _ = disc()
    x = torch.arange(SIZE[1] // 2, dtype=torch.float64).expand(SIZE[0] // 2, -1)
    ramp = 0.2 + 0.6 * ((x - 20) / 8).clamp(0, 1)
    found = 1 / guided_depth(1 / ramp, image)
    assert ((found > 0.25) & (found < 0.75)).double().mean() < 0.01


@pytest.mark.parametrize("step", [3, 4])
def test_an_edge_that_is_a_coarse_pixel_off_comes_to_that_of_the_colours(step):
    size = (4 * SIZE[0], 4 * SIZE[1])
    image, depth = disc(size)
    fat = (depth == NEAR).double()[None, None]
    fat = torch.nn.functional.max_pool2d(fat, 4 * step + 1, 1, 2 * step)[0, 0] > 0
    found = guided_depth(sampled(torch.where(fat, NEAR, FAR).double(), step), image)
    wrong = [((each == NEAR) != (depth == NEAR)).sum() for each in (fat * NEAR, found)]
    assert wrong[1] < 0.15 * wrong[0]


def test_averages_at_edges_are_no_surface():
    size = (4 * SIZE[0], 4 * SIZE[1])
    image, depth = disc(size)
    averaged = avg_pool2d(1 / depth[None, None], 2)[0, 0]
    assert ((averaged - 1 / NEAR).abs() > 1e-3).logical_and((averaged - 1 / FAR).abs() > 1e-3).any()
    found = 1 / guided_depth(1 / averaged, image)
    between = (found < 0.9 / NEAR) & (found > 1.1 / FAR)
    assert between.double().mean() < 0.002


@pytest.mark.parametrize("small", [(48, 64), (33, 44), (24, 32), (120, 160), (1, 1), (1, 2)])
def test_any_size_becomes_that_of_the_picture(small):
    image, _ = disc()
    _, depth = disc(small)
    found = guided_depth(depth, image)
    assert found.shape == SIZE
    assert found.min() >= depth.min() - 1e-9
    assert found.max() <= depth.max() + 1e-9


@pytest.mark.parametrize("scene", ["layered", "leaves", "lights", "spheres"])
@pytest.mark.parametrize("step", [2, 4])
def test_fewer_pixels_are_on_the_wrong_surface_than_by_nearest(scene, step):
    def channels(name, *wanted):
        with OpenEXR.File(str(SCENES / scene / f"{name}.exr"), separate_channels=True) as file:
            pixels = [file.channels()[each].pixels.astype(np.float64) for each in wanted]
        return torch.from_numpy(np.stack(pixels))

    image, depth = channels("rgb", *"RGB"), channels("depth", "Z")[0]
    small, size = sampled(depth, step), (depth.shape[0], depth.shape[1])
    far_off = 0.05 * (1 / depth).max()
    wrong = [
        ((1 / found - 1 / depth).abs() > far_off).double().mean()
        for found in (nearest(small, size), guided_depth(small, image))
    ]
    assert wrong[1] < 0.85 * wrong[0]

"""The ray tracer obeys closed forms, and the committed pictures are those of the scenes."""

import json
import math
from pathlib import Path

import demo
import numpy as np
import OpenEXR
import OpenImageIO
import pytest
import torch
from estimated import estimated
from make import second_layer
from reference import one_plane
from surfaces import Plane, Scene
from textures import plain
from tracer import PINHOLE, Camera, Lens, photograph, rays, thin_lens, view
from worlds import WORLDS

ROOT = Path(demo.__file__).parent
SMALL = Camera(width=64, height=40)
WHITE = plain((1.0, 1.0, 1.0))


def waves(u, v):
    """Waves that a plane at 3 m shows with a period of 24 px."""
    k = 2 * math.pi * SMALL.focal_px / (3.0 * 24)
    channels = [np.sin(k * u), np.sin(k * v + 1), np.sin(k * (u + v))]
    return 0.5 + 0.4 * np.stack(channels, -1)


def channels(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def tensor(picture):
    return torch.from_numpy(np.moveaxis(picture, -1, 0).copy())


@pytest.mark.parametrize("z", [0.7, 2.0, 30.0])
def test_a_point_seen_at_q_is_seen_through_u_at_q_plus_r_u(z):
    lens, q, u = Lens(2.0, 12.0), (20.3, 11.8), (0.6, -0.5)
    r = lens.signed_radius(z)
    straight = rays(SMALL, PINHOLE, np.array(q[0]), np.array(q[1]), 0.0, 0.0)
    oblique = rays(SMALL, lens, np.array(q[0] + r * u[0]), np.array(q[1] + r * u[1]), *u)
    assert oblique.ox + z * oblique.dx == pytest.approx(z * straight.dx)
    assert oblique.oy + z * oblique.dy == pytest.approx(z * straight.dy)


@pytest.mark.parametrize("r", [-4.0, 6.0])
def test_a_plane_that_faces_the_lens_is_one_convolution(r):
    scene = Scene([Plane((0, 0, 3.0), waves)])
    lens = Lens(2.0, 3 * r) if r > 0 else Lens(4.0, -3 * r)
    assert lens.signed_radius(3.0) == pytest.approx(r)
    sharp = photograph(scene, SMALL, PINHOLE, samples=256, seed=1).full
    blurred = photograph(scene, SMALL, lens, samples=1024, seed=1).full
    error = tensor(blurred) - one_plane(tensor(sharp), r)
    assert error[:, 7:-7, 7:-7].abs().max() < 4e-3  # waves of amplitude 0.4, 1024 lens points


def test_the_second_layer_is_what_a_card_hides():
    card = Plane((0, 0, 1.0), WHITE, half=(0.1, 0.1))
    wall = Plane((0, 0, 3.0), plain((0.2, 0.4, 0.6)))
    rgb, depth = second_layer(Scene([card, wall]), SMALL, 4)
    hidden = view(Scene([card]), SMALL, PINHOLE).seen
    assert np.all(np.where(hidden, 3.0, math.inf) == depth)
    assert rgb[hidden] == pytest.approx(np.array([[0.2, 0.4, 0.6]] * hidden.sum()))
    assert np.all(rgb[~hidden] == 0)


@pytest.mark.parametrize("name", WORLDS)
def test_committed_depth_is_that_of_the_scene(name):
    world, details = WORLDS[name](), json.loads((ROOT / name / "camera.json").read_text())
    depth = channels(ROOT / name / "depth.exr")["Z"]
    expected = view(world.scene, world.camera, PINHOLE).depth
    assert depth.dtype == np.float32
    assert np.array_equal(np.isinf(depth), np.isinf(expected))
    known = np.isfinite(depth)
    assert np.abs(depth[known] / expected[known] - 1).max() < 2.0**-15
    shot = details["shots"][0]
    lens = thin_lens(world.camera, shot["fnumber"], shot["focus_distance_m"])
    assert np.abs(lens.signed_radius(expected)).max() == pytest.approx(
        shot["max_coc_radius_px"], abs=1e-3
    )
    assert 8 <= shot["max_coc_radius_px"] <= 16


@pytest.mark.parametrize("name", WORLDS)
def test_committed_pinhole_picture_is_that_of_the_scene(name):
    world = WORLDS[name]()
    few = photograph(world.scene, world.camera, PINHOLE, samples=4, seed=9, light_samples=256).full
    assert demo.psnr(few, demo.read_rgb(ROOT / name / "rgb.exr"), 0) > 24


def test_committed_estimated_depth_is_that_of_the_scene():
    found = {path.parent.name for path in ROOT.glob("*/estimated.png")}
    assert found == {name for name, world in WORLDS.items() if world().estimated} == {"spheres"}
    world = WORLDS["spheres"]()
    levels, near, far = estimated(view(world.scene, world.camera, PINHOLE).depth)
    image = OpenImageIO.ImageBuf(str(ROOT / "spheres" / "estimated.png"))
    committed = image.get_pixels(OpenImageIO.UINT8)[..., 0]
    assert committed.shape == (135, 240)
    assert np.abs(committed.astype(int) - levels).max() <= 1
    details = json.loads((ROOT / "spheres" / "camera.json").read_text())
    assert details["estimated_depth_range_m"] == pytest.approx([near, far], abs=1e-3)


def test_the_demo_renders_a_scene_with_both_depths():
    camera = json.loads((ROOT / "spheres" / "camera.json").read_text())
    rows = demo.depths(ROOT / "spheres", camera)
    assert list(rows) == ["spheres", "spheres*"]
    assert rows["spheres*"][1:] == [
        *("--depth-kind", "disparity", "--depth-range", "0.9433m", "5.0544m"),
        *("--resize-depth", "guided"),
    ]
    assert list(demo.depths(ROOT / "floor", camera)) == ["floor"]

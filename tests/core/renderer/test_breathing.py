"""A lens that breathes: blur lies farther outwards the wider it is, and nothing sharp moves."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from command_line import color_exr, depth_exr, read_exr, run

from defocus_core.renderer.breathing import breathed


def centroid(image):
    y, x = (torch.arange(n, dtype=image.dtype) for n in image.shape)
    return float((image.sum(0) @ x) / image.sum()), float((image.sum(1) @ y) / image.sum())


def test_a_point_moves_outwards_by_its_radius_and_its_place():
    image = torch.zeros(1, 81, 161)
    image[0, 60, 120] = 1.0  # half of a half width right of the middle, a quarter of one below
    radius = torch.full((81, 161), 6.0)
    moved, radii = breathed(image, radius, 0.4)
    assert centroid(moved[0]) == pytest.approx(
        (120 + 0.4 * 6 * 40 / 80.5, 60 + 0.4 * 6 / 4), abs=0.1
    )
    torch.testing.assert_close(radii, radius)
    inwards, _ = breathed(image, -radius, 0.4)
    assert centroid(inwards[0])[0] == pytest.approx(120 - 0.4 * 6 * 40 / 80.5, abs=0.1)


def test_what_is_in_focus_stays():
    image = torch.rand(3, 20, 30, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(breathed(image, torch.zeros(20, 30), 0.5)[0], image)


def test_a_light_is_drawn_where_a_lens_that_breathes_shows_it(tmp_path):
    pixels = np.zeros((40, 80, 3), np.float32)
    pixels[20, 60] = 100.0
    files = (
        color_exr(tmp_path / "a.exr", pixels),
        depth_exr(tmp_path / "d.exr", np.full((40, 80), 9, "f4")),
    )
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus", "3m", "--sensor-width", "8mm")
    at = []
    for breathing in ("0", "0.5"):
        ran = run("render", *files, "-o", tmp_path / breathing, *lens, "--breathing", breathing)
        assert ran.code == 0, ran.err
        at.append(
            centroid(torch.from_numpy(read_exr(tmp_path / breathing / "render/a.exr")["G"]))[0]
        )
    radius = 50**2 / (2 * 0.1 * 2 * (1 - 50 / 3000)) * (1 / 3000 - 1 / 9000)
    assert at[1] - at[0] == pytest.approx(0.5 * radius * 20.5 / 40, abs=0.2)


def test_white_stays_white_over_a_large_frame(tmp_path):
    color = color_exr(tmp_path / "rgb.exr", np.ones((300, 400, 3), np.float32))
    metres = np.tile(np.linspace(1, 4, 400, dtype=np.float32), (300, 1))
    depth = depth_exr(tmp_path / "z.exr", metres)
    lens = ("--focal-length", "50mm", "--fnumber", "2", "--focus", "2m", "--breathing", "0.2")
    ran = run("render", color, depth, *lens, "--quality", "draft", "-o", tmp_path / "out")
    assert ran.code == 0, ran.err
    assert read_exr(tmp_path / "out" / "render" / "rgb.exr")["G"] == pytest.approx(1, abs=2e-3)

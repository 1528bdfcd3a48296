"""Slopes of the radius: of a pixel's own surface, and what they are for."""

import pytest
import torch
from measures import inner, psnr, worst

from defocus_core import render
from defocus_core.renderer.layers.sliced_surface import Planes
from defocus_core.renderer.layers.slopes import slopes

SIZE = (40, 60)


def test_a_steep_line_is_left_out_and_a_steep_area_is_not():
    radius = torch.zeros(SIZE, dtype=torch.float64)
    radius[:, 20:] = torch.arange(40, dtype=torch.float64).clamp(max=2) * 0.8
    assert slopes(radius, 0.1) is None
    radius[:, 20:] = torch.arange(40, dtype=torch.float64).clamp(max=12) * 0.8
    found = slopes(radius, 0.1)
    assert worst(found[0, :, 23:30], 0.8) < 1e-12


def lens_view(steepness, samples):
    """Waves on a plane of radius s (x - x0): lens point u sees x + u s (x - x0) at x, exactly.

    Solved for the pixel q that lands on x: q = (x + s u.x x0) / (1 + s u.x), down q = y - r(q) u.y.
    """
    y, x = (torch.arange(n, dtype=torch.float64) for n in SIZE)
    y, x, x0 = y[:, None], x[None, :], SIZE[1] / 2
    total, count = torch.zeros(3, *SIZE, dtype=torch.float64), 0
    steps = (torch.arange(samples, dtype=torch.float64) + 0.5) / samples * 2 - 1
    for ux in steps.tolist():
        for uy in steps.tolist():
            if ux * ux + uy * uy > 1:
                continue
            q = (x + steepness * ux * x0) / (1 + steepness * ux)
            total += waves(q, y - steepness * (q - x0) * uy)
            count += 1
    return total / count


def waves(x, y):
    phases = [(1.0, 0.3), (-0.4, 1.0), (0.7, 0.7)]
    return 0.5 + 0.4 * torch.stack([torch.sin(0.35 * (a * x + b * y) + 2 * a) for a, b in phases])


@pytest.mark.parametrize(("steepness", "at_least"), [(0.2, 52.0), (0.5, 45.0), (0.8, 39.0)])
def test_a_steep_plane_is_seen_as_densely_as_the_lens_sees_it(steepness, at_least):
    y, x = (torch.arange(n, dtype=torch.float64) for n in SIZE)
    image = waves(x[None, :].expand(SIZE), y[:, None].expand(SIZE))
    radius = (steepness * (x - SIZE[1] / 2)).expand(SIZE).clone()
    truth = inner(lens_view(steepness, 40), 15)
    assert psnr(inner(render(image, radius).render, 15), truth) > at_least


@pytest.mark.usefixtures("torch_back")
@pytest.mark.parametrize("top", [8.0, 60.0])
def test_a_tilted_kernel_does_what_a_tilted_slice_does(top, monkeypatch):
    """At full resolution and at reduced; a wire before the floor is not as tilted."""
    image = torch.rand(3, 150, 200, generator=torch.Generator().manual_seed(4))
    radius = torch.linspace(top, -top, 150)[:, None].repeat(1, 200)
    radius[:, 50:56] = -top
    short = render(image, radius, left_right=True)
    monkeypatch.setattr(Planes, "slopes", lambda _, numbers, box: [None] * len(numbers))
    whole = render(image, radius, left_right=True)
    assert 0 < worst(short.render, whole.render) < 2e-5
    assert worst(short.left, whole.left) < 2e-5

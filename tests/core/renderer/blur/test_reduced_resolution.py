"""Large radii at reduced resolution: the same picture but for the softness of a rim."""

from dataclasses import replace

import pytest
import torch
from measures import worst
from tolerances import RENDERED

from defocus_core import render
from defocus_core.renderer.engine import settings
from defocus_core.tensors import box as tiling

EXACT = RENDERED[torch.float64]


@pytest.fixture
def halved_early(monkeypatch):
    """Radii from 2 px on are blurred at reduced resolution: small frames show what large do."""
    early = replace(settings.QUALITY["standard"], full_resolution=2.0)
    monkeypatch.setitem(settings.QUALITY, "standard", early)


def scene(size, r):
    """Noise with a card before it that is as much nearer than focus."""
    H, W = size
    image = torch.rand(3, H, W, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    radius = torch.full(size, r, dtype=torch.float64)
    radius[H // 4 : H // 2, W // 3 : W // 2] = -r
    return image, radius


@pytest.mark.parametrize(("r", "bound"), [(24.0, 2.0), (-36.0, 2.0), (60.0, 1.5), (100.0, 1.0)])
def test_a_wide_blur_is_nearly_that_at_full_resolution(r, bound):
    """Noise without any smoothness to help: what is left of it is the ripple of the rim."""
    size = (270, 400)
    image = torch.rand(1, *size, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    radius = torch.full(size, r, dtype=torch.float64)
    exact = render(image, radius, num_layers=1, quality="reference").render
    seen = render(image, radius, num_layers=1).render
    assert 0 < float((seen - exact).square().mean().sqrt()) < bound / 1e3


@pytest.mark.usefixtures("halved_early")
def test_depth_has_gradients():
    image, radius = scene((12, 14), 5.0)
    radius = (radius + 0.3 * torch.rand(12, 14, dtype=torch.float64)).requires_grad_()
    weight = torch.rand(3, 12, 14, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
    (render(image, radius).render * weight).sum().backward()
    step = torch.zeros_like(radius)
    step[2, 3] = step[4, 6] = 1e-6
    with torch.no_grad():
        ends = [(render(image, radius + s * step).render * weight).sum() for s in (1, -1)]
    slope = float(ends[0] - ends[1]) / 2e-6
    assert float((radius.grad * step).sum()) / 1e-6 == pytest.approx(slope, rel=1e-4)


@pytest.mark.parametrize("upright", [False, True])
def test_what_lies_beyond_the_reach_of_a_region_does_not_wrap_around(monkeypatch, upright):
    """A wider layer makes a region hold more than a narrower one may see."""
    size = (1500, 40)
    image = torch.rand(3, *size, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    radius = torch.full(size, 67.0, dtype=torch.float64)
    radius[500:] = 45.0
    if not upright:
        image, radius = image.mT.contiguous(), radius.mT.contiguous()
    in_regions = render(image, radius).render
    monkeypatch.setattr(tiling, "REGION", 4096)
    assert worst(in_regions, render(image, radius).render) < EXACT

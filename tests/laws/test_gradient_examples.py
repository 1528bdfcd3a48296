"""What gradients are good for: a lens found from its blur, a depth map from a dual-pixel pair."""

import pytest
import torch
from torch.nn.functional import interpolate

from defocus_core import render


def refine_radius(sharp, coarse, left, right, *, steps, smooth):
    """Signed radii [H, W] px, linear in disparity, that explain a dual-pixel pair [C, H, W]."""
    radius = coarse.clone().requires_grad_()
    optimizer = torch.optim.Adam([radius], lr=0.1)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        optimizer.zero_grad()
        pair = render(sharp, radius, left_right=True)
        misfit = (pair.left - left).square().mean() + (pair.right - right).square().mean()
        bends = sum(radius.diff(n=2, dim=dim).square().mean() for dim in (0, 1))
        (misfit + smooth * bends).backward()
        optimizer.step()
        decay.step()
    return radius.detach()


SIZE = (24, 40)  # H, W


def textured():
    """Noise [3, H, W] of several sizes of grain, so that any blur leaves something to be seen."""
    random = torch.Generator().manual_seed(3)
    picture = torch.zeros(3, *SIZE)
    for grain in (1, 4, 8):
        noise = torch.rand(1, 3, SIZE[0] // grain, SIZE[1] // grain, generator=random)
        picture += grain**0.5 * interpolate(noise, SIZE, mode="bilinear")[0]
    return picture / picture.max()


def true_radius():
    """A ramp through focus with a ball before it, [H, W] px."""
    y, x = torch.linspace(-1, 1, SIZE[0])[:, None], torch.linspace(-1.5, 1.5, SIZE[1])
    return 1.5 * x + 0.5 * y - 2.5 * (0.6 - x * x - y * y).clamp(min=0)


def smoothly_wrong(radius):
    """Off by waves of up to 0.6 px."""
    y, x = torch.linspace(0, 3, SIZE[0])[:, None], torch.linspace(0, 6.3, SIZE[1])
    return radius + 0.6 * torch.sin(x + 1) * torch.cos(y)


@pytest.mark.parametrize("coarsely", [smoothly_wrong, torch.round])
def test_a_coarse_depth_map_is_refined_by_a_dual_pixel_pair(coarsely):
    sharp, truth = textured(), true_radius()
    pair = render(sharp, truth, left_right=True)
    coarse = coarsely(truth)
    refined = refine_radius(sharp, coarse, pair.left, pair.right, steps=30, smooth=3e-3)
    assert (refined - truth).abs().mean() < (coarse - truth).abs().mean() / 2

"""What gradients are good for: a lens found from its blur, a depth map from a dual-pixel pair."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, interpolate

from defocus_core import DefocusLens, render


def find_lens(
    sharp: Tensor,
    depth: Tensor,
    photo: Tensor,
    lens: DefocusLens,
    *,
    foc_dist: float,
    fnum: float,
    steps: int,
) -> tuple[float, float]:
    """Focus distance in mm and f-number of a photo, from a guess of both.

    Sought as 1 / foc_dist, in which the blur is linear, and as log(fnum), which stays positive.
    """
    disparity = torch.tensor(1 / foc_dist, dtype=photo.dtype, requires_grad=True)
    log_fnum = torch.tensor(math.log(fnum), dtype=photo.dtype, requires_grad=True)
    unit = 1 / foc_dist  # a step changes both by some percent
    optimizer = torch.optim.Adam(
        [{"params": [disparity], "lr": 0.05 * unit}, {"params": [log_fnum], "lr": 0.05}]
    )
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        optimizer.zero_grad()
        lens.fnum = log_fnum.exp()
        lens.refocus(1 / disparity)
        (lens.render_rgbd(sharp, depth) - photo).square().mean().backward()
        optimizer.step()
        decay.step()
    return 1 / disparity.item(), math.exp(log_fnum.item())


def refine_radius(
    sharp: Tensor, coarse: Tensor, left: Tensor, right: Tensor, *, steps: int, smooth: float
) -> Tensor:
    """Signed radii [H, W] px, linear in disparity, that explain a dual-pixel pair [C, H, W]."""
    radius = coarse.clone().requires_grad_()
    optimizer = torch.optim.Adam([radius], lr=0.1)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        optimizer.zero_grad()
        pair = render(sharp, radius, left_right=True)
        assert pair.left is not None
        assert pair.right is not None
        misfit = (pair.left - left).square().mean() + (pair.right - right).square().mean()
        bends = sum(radius.diff(n=2, dim=dim).square().mean() for dim in (0, 1))
        (misfit + smooth * bends).backward()
        optimizer.step()
        decay.step()
    return radius.detach()


SIZE = (32, 48)  # H, W


def textured() -> Tensor:
    """Noise [3, H, W] of several sizes of grain, so that any blur leaves something to be seen."""
    random = torch.Generator().manual_seed(3)
    picture = torch.zeros(3, *SIZE)
    for grain in (1, 4, 8):
        noise = torch.rand(1, 3, SIZE[0] // grain, SIZE[1] // grain, generator=random)
        picture += grain**0.5 * interpolate(noise, SIZE, mode="bilinear")[0]
    return picture / picture.max()


def slanted_depth() -> Tensor:
    """A wall from 1 m to 4 m, [1, 1, H, W] in mm: radii from -7 to 5 px."""
    return 1 / torch.linspace(1 / 1000, 1 / 4000, SIZE[1]).expand(1, 1, *SIZE)


def portrait_lens() -> DefocusLens:
    """85 mm f/1.2 before a small sensor, focused at 1.8 m."""
    lens = DefocusLens(85.0, 1.2, (9.6, 9.6 * SIZE[0] / SIZE[1]), SIZE[::-1])
    lens.refocus(1800.0)
    return lens


@pytest.mark.parametrize(("foc_dist", "fnum"), [(1400.0, 1.8), (2600.0, 2.0), (1300.0, 0.8)])
def test_a_lens_is_found_from_its_blur(foc_dist: float, fnum: float) -> None:
    sharp, depth = textured()[None], slanted_depth()
    photo = portrait_lens().render_rgbd(sharp, depth)
    found = find_lens(sharp, depth, photo, portrait_lens(), foc_dist=foc_dist, fnum=fnum, steps=90)
    assert found[0] == pytest.approx(1800.0, rel=0.01)
    assert found[1] == pytest.approx(1.2, rel=0.01)


def true_radius() -> Tensor:
    """A ramp through focus with a ball before it, [H, W] px."""
    y, x = torch.linspace(-1, 1, SIZE[0])[:, None], torch.linspace(-1.5, 1.5, SIZE[1])
    return 1.5 * x + 0.5 * y - 2.5 * (0.6 - x * x - y * y).clamp(min=0)


def smoothly_wrong(radius: Tensor) -> Tensor:
    """Off by waves of up to 0.6 px."""
    y, x = torch.linspace(0, 3, SIZE[0])[:, None], torch.linspace(0, 6.3, SIZE[1])
    return radius + 0.6 * torch.sin(x + 1) * torch.cos(y)


def blurred(radius: Tensor) -> Tensor:
    """Known only as means over 15 px."""
    return avg_pool2d(radius[None], 15, 1, 7, count_include_pad=False)[0]


@pytest.mark.parametrize("coarsely", [smoothly_wrong, blurred, torch.round])
def test_a_coarse_depth_map_is_refined_by_a_dual_pixel_pair(
    coarsely: Callable[[Tensor], Tensor],
) -> None:
    sharp, truth = textured(), true_radius()
    pair = render(sharp, truth, left_right=True)
    assert pair.left is not None
    assert pair.right is not None
    coarse = coarsely(truth)
    refined = refine_radius(sharp, coarse, pair.left, pair.right, steps=60, smooth=3e-3)
    assert (refined - truth).abs().mean() < (coarse - truth).abs().mean() / 2

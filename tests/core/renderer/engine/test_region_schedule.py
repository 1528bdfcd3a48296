"""What is in focus is copied; what light out of focus reaches is computed, and nothing else."""

from __future__ import annotations

import pytest
import torch

from defocus_core import render
from defocus_core.renderer.engine import regions
from defocus_core.tensors.box import Box

H, W = 400, 480
# Rows and columns that are out of focus.
SPOTS = {
    "above": Box(0, 0, 40, W),
    "below": Box(H - 30, 0, 30, W),
    "left": Box(0, 0, H, 35),
    "middle": Box(250, 300, 50, 60),
    "corner": Box(H - 40, W - 50, 40, 50),
}


def scene(spot, *, hard):
    """Noise, and radii that rise from the border of a rectangle inwards, slowly or at once."""
    image = torch.rand(3, H, W, generator=torch.Generator().manual_seed(0))
    y, x = torch.arange(H)[:, None], torch.arange(W)
    inside = torch.minimum(
        torch.minimum(y - spot.top + 1, spot.top + spot.height - y),
        torch.minimum(x - spot.left + 1, spot.left + spot.width - x),
    )
    inside = inside.clamp(min=0).float()
    return image, -9.0 * (inside > 0).float() if hard else (0.3 * inside).clamp(max=7)


@pytest.mark.parametrize("hard", [False, True])
@pytest.mark.parametrize("spot", SPOTS)
def test_what_is_copied_is_what_would_be_computed(spot, hard, monkeypatch):
    image, radius = scene(SPOTS[spot], hard=hard)
    views = render(image, radius, left_right=True, tile=96)
    with monkeypatch.context() as patch:
        patch.setattr(regions, "blurred_part", lambda frame, grid, radii: grid)
        whole = render(image, radius, left_right=True, tile=96)
    assert views.stats["slice_tiles_done"] <= whole.stats["slice_tiles_done"]
    assert views.stats["pixels_copied"] >= whole.stats["pixels_copied"] > 0
    assert views.stats["pixels"] == whole.stats["pixels"] == H * W
    assert views.stats["tiles"] == whole.stats["tiles"]
    for name in ("render", "left", "right", "trust"):
        assert torch.allclose(getattr(views, name), getattr(whole, name), atol=2e-6), name


@pytest.mark.usefixtures("torch_back")
def test_what_is_copied_hands_gradients_on():
    image, radius = scene(SPOTS["middle"], hard=True)
    plain = render(image, radius, tile=96)
    weights = torch.rand(3, H, W, generator=torch.Generator().manual_seed(1))
    views = render(image.requires_grad_(), radius, tile=96)
    assert torch.equal(views.render, plain.render)
    assert torch.equal(views.trust, plain.trust)
    (views.render * weights).sum().backward()
    blurred = SPOTS["middle"].grown(64, Box(0, 0, H, W))
    copied = torch.ones(H, W, dtype=torch.bool)
    blurred.crop(copied)[:] = False
    assert torch.equal(image.grad[:, copied], weights[:, copied])
    assert not torch.equal(image.grad, weights)

"""An opaque surface has no holes, whatever its depth does and whatever lies behind it."""

import pytest
import torch

from defocus_core import render

SIZE = H, W = 140, 200
DARK, BRIGHT = 0.01, 0.5
# px around the blur of a surface in which its silhouette may show
BESIDE = 2
Y, X = torch.meshgrid(*(torch.arange(n) - n // 2 for n in SIZE), indexing="ij")
# A disc whose silhouette is this many px from each pixel, negative outside.
INSIDE = 66 - torch.hypot(X.double(), Y.double())


def stepped(px):
    """Terraces 15 px wide, at most four steps up and down, or 4 px."""
    return (((X + 7) // 15).double().clamp(-4, 4) * px).clamp(-4, 4)


def curved():
    return 2 * torch.sin(X / 20.0) + 1.5 * torch.cos(Y / 20.0)


def of_levels(noise):
    grain = torch.randn(SIZE, generator=torch.Generator().manual_seed(3))
    return (curved() / 0.3 + noise * grain).round() * 0.3


SMOOTH = {"slope": 0.02 * X + 0.01 * Y, "curve": curved(), "fold": 0.06 * X.abs()}
ROUGH = {
    "levels": of_levels(0.0),
    "noise": of_levels(0.5),
    **{f"steps of {px} px": stepped(px) for px in (0.02, 0.1, 0.3, 0.6, 1.0, 1.1, 1.5, 2.0, 3.0)},
}


def leak(radius, far, *, quality="standard"):
    """What a dark disc shows of a bright plane, as a share of the contrast; left and right, too."""
    is_near = INSIDE > 0
    image = torch.where(is_near, DARK, BRIGHT).expand(3, *SIZE).float()
    signed_radius = torch.where(is_near, radius.double(), far).float()
    views = render(image, signed_radius, quality=quality, left_right=True)
    largest = float(signed_radius[is_near].abs().max())
    within = largest + BESIDE < INSIDE
    assert within.any()
    shown = torch.stack(views.images)[..., within]
    return float((shown - DARK).abs().max()) / (BRIGHT - DARK)


@pytest.mark.parametrize(("offset", "far"), [(0, 40), (-8, 20), (4, 40), (-12, -2)])
@pytest.mark.parametrize("name", SMOOTH)
def test_a_smooth_surface_shows_nothing_behind_it(name, offset, far):
    assert leak(SMOOTH[name] + offset, far) < 1e-3


@pytest.mark.parametrize(("offset", "far"), [(0, 40), (-8, 20), (4, 40), (-12, -2)])
@pytest.mark.parametrize("name", ROUGH)
def test_steps_of_a_surface_show_what_is_beyond_them(name, offset, far):
    assert leak(ROUGH[name] + offset, far) < 1e-2

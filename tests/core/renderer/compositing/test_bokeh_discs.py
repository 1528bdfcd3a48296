"""Discs of highlights: the light of the kernel, and shadows as dark as what stands before."""

import pytest
import torch

from defocus_core import Aperture
from defocus_core.optics.parts import FULL
from defocus_core.renderer.compositing.highlights import Highlights, draw
from defocus_core.renderer.engine.survey import highlight_limit, surveyed
from defocus_core.renderer.layers.layer import SampleLayer
from defocus_core.tensors.box import Box

RADII = tuple(float(r) for r in range(-12, 31, 2))
H, W = 61, 83
WHOLE = Box(0, 0, H, W)


def surfaces(background):
    """Radii [H, W] of a background with upright wires in focus and a near card before it."""
    r = torch.full((H, W), background, dtype=torch.float64)
    r[:, 10::17] = 0.4
    r[20:31, 40:60] = -9.0
    return r


def drawn(some, signed_radius, aperture, parts, box=WHOLE):
    return draw(some, [before(signed_radius)], RADII, aperture, parts, box)


def before(radius, coverage=None):
    """A surface that may stand before lights."""
    coverage = torch.ones_like(radius) if coverage is None else coverage
    return SampleLayer(radius[None, :0], coverage[None], radius)


AT = [(30, 44), (0, 0), (60, 70), (28, 30), (3, 82), (29, 47)]


def test_nothing_shows_beside_a_disc_as_bright_as_the_sun():
    some = Highlights(torch.tensor([[30, 40]]), torch.tensor([[1e6]]), torch.tensor([20.0]))
    picture = drawn(some, torch.full((H, W), 20.0), Aperture(), [FULL])[0, 0]
    away = torch.hypot(torch.arange(H)[:, None] - 30.0, torch.arange(W) - 40.0)
    assert picture[away > 21].abs().max() <= 1e-10
    assert picture.sum() == pytest.approx(1e6, rel=1e-6)


def test_discs_have_the_gradient_of_the_kernel():
    scene = surfaces(26.0)
    weights = torch.rand(1, 3, H, W, generator=torch.Generator().manual_seed(0)).double()

    def total(radii, light):
        some = Highlights(torch.tensor(AT[:3]), light, radii)
        return (drawn(some, scene, Aperture(), [FULL]) * weights).sum()

    radii = torch.tensor([21.31, 9.17, 3.23], dtype=torch.float64, requires_grad=True)
    light = torch.rand(3, 3, generator=torch.Generator().manual_seed(1)).double()
    assert torch.autograd.gradcheck(total, (radii, light.requires_grad_()))


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_a_shadow_is_as_dark_as_its_surface_covers(share):
    """A wire one px wide that covers a share of its pixels; half of them are fringe samples."""
    radius = torch.full((H, W), 24.0, dtype=torch.float64)
    wire = torch.zeros(H, W, dtype=torch.bool)
    wire[:, 44] = True
    empty, whole = torch.zeros_like(radius), torch.ones_like(radius)
    front = torch.where(wire, 0.0, radius)
    own = before(front, torch.where(wire, share, whole))
    fringe = before(front, torch.where(wire, share, empty))
    behind = before(radius)
    some = Highlights(torch.tensor([[30, 40]]), radius.new_ones(1, 1), radius.new_tensor([24.0]))
    clear = draw(some, [behind], RADII, Aperture(), [FULL], WHOLE)[0, 0]
    for occluders in ([own], [behind, fringe]):
        picture = draw(some, occluders, RADII, Aperture(), [FULL], WHOLE)[0, 0]
        dimmed = 1 - picture[25:36, 30:51] / clear[25:36, 30:51]
        assert dimmed[:, 14].sub(share).abs().max() < 1e-12
        assert dimmed[:, :13].abs().max() < 1e-12  # nothing beside it


def test_the_shadow_of_a_slanted_wire_has_no_saw_teeth():
    """Its darkness changes from row to row no more than the coverage of the wire's own pixels."""
    y, x = torch.arange(H, dtype=torch.float64)[:, None], torch.arange(W, dtype=torch.float64)
    away = (x - 44.0 - 0.23 * (y - 30.0)).abs()
    front = torch.where(away < 1.5, -8.0, 24.0)
    share = (1.5 - away).clamp(0.0, 1.0)
    whole = torch.ones_like(front)
    wire = before(front, torch.where(away < 1.5, share, whole))
    behind = before(24 * whole)
    light = Highlights(torch.tensor([[30, 40]]), front.new_ones(1, 1), front.new_tensor([24.0]))
    clear, seen = (
        draw(light, [occluder], RADII, Aperture(), [FULL], WHOLE)[0, 0, 14:47]
        for occluder in (behind, wire)
    )
    width = (1 - seen / torch.where(clear > 0, clear, 1.0))[:, 25:60].sum(1)[4:-4]
    assert width.std() < 0.12 * width.mean()


@pytest.mark.parametrize(
    ("count", "radius", "alone"), [(50, 60.0, True), (500, 60.0, False), (500, 10.0, True)]
)
def test_discs_are_drawn_one_by_one_as_long_as_all_of_them_are_few_frames(count, radius, alone):
    light = torch.full((400, 500), 0.5)
    brightness = light.flatten()

    def limit(maximum):
        brightness[:count] = maximum
        survey = surveyed(light[None], torch.full_like(light, radius), light.dtype)
        return highlight_limit(survey)

    assert (limit(16.0) < 16.0) == alone
    assert limit(1600.0) < 1600.0, "the rounding noise of their transforms would be seen"

"""Noise of depth leaves no holes in surfaces in focus; what is shape stays as it is."""

import pytest
import torch
from measures import worst
from renderers import repair_of
from synthetic_scenes import scenery

from defocus_core import render
from defocus_core.depth.smoothing import without_noise

SIZE = (128, 192)


def scatter(amount, size=SIZE):
    """Noise of some standard deviation in px."""
    made = torch.Generator().manual_seed(3)
    return amount * torch.randn(size, generator=made, dtype=torch.float64)


def noise_of(radius):
    return repair_of(radius).noise


def card(radius=0.0, far=15.0):
    """Radii of a card of one radius before what is farther."""
    radii = torch.full(SIZE, far, dtype=torch.float64)
    radii[24:104, 40:152] = radius
    return radii


def slope():
    """Radii of a bent surface, at most 0.6 px per px."""
    y, x = (torch.arange(n, dtype=torch.float64) for n in SIZE)
    return 0.3 * x + 0.002 * (y[:, None] - 60) ** 2


def in_levels(radius, step):
    return (radius / step).round() * step


def scene(radius):
    """A card of one colour before ground of another."""
    image = torch.tensor([0.1, 0.3, 0.9]).reshape(3, 1, 1).repeat(1, *SIZE)
    image[:, radius < 5] = torch.tensor([0.8, 0.6, 0.2])[:, None]
    return image


@pytest.mark.parametrize("amount", [0.05, 0.1, 0.3, 0.6])
@pytest.mark.parametrize("shape", [card(), torch.zeros(SIZE), 0.1 * slope()])
def test_noise_is_measured_whatever_the_shape(shape, amount):
    found = noise_of(shape + scatter(amount))
    assert found == pytest.approx(amount, rel=0.25)


@pytest.mark.parametrize("amount", [0.2, 0.6])
@pytest.mark.parametrize("shape", [slope(), in_levels(slope(), 0.2)])
def test_noise_of_steep_surfaces_is_measured_where_it_is_more_than_their_steps(shape, amount):
    found = noise_of(shape + scatter(amount))
    assert found == pytest.approx(amount, rel=0.35)


def test_shapes_are_not_taken_for_noise():
    for kind in ("plane", "floor", "cards", "thin", "lights", "most"):
        assert noise_of(scenery(kind, *SIZE, 12.0).signed_radius) is None
    checkers = torch.ones(SIZE).cumsum(0).add(torch.ones(SIZE).cumsum(1)) % 2
    for shape in (
        slope(),
        in_levels(slope(), 0.2),
        20 * torch.rand(SIZE),  # what scatters as much as surfaces differ
        4 * checkers,
        slope()[:, :1],
        slope()[:1],
        torch.zeros(1, 1),
    ):
        assert noise_of(shape) is None


def test_a_noisy_part_of_a_frame_counts():
    noise = scatter(0.3)
    noise[:, 70:] = 0
    assert noise_of(card() + noise) == pytest.approx(0.3, rel=0.25)
    noise[:, 10:] = 0
    assert noise_of(card() + noise) is None


def test_noise_goes_and_edges_stay():
    clean = card()
    found = without_noise(clean + scatter(0.3), 0.3) - clean
    assert float(found.std()) < 0.3 / 4
    assert worst(without_noise(clean, 0.3), clean) == 0
    wire = torch.full(SIZE, 9.0)
    wire[:, 50:52] = 0.5
    assert worst(without_noise(wire, 0.3), wire) == 0


def test_no_pixel_stands_out_that_scatters_most():
    """One that did would be an edge, and what hides nothing would be looked behind."""
    found = without_noise(scatter(0.3, (600, 600)), 0.3)
    assert float(found.abs().max()) < 0.6


def test_slopes_stay():
    y, x = (torch.arange(n, dtype=torch.float64) for n in SIZE)
    plane = 0.4 * x - 0.2 * y[:, None]
    assert worst(without_noise(plane, 0.3), plane) < 1e-12
    assert worst(without_noise(slope(), 0.3), slope()) < 0.02


@pytest.mark.parametrize("quality", ["standard", "high"])
@pytest.mark.parametrize("amount", [0.1, 0.3, 0.5])
def test_a_noisy_card_in_focus_has_no_holes(quality, amount):
    """Up to half of the ground's colour was seen within it."""
    image, radius = scene(card()), card() + scatter(amount)
    found = render(image, radius, quality=quality).render
    inside = (..., slice(27, 101), slice(43, 149))
    assert worst(found[inside], image[inside]) < 0.06

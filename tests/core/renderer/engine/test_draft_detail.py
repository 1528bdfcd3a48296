"""Coarse pixels become pixels: nothing is lost, nothing rings, and detail in focus comes back."""

import pytest
import torch

from defocus_core.renderer.engine.drafts import (
    AROUND,
    NO_DETAIL,
    Original,
    doubled,
    fraction_left,
    left_of_detail,
    means,
    smooth,
    with_detail,
)
from defocus_core.renderer.layers.slice_radii import SHARP
from defocus_core.tensors.box import Box


def whole(coarse):
    return Box(0, 0, coarse.shape[-2], coarse.shape[-1])


def pixels_of(coarse):
    """All of them."""
    return doubled(coarse, whole(coarse))


def noise(*size):
    return torch.rand(size, generator=torch.Generator().manual_seed(5), dtype=torch.float64)


def test_means_of_pixels_are_their_cells():
    coarse = 0.5 + noise(2, 3, 9, 11) ** 8  # with contrasts that would ring
    assert torch.allclose(means(pixels_of(coarse)), coarse, atol=1e-14)


@pytest.mark.parametrize("power", [0, 1, 2, 3, 4])
def test_polynomials_of_fourth_order_stay_what_they_are(power):
    """Of a row or a column; means over pixels and over coarse pixels are exact integrals here."""
    x = torch.arange(-16, 17, dtype=torch.float64) / 16
    row = 3 + (x[1:] ** (power + 1) - x[:-1] ** (power + 1)) * 16 / (power + 1)
    px = row.expand(32, 32).clone()
    doubled_px = pixels_of(means(px)[None])[0]
    inner = slice(2 * AROUND, -2 * AROUND)
    assert torch.allclose(doubled_px[inner, inner], px[inner, inner], atol=1e-12)
    assert torch.allclose(pixels_of(means(px.T)[None])[0].T, doubled_px, atol=1e-15)


@pytest.mark.parametrize("low", [0.0, 0.4])
def test_beside_a_step_little_rings(low):
    """Nothing where contrast is high, a twelfth of the step where it is low."""
    coarse = torch.full((1, 12, 12), low, dtype=torch.float64)
    coarse[:, 3:9, 3:9] = 1.0
    px = pixels_of(coarse)
    assert float(px.min()) >= low * 0.9
    assert float(px.max()) <= 1.0 + 0.25 * low


def test_no_pixel_exceeds_the_brightest_that_the_picture_has():
    coarse = 0.5 + noise(2, 3, 9, 11) ** 8
    brightest = float(coarse.max())
    assert float(pixels_of(coarse).max()) > brightest + 1e-3
    bounded = doubled(coarse, whole(coarse), brightest)
    assert float(bounded.max()) <= brightest + 1e-14
    assert torch.allclose(means(bounded), coarse, atol=1e-14)


def test_a_part_is_a_part_of_the_whole():
    coarse = noise(3, 12, 9)
    px = pixels_of(coarse)
    assert torch.equal(doubled(coarse[:, 2:10, 1:9], Box(2, 2, 4, 4)), px[:, 8:16, 6:14])
    assert torch.equal(doubled(coarse[:, :7], Box(0, 0, 5, 9)), px[:, :10])
    some = smooth(coarse[None, :, 2:9], Box(2, 0, 4, 9))
    assert torch.equal(some, smooth(coarse[None], Box(4, 0, 4, 9)))


def test_a_disc_leaves_less_of_detail_the_larger_it_is():
    r = torch.tensor([0.0, SHARP, 0.5, 1.0, 1.5, 2.0, NO_DETAIL, 9.0], dtype=torch.float64)
    left = left_of_detail(r)
    assert left[:2].tolist() == [1.0, 1.0]
    assert left[-2:].tolist() == pytest.approx([0.0, 0.0], abs=1e-8)
    assert bool((left.diff()[1:-1] < 0).all())
    assert torch.equal(left_of_detail(-r), left)


def at(r, shown, copies=1):
    """Pixels at a radius, and what coarse pixels that show a share of them become."""
    pixels = 0.25 + 0.5 * noise(2, 12, 16)
    radius = torch.full((12, 16), r, dtype=torch.float64)
    coarse, share = means(pixels), fraction_left(radius)
    original = Original(coarse, share, pixels, radius)
    images = coarse.expand(copies, *coarse.shape)
    return pixels, with_detail(images, shown * share.expand(copies, 6, 8), original, whole(coarse))


def test_in_focus_and_in_full_view_a_pixel_is_as_it_was():
    pixels, pictures = at(0.1, 1.0, 3)
    for picture in pictures:
        assert torch.allclose(picture, pixels, atol=1e-15)


@pytest.mark.parametrize(("r", "shown"), [(0.0, 0.6), (1.0, 1.0), (1.5, 0.5)])
def test_detail_is_added_as_far_as_it_is_left_and_shown(r, shown):
    pixels, (picture,) = at(r, shown)
    own = pixels_of(means(pixels))
    share = shown * float(left_of_detail(torch.tensor(r)))
    assert torch.allclose(picture, own + share * (pixels - own), atol=2e-3)


@pytest.mark.parametrize("r", [0.5, 2.0, 2.4])
def test_what_is_all_but_in_full_view_looks_as_if_it_were(r):
    """A tile may be in full view and the next one nearly: there is no seam between them."""
    (pixels, (whole,)), (_, (nearly,)) = at(r, 1.0), at(r, 1 - 2e-5)
    assert torch.allclose(nearly, whole, atol=1e-5)
    left = float(left_of_detail(torch.tensor(r)))
    assert float((whole - pixels_of(means(pixels))).abs().amax()) > 0.1 * left


def test_beyond_reach_of_focus_cells_alone_are_shown():
    pixels, (picture,) = at(3.0, 1.0)
    assert torch.equal(picture, pixels_of(means(pixels)))


@pytest.mark.parametrize("r", [-1.0, 0.7])
def test_detail_is_shifted_apart_as_the_halves_are(r):
    """What lies beyond the focus moves to the left in the left image, and the mean stays."""
    x = torch.arange(64, dtype=torch.float64)
    pixels = (0.5 + 0.1 * torch.sin(0.3 * torch.pi * x)).expand(1, 12, 64)
    radius = torch.full((12, 64), r, dtype=torch.float64)
    share = fraction_left(radius)
    coarse = means(pixels)
    images, shown = coarse.expand(3, 1, 6, 32), share.expand(3, 6, 32)
    centre, left, right = with_detail(
        images, shown, Original(coarse, share, pixels, radius), whole(coarse)
    )
    assert torch.allclose((left + right) / 2, centre, atol=1e-15)
    wave = torch.exp(0.3j * torch.pi * x)[8:48]  # twelve half waves
    late = [(picture[0, 5, 8:48] * wave).sum().angle() for picture in (left, right)]
    assert float((late[1] - late[0]) * r) > 0.02

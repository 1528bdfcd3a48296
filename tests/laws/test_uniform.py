"""White, focus, one plane, energy, borders: laws of the shipped `render` against the oracles.

Pictures are waves of amplitude 0.4 and wavenumber k = 0.75 / px (`scenes.pattern`) in float64.
"""

import math

import pytest
import torch
from measures import inner, worst
from reference import both, left, one_plane, polygon, right, whole
from renderers import QUALITIES
from scenes import RADII, plane, white
from tolerances import OVERSAMPLING, WHITE

from defocus_core import Aperture, render

DISC, HEXAGON, PENTAGON = Aperture(), Aperture(6, 10.0), Aperture(5, 90.0)
PUPILS = {
    DISC: (whole, left, right),
    HEXAGON: tuple(both(polygon(6, 10.0), side) for side in (whole, left, right)),
    PENTAGON: tuple(both(polygon(5, 90.0), side) for side in (whole, left, right)),
}

# A pixel between two slice radii a < r < b keeps its second moment r²/4, not the fourth: a wave
# changes by 0.4 (b² - a²)² k⁴ / 768 at most, 6e-3 for slice radii 0.75 px apart. Below 2 px the
# pixel's own moment of 1/12 px², which a delta has not, comes and goes: 0.4 k² / 24.
BETWEEN_RUNGS = 1e-2
# A half's first moment is off by 8/3π (r - a)(b - r)/(a + b), 0.08 px of a slope 0.4 k from 0 to
# 0.75 px; where the frame cuts the aperture, so is the whole's.
BETWEEN_FIRST_RUNGS = 4e-2


@pytest.mark.parametrize("aperture", PUPILS, ids=str)
@pytest.mark.parametrize("kind", RADII)
def test_white_stays_white(kind, aperture):
    image, radius = (x.float() for x in white(kind))
    for quality in QUALITIES if aperture == HEXAGON else ("standard",):
        o = render(image, radius, aperture=aperture, quality=quality, left_right=True)
        for picture in o.images:
            assert worst(picture, 1.0) < WHITE


@pytest.mark.parametrize("quality", QUALITIES)
def test_in_focus_is_identity(quality):
    image, radius = plane(0.0)
    o = render(image, radius, quality=quality, left_right=True)
    if quality == "reference":  # sixteen parts sum up with rounding
        assert worst(o.render, image) < 1e-14
        assert worst(o.left, image) < 1e-14
    else:
        assert torch.equal(o.render, image)
        assert torch.equal(o.left, image)


def halves_of(image, r, aperture):
    """What each half sees of a plane, as shares of the picture that the whole aperture sees."""
    centre, one, other = (one_plane(image, r, pupil) for pupil in PUPILS[aperture])
    return 2 * centre * one / (one + other), 2 * centre * other / (one + other)


@pytest.mark.parametrize("aperture", PUPILS, ids=str)
@pytest.mark.parametrize("r", [0.3, 1.0, 2.3, -3.7, -11.0, 21.0])
def test_one_slice_is_one_convolution_of_a_scene_that_goes_on(r, aperture):
    """With one slice there are no slices between which to stand: borders, halves, everything."""
    image, radius = plane(r)
    quality = "standard" if abs(r) < 20 else "reference"  # full resolution
    o = render(image, radius, aperture=aperture, num_layers=1, left_right=True, quality=quality)
    assert worst(o.render, one_plane(image, r, PUPILS[aperture][0])) < OVERSAMPLING
    for picture, half in zip((o.left, o.right), halves_of(image, r, aperture), strict=True):
        assert worst(picture, half) < OVERSAMPLING


@pytest.mark.parametrize("aperture", PUPILS, ids=str)
@pytest.mark.parametrize("r", [0.6, 1.0, 1.5, 2.3, -3.7, 5.0, 11.0])
def test_one_plane_is_one_convolution(r, aperture):
    """On the slice radii as well, up to the border."""
    image, radius = plane(r)
    border = math.ceil(1.2 * abs(r)) + 1  # a slice radius above r
    o = render(image, radius, aperture=aperture, left_right=True)
    error = o.render - one_plane(image, r, PUPILS[aperture][0])
    assert worst(inner(error, border), 0.0) < BETWEEN_RUNGS
    tolerance = BETWEEN_RUNGS if abs(r) > 2 else BETWEEN_FIRST_RUNGS
    assert worst(error, 0.0) < tolerance
    for picture, half in zip((o.left, o.right), halves_of(image, r, aperture), strict=True):
        assert worst(picture, half) < 2 * tolerance


@pytest.mark.parametrize("quality", QUALITIES)
def test_an_odd_polygon_is_one_pupil_at_every_quality(quality):
    """Parts count by their area: a triangle's halves are not equal."""
    image, radius = plane(9.0)
    triangle = Aperture(3)
    fine = render(image, radius, aperture=triangle, quality="standard").render
    seen = render(image, radius, aperture=triangle, quality=quality).render
    # other slice radii, coarse pixels of two px
    assert worst(inner(seen, 12), inner(fine, 12)) < 7e-3


@pytest.mark.parametrize("edges", [False, True])
def test_what_is_in_focus_is_copied_wherever_it_is(edges):
    """Region by region, to the last bit, also beside a blurred part and in every output."""
    image = torch.rand(3, 300, 1500, generator=torch.Generator().manual_seed(8))
    radius = torch.full((300, 1500), 0.1)
    radius[:, :500] = torch.linspace(5.0, 0.1, 500)
    if edges:
        radius[:, :300] = -6.0
    with torch.no_grad():
        seen = render(image, radius, left_right=True)
    for picture in seen.images:
        assert torch.equal(picture[..., 900:], image[..., 900:])
    assert (seen.trust[..., 900:] == 1).all()
    assert 0 < seen.stats["pixels_copied"] < image[0].numel()


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("slope", [0.02, 0.05, 0.1])
def test_a_light_on_a_slope_keeps_its_light(slope, quality):
    """A slope magnifies on one side of the aperture by what it takes away on the other."""
    ground = torch.full((3, 120, 140), 0.3, dtype=torch.float64)
    radius = (slope * (torch.arange(140.0) - 70) + 6).expand(120, 140).double().contiguous()
    lit = ground.clone()
    lit[:, 60, 70] = 7e4
    light = (render(lit, radius, quality=quality).render - ground).sum((-2, -1)) / (7e4 - 0.3)
    assert worst(light, torch.ones(3, dtype=torch.float64)) < 1.5e-3

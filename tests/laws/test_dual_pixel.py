"""Left and right: they are halves of one picture, and lie where physics.md says."""

import math

import pytest
import torch
from measures import centroid, worst
from reference import both, kernel, left, polygon, right
from renderers import QUALITIES
from scenes import RADII, pattern

from defocus_core import Aperture, render

APERTURES = [Aperture(), Aperture(6, 10.0), Aperture(5, 0.0), Aperture(psf_type="gaussian")]


def point(r, aperture=None):
    """Left and right picture of one bright pixel in a frame wide enough to hold all of it."""
    n = 2 * math.ceil(2.4 * abs(r)) + 9
    image = torch.zeros(1, n, n, dtype=torch.float64)
    image[:, n // 2, n // 2] = 1.0
    radius = torch.full((n, n), r, dtype=torch.float64)
    o = render(image, radius, aperture=aperture, left_right=True)
    return o.left, o.right


@pytest.mark.parametrize(
    ("quality", "aperture"),
    [*(("standard", each) for each in APERTURES), *((q, APERTURES[2]) for q in QUALITIES[1:])],
)
@pytest.mark.parametrize("kind", RADII)
def test_left_and_right_together_are_the_centre(kind, aperture, quality):
    image, radius = pattern().float(), RADII[kind]().float()
    o = render(image, radius, aperture=aperture, quality=quality, left_right=True)
    share = float(aperture.fraction(aperture.parts(2)[0]))  # of an asymmetric pupil not a half
    assert worst(share * o.left + (1 - share) * o.right, o.render) < 1e-6


@pytest.mark.parametrize("r", [8.0, -9.4, 13.0, -20.0, 31.5])
def test_the_halves_are_8_r_over_3_pi_apart(r):
    one, other = (centroid(picture)[0] for picture in point(r))
    assert other - one == pytest.approx(8 * r / (3 * math.pi), rel=0.01)


@pytest.mark.parametrize("rotation", [0.0, 90.0, 20.0])
@pytest.mark.parametrize("r", [12.0, -12.0])
def test_the_halves_of_a_pentagon_are_those_of_the_pentagon(r, rotation):
    """Also where their areas differ: each half is normalised, their mean is by their areas."""
    pentagon = Aperture(5, rotation)
    pictures = point(r, pentagon)
    for picture, side in zip(pictures, (left, right), strict=True):
        psf = kernel(r, both(polygon(5, rotation), side))[None]
        # between two slice radii the first moment is off by (r - a)(b - r) / (a + b), below 0.4 %
        assert centroid(picture) == pytest.approx(centroid(psf), abs=0.004 * abs(r))
        assert float(picture.sum()) == pytest.approx(1, rel=1e-6)

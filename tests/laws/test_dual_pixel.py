"""Left and right: they are halves of one picture, and lie where physics.md says."""

import math
from collections.abc import Callable

import pytest
import torch
from measures import centroid, worst
from reference import both, kernel, left, polygon, right, whole
from scenes import RADII, Scene, blurred_card, pattern, slanted_waves
from torch import Tensor

from defocus_core import QUALITIES, Aperture, render
from defocus_core.optics.parts import LEFT

APERTURES = [Aperture(), Aperture(6, 10.0), Aperture(5, 0.0), Aperture(psf_type="gaussian")]


def point(r: float, aperture: Aperture | None = None) -> tuple[Tensor, Tensor]:
    """Left and right picture of one bright pixel in a frame wide enough to hold all of it."""
    n = 2 * math.ceil(2.4 * abs(r)) + 9
    image = torch.zeros(1, n, n, dtype=torch.float64)
    image[:, n // 2, n // 2] = 1.0
    radius = torch.full((n, n), r, dtype=torch.float64)
    o = render(image, radius, aperture=aperture, left_right=True)
    assert o.left is not None
    assert o.right is not None
    return o.left, o.right


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("aperture", APERTURES, ids=str)
@pytest.mark.parametrize("kind", RADII)
def test_left_and_right_together_are_the_centre(
    kind: str, aperture: Aperture, quality: str
) -> None:
    image, radius = pattern().float(), RADII[kind]().float()
    o = render(image, radius, aperture=aperture, quality=quality, left_right=True)
    assert o.left is not None
    assert o.right is not None
    share = float(aperture.fraction(LEFT))  # of an asymmetric pupil not a half
    assert worst(share * o.left + (1 - share) * o.right, o.render) < 1e-6


@pytest.mark.parametrize("scene", [slanted_waves, blurred_card])
def test_whether_they_are_asked_for_changes_no_byte_of_the_centre(
    scene: Callable[[], Scene],
) -> None:
    image, radius = scene()
    alone = render(image, radius)
    assert alone.left is None
    assert alone.right is None
    assert torch.equal(alone.render, render(image, radius, left_right=True).render)


def test_large_radii_change_no_byte_of_the_centre_either() -> None:
    """Sizes and radii at which a batch of three was once rounded otherwise than one alone."""
    generator = torch.Generator().manual_seed(0)
    for _ in range(8):
        size = tuple(torch.randint(8, 70, (2,), generator=generator).tolist())
        image = torch.rand(3, *size, generator=generator)
        radius = 60 * (torch.rand(size, generator=generator) - 0.5)
        alone = render(image, radius).render
        assert torch.equal(alone, render(image, radius, left_right=True).render)


def test_beyond_focus_lies_left_in_the_left_picture_and_nearer_lies_right() -> None:
    beyond, nearer = point(9.0), point(-9.0)
    for i, side in ((0, -1), (1, 1)):
        assert centroid(beyond[i])[0] * side > 0
        assert centroid(nearer[i])[0] * side < 0
        assert centroid(beyond[i])[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("r", [8.0, -9.4, 13.0, -20.0, 31.5])
def test_the_halves_are_8_r_over_3_pi_apart(r: float) -> None:
    one, other = (centroid(picture)[0] for picture in point(r))
    assert other - one == pytest.approx(8 * r / (3 * math.pi), rel=0.01)


@pytest.mark.parametrize("r", [4.0, -4.1, 5.0, -6.6])
def test_near_focus_the_halves_are_as_far_apart_as_pixels_can_show(r: float) -> None:
    """The column that the axis cuts in two shows each half 1/4 px off, 2.4 % of all at r = 4."""
    one, other = (centroid(picture)[0] for picture in point(r))
    one_shown, other_shown = (centroid(kernel(r, side)[None])[0] for side in (left, right))
    assert other - one == pytest.approx(other_shown - one_shown, rel=0.01)


@pytest.mark.parametrize("rotation", [0.0, 90.0, 20.0])
@pytest.mark.parametrize("r", [12.0, -12.0])
def test_the_halves_of_a_pentagon_are_those_of_the_pentagon(r: float, rotation: float) -> None:
    """Also where their areas differ: each half is normalised, their mean is by their areas."""
    pentagon = Aperture(5, rotation)
    pictures = point(r, pentagon)
    for picture, side in zip(pictures, (left, right), strict=True):
        psf = kernel(r, both(polygon(5, rotation), side))[None]
        # between two slice radii the first moment is off by (r - a)(b - r) / (a + b), below 0.4 %
        assert centroid(picture) == pytest.approx(centroid(psf), abs=0.004 * abs(r))
        assert float(picture.sum()) == pytest.approx(1, rel=1e-6)


def test_the_pentagon_stands_upright_beyond_focus_and_on_its_head_nearer() -> None:
    aperture = Aperture(3, 90.0)
    for r, tip in ((9.0, -1), (-9.0, 1)):
        one, other = point(r, aperture)
        rows = ((one + other)[0].sum(1) > 1e-3).nonzero().flatten() - one.shape[-2] // 2
        assert int(rows[0] if tip < 0 else rows[-1]) * tip >= 9
        assert int(rows[-1] if tip < 0 else rows[0]) * -tip <= 6


def test_nothing_moves_in_focus() -> None:
    one, other = point(0.0)
    assert torch.equal(one, other)
    assert kernel(0.0, whole).sum() == one.sum() == 1.0

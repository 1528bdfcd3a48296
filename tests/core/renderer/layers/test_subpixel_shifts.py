"""Near focus the halves are as far apart as the formula says, within a pixel too."""

import math

import pytest
import torch

from defocus_core import Aperture, render

SIZE = (24, 96)
PERIOD = 16  # px, of the waves


def wave(size):
    """A grey wave along x in [0.5, 1.5], with a crest at the first column: [1, H, W]."""
    x = torch.arange(size[1], dtype=torch.float64)
    return (1 + 0.5 * torch.cos(2 * math.pi * x / PERIOD)).expand(1, *size).clone()


def shift(picture):
    """Px by which a wave [1, H, W] stands to the right, within half of its length."""
    rows = picture[0, picture.shape[1] // 2, PERIOD:-PERIOD]
    rows = rows[: len(rows) // PERIOD * PERIOD]  # whole waves
    angle = 2 * math.pi * torch.arange(len(rows), dtype=rows.dtype) / PERIOD
    phase = math.atan2(float(rows @ angle.sin()), float(rows @ angle.cos()))
    return phase * PERIOD / (2 * math.pi)


def expected(r):
    """Px between waves seen through two half discs: near 8 r / (3π), and less for large radii."""
    u = (torch.arange(2000, dtype=torch.float64) + 0.5) / 2000
    weight, angle = (1 - u * u).sqrt(), 2 * math.pi * r * u / PERIOD
    phase = math.atan2(float(weight @ angle.sin()), float(weight @ angle.cos()))
    return 2 * phase * PERIOD / math.tau


@pytest.mark.parametrize("quality", ["standard", "high", "reference"])
@pytest.mark.parametrize("r", [-1.7, -0.9, -0.4, 0.0, 0.3, 0.5, 0.75, 1.0, 1.5, 1.9, 3.3, 5.0])
def test_halves_are_as_far_apart_as_their_centroids(r, quality):
    image = wave(SIZE)
    radius = torch.full(image.shape[1:], r, dtype=torch.float64)
    o = render(image, radius, quality=quality, left_right=True)
    apart = shift(o.right) - shift(o.left)
    few = 0.01 if abs(r) <= 1 else 0.065  # px
    assert apart == pytest.approx(expected(r), abs=few)
    assert expected(r) == pytest.approx(8 * r / (3 * math.pi), rel=0.03)
    assert torch.allclose((o.left + o.right) / 2, o.render)


def test_polygons_shift_by_their_own_centroids():
    """A hexagon with vertices at ±x: its right half reaches from the middle to 7/18 on average."""
    image, r = wave(SIZE), 0.6
    radius = torch.full(image.shape[1:], r, dtype=torch.float64)
    o = render(image, radius, aperture=Aperture(blades=6), left_right=True)
    assert shift(o.right) - shift(o.left) == pytest.approx(2 * r * 7 / 18, abs=0.04)


def test_what_counts_as_in_focus_is_not_shifted():
    """And beyond it shifts begin without a step."""
    image = wave(SIZE)
    found = []
    for r in (0.14, 0.151, 0.24, 0.26):
        o = render(image, torch.full(image.shape[1:], r, dtype=torch.float64), left_right=True)
        found.append(shift(o.right) - shift(o.left))
    assert found[0] == 0
    assert found[1] == pytest.approx(0, abs=0.01)
    assert found[3] - found[2] < 0.05


def test_colours_of_another_surface_have_no_part_in_a_shift():
    """Two cards side by side, white and black: neither gets the other's colour within itself."""
    image = torch.zeros(1, 24, 40, dtype=torch.float64)
    image[..., 20:] = 1
    radius = torch.full(image.shape[1:], 0.6, dtype=torch.float64)
    apart = torch.where(image[0] > 0, -0.6, radius)
    one, two = (render(image, r, left_right=True) for r in (radius, apart))
    assert one.left is not None
    assert two.left is not None
    moved = [(o.left - o.render).abs().amax() for o in (one, two) if o.left is not None]
    assert float(moved[0]) > 1.5 * float(moved[1])


def test_shifts_of_less_than_a_pixel_have_gradients():
    image = wave((8, 32)).requires_grad_()
    radius = torch.full(image.shape[1:], 0.4, dtype=torch.float64, requires_grad=True)

    def left(image, radius):
        found = render(image, radius, left_right=True).left
        assert found is not None
        return found

    assert torch.autograd.gradcheck(left, (image, radius), fast_mode=True)

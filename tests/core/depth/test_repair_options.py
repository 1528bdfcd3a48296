"""Who knows how soft the edges of a depth map are can say so; the record says what was done."""

import pytest
import torch

from defocus_core import render, repair_depth

SIZE = (160, 200)
NEAR, FAR = -6.0, 10.0


def softened(width):
    """A red surface before a green one, whose edge in depth is a ramp of so many px."""
    x = torch.arange(SIZE[1], dtype=torch.float64) + 0.5 - SIZE[1] / 2
    image = torch.where(x < 0, 0.7, 0.1).expand(3, *SIZE).clone()
    image[1] = 0.8 - image[1]
    return image, (NEAR + (FAR - NEAR) * (x / width + 0.5).clamp(0, 1)).expand(SIZE).clone()


def repaired_by(width, edge_width=None):
    image, radius = softened(width)
    return repair_depth(radius, image, edge_width=edge_width)[0]


def is_a_step(radius):
    return bool(((radius == NEAR) | (radius == FAR)).all())


@pytest.mark.parametrize("width", [24, 30, 40])
def test_wider_ramps_are_edges_if_that_is_their_width(width):
    assert not is_a_step(repaired_by(width))
    assert is_a_step(repaired_by(width, edge_width=float(width)))
    assert not is_a_step(repaired_by(width, edge_width=width - 6.0))


def test_no_ramp_is_an_edge_if_edges_are_hard():
    _, radius = softened(6)
    assert is_a_step(repaired_by(6))
    assert torch.equal(repaired_by(6, edge_width=0.0), radius)


def test_render_takes_the_width():
    image, radius = softened(24)
    pictures = [render(image, radius, edge_width=width).render for width in (None, 24.0)]
    assert not torch.equal(*pictures)

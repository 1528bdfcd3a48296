"""Soft edges of depth become steps; surfaces and hard edges stay as they are."""

import pytest
import torch
from measures import inner, worst
from scenes import RADII, pattern
from torch import Tensor

from defocus_core import render
from defocus_core.depth.soft_edges import without_ramps

SIZE = (40, 60)


def soft_edge(width: int, near: float = -8.0, far: float = 9.0) -> Tensor:
    """Radius that ramps from near to far over `width` px in the middle."""
    x = torch.arange(SIZE[1], dtype=torch.float64) - SIZE[1] // 2
    share = (x / width + 0.5).clamp(0, 1)
    return (near + (far - near) * share).expand(SIZE).clone()


@pytest.mark.parametrize("width", [2, 3, 5, 8, 10])
@pytest.mark.parametrize("turned", [False, True])
def test_a_soft_edge_becomes_a_step_in_its_middle(width: int, turned: bool) -> None:
    radius = soft_edge(width)
    found = without_ramps(radius.T if turned else radius)
    found = found.T if turned else found
    assert bool(((found == -8.0) | (found == 9.0)).all())
    assert (found[0] == -8.0).sum() == pytest.approx(SIZE[1] / 2, abs=1)


@pytest.mark.parametrize("kind", [kind for kind in RADII if kind != "random"])
def test_surfaces_and_hard_edges_stay(kind: str) -> None:
    radius = RADII[kind](SIZE)
    assert without_ramps(radius) is radius


def test_a_steep_surface_up_to_an_edge_stays() -> None:
    """A slope of 1.4 px per px that ends before a wall: steep on one side only."""
    radius = torch.full(SIZE, 20.0, dtype=torch.float64)
    radius[:, :30] = 1.4 * torch.arange(30, dtype=torch.float64) - 30
    assert torch.equal(without_ramps(radius), radius)


def test_no_sharp_line_where_a_soft_edge_crosses_the_focus() -> None:
    """What is drawn is nowhere sharper than both surfaces are."""
    image = pattern(SIZE, period=3.0)
    soft = render(image, soft_edge(6)).render
    hard = render(image, soft_edge(1)).render
    middle = slice(SIZE[1] // 2 - 4, SIZE[1] // 2 + 4)
    contrast = inner(soft[..., middle], 0).diff(dim=-1).abs().amax()
    assert contrast < 2 * inner(hard[..., middle], 0).diff(dim=-1).abs().amax() + 1e-3
    assert contrast < image.diff(dim=-1).abs().amax() / 4


def test_mirrored_ramps_are_mirrored() -> None:
    radius = soft_edge(7) + 0.01 * torch.arange(SIZE[0], dtype=torch.float64)[:, None]
    for dim in (-1, -2):
        assert worst(without_ramps(radius.flip(dim)).flip(dim), without_ramps(radius)) == 0

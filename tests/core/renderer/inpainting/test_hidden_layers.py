"""Hidden content: only behind depth edges, from the farther side, mirrored with the frame."""

import pytest
import torch
from measures import worst
from scenes import RADII, card_layers, flatten, pattern, slanted
from tolerances import ROUNDING

from defocus_core.renderer.inpainting.hidden_layers import hidden_layer

SIZE = (40, 56)
EXACT = ROUNDING[torch.float64]


def card(card_r=-5.0, background_r=4.0):
    """A red card before green."""
    layers = card_layers(card_r, background_r)
    red, green = (torch.tensor(c, dtype=torch.float64)[:, None, None] for c in ([1, 0], [0, 1]))
    front = layers[0]._replace(color=red * layers[0].alpha)
    back = layers[1]._replace(color=green * layers[1].alpha)
    return flatten([front, back], SIZE)


def test_a_slope_hides_nothing():
    """With |∇r| < 1 each lens point sees every point of the surface."""
    x = torch.arange(56, dtype=torch.float64).expand(SIZE)
    for radius in (slanted(SIZE), 0.95 * x - 20, 6 * torch.sin(x / 6.5)):
        assert hidden_layer(pattern(SIZE), radius) is None


@pytest.mark.parametrize(("card_r", "background_r"), [(-5.0, 4.0), (-7.0, 0.0), (3.0, 9.0)])
def test_hidden_is_only_what_lies_behind_the_rim_of_a_card(card_r, background_r):
    _, radius = card(card_r, background_r)
    found = hidden_layer(*card(card_r, background_r))
    mask = found.mask
    behind = radius == card_r
    assert mask.any()
    assert not (mask & ~behind).any()
    row = behind.shape[0] // 2
    depth = int(mask[row, : behind.shape[1] // 2].sum())
    # as far as the aperture sees past the edge, and the shares of a diagonal and of two pixels more
    assert background_r - card_r - 2 <= depth <= 1.5 * (background_r - card_r) + 4


def test_hidden_content_comes_from_the_farther_side():
    found = hidden_layer(*card())
    assert worst(found.color[:, found.mask], torch.tensor([[0.0], [1.0]])) < EXACT
    assert worst(found.signed_radius[found.mask], 4.0) < EXACT


def test_a_surface_that_rises_towards_an_edge_is_not_behind_itself():
    """The top of a box joins its front: behind both is the wall, beyond the edge."""
    wall, top = 24, 11
    y = torch.arange(64, dtype=torch.float64)[:, None].expand(64, 56)
    box = (-23 + 0.9 * (wall + top - y)).clamp(min=-23)
    found = hidden_layer((y >= wall).to(y)[None], torch.where(y < wall, 20.0, box))
    close = found.mask & (y < wall + top + 12)
    assert close[wall + top :].any()
    assert worst(found.color[0, close], 0.0) < EXACT
    assert worst(found.signed_radius[close], 20.0) < EXACT


@pytest.mark.parametrize("edge", range(16, 24))
def test_beside_an_edge_hidden_content_is_as_what_is_next_to_it(edge):
    """Wherever in the frame it is: coarse pixels of a coarser resolution do not show."""
    x = torch.arange(56, dtype=torch.float64).expand(SIZE)
    image = ((x >= edge - 2) & (x < edge)).to(x)
    found = hidden_layer(image[None], torch.where(x < edge, 6.0, -6.0).to(x))
    assert float(found.color[0, :, edge].min()) > 0.7


@pytest.mark.parametrize("kind", ["steps", "checkerboard", "random"])
def test_white_hides_white_and_what_is_hidden_is_farther(kind):
    radius = RADII[kind](SIZE)
    found = hidden_layer(torch.ones(1, *SIZE, dtype=torch.float64), radius)
    assert found.mask.any()
    assert worst(found.color[:, found.mask], 1.0) < EXACT
    assert bool((found.signed_radius > radius)[found.mask].all())


@pytest.mark.parametrize("axis", [-1, -2])
@pytest.mark.parametrize("size", [(40, 56), (41, 57)])
def test_a_mirrored_frame_hides_the_mirrored(size, axis):
    image, radius = pattern(size), RADII["steps"](size)
    one = hidden_layer(image, radius)
    other = hidden_layer(image.flip(axis), radius.flip(axis))
    assert torch.equal(one.mask, other.mask.flip(axis))
    assert worst(one.color * one.mask, (other.color * other.mask).flip(axis)) < EXACT

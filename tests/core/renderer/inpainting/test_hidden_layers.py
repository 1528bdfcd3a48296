"""Hidden content: only behind depth edges, from the farther side, mirrored with the frame."""

import pytest
import torch
from measures import worst
from tolerances import ROUNDING

from defocus_core.renderer.inpainting.hidden_layers import hidden_layer

SIZE = (40, 56)
EXACT = ROUNDING[torch.float64]


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

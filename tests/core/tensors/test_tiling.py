"""The grid covers every pixel once, and each tile knows all slices that reach it."""

import pytest
import torch

from defocus_core.renderer.layers.sliced_surface import blocks_of, visible_slices
from defocus_core.tensors.box import TILE, grid_over


@pytest.mark.parametrize("size", [(1, 1), (128, 128), (129, 300), (40, 1000)])
def test_tiles_cover_every_pixel_once(size):
    seen = torch.zeros(size)
    for box in grid_over(*size).tiles:
        assert max(box.height, box.width) <= TILE
        seen[box.top : box.top + box.height, box.left : box.left + box.width] += 1
    assert bool((seen == 1).all())


@pytest.mark.parametrize("place", [(0, 0), (63, 64), (99, 149), (31, 70)])
def test_a_tile_knows_a_slice_exactly_as_far_as_it_reaches(place):
    """To a block: none is forgotten, none from farther than 16 px beyond its reach is kept."""
    places = torch.zeros(100, 150)
    places[place] = 1.0
    grid, reaches = grid_over(100, 150, side=32).tiles, [0, 20]
    blocks = blocks_of(places, 2)
    for box, plan in zip(grid, visible_slices(blocks, reaches, grid), strict=True):
        down = max(box.top - place[0], place[0] - box.top - box.height + 1, 0)
        across = max(box.left - place[1], place[1] - box.left - box.width + 1, 0)
        assert 0 in plan
        if max(down, across) <= 20:
            assert 1 in plan
        if max(down, across) > 36:
            assert 1 not in plan

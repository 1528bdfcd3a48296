"""What a tile sees of a layer is blurred in a rectangle: all of it, and nothing wraps around."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from defocus_core.renderer.layers.sliced_surface import patches
from defocus_core.tensors.box import BLOCK, Box, Span, grid_over, min_transform

SIZE = (70, 110)


@st.composite
def layers(draw):
    """[H, W] bool, a few pixels."""
    layer = torch.zeros(SIZE, dtype=torch.bool)
    for _ in range(draw(st.integers(0, 4))):
        layer[draw(st.integers(0, SIZE[0] - 1)), draw(st.integers(0, SIZE[1] - 1))] = True
    return layer


def blocks(layer):
    down, across = (-n % BLOCK for n in layer.shape)
    wide = torch.nn.functional.pad(layer, (0, across, 0, down))
    return wide.unflatten(0, (-1, BLOCK)).unflatten(2, (-1, BLOCK)).any(3).any(1)


@given(layer=layers(), margin=st.integers(0, 40))
def test_all_that_reaches_a_tile_is_in_its_patch(layer, margin):
    """And all that it shows: at most a block more than a pixel and its reach need."""
    tiles = grid_over(*SIZE, side=32).tiles
    (found,) = patches(blocks(layer)[None], tiles, [margin], SIZE)
    for tile, patch in zip(tiles, found, strict=True):
        near = tile.grown(margin, Box(0, 0, *SIZE))
        rows, columns = torch.nonzero(near.of(layer)).unbind(1)
        if patch is None:
            assert not len(rows)
            continue
        assert patch.shown == patch.shown.grown(0, tile)
        for y, x in zip((rows + near.top).tolist(), (columns + near.left).tolist(), strict=True):
            pixel = Box(y, x, 1, 1)
            assert pixel == pixel.grown(0, patch.lit)
            shown = pixel.around(margin).grown(0, tile)
            assert shown == shown.grown(0, patch.shown)
        if int(layer.sum()) == 1:
            assert max(patch.lit.height, patch.lit.width) <= BLOCK
        maximum = (tile.height + 2 * margin, tile.width + 2 * margin)
        assert all(n <= m for n, m in zip(patch.minimum, maximum, strict=True))


@given(
    lit=st.integers(0, 60),
    length=st.integers(1, 60),
    margin=st.integers(0, 30),
    start=st.integers(-40, 60),
    size=st.integers(1, 60),
)
def test_what_wraps_around_falls_outside(lit, length, margin, start, size):
    source = Span(lit, lit + length)
    seen = source.grown(margin).within(Span(start, start + size))
    if seen.length <= 0:
        return
    n = min_transform(source, seen, margin)
    for i in range(*source):
        for x in range(*seen):
            distance = (x - i) % n
            reached = min(distance, n - distance) <= margin
            assert reached == (abs(x - i) <= margin)


@pytest.mark.parametrize("maximum", [(96, 128), (48, 64)])
def test_a_transform_lies_within_that_of_the_tile(maximum):
    layer = torch.zeros(SIZE, dtype=torch.bool)
    layer[60:, 100:] = True
    tile, margin = Box(32, 64, maximum[0] - 16, maximum[1] - 16), 8
    ((patch,),) = patches(blocks(layer)[None], [tile], [margin], SIZE)
    for size in (maximum, patch.minimum):
        box = patch.transformed(size, tile, maximum)
        whole = Box(tile.top - margin, tile.left - margin, *maximum)
        assert box == box.grown(0, whole)
        assert patch.lit == patch.lit.grown(0, box)
        assert patch.shown == patch.shown.grown(0, box)

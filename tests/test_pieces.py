"""What a continuation computes at once: every pixel within it, and no more than blocks would be."""

import pytest
import torch

from defocus_core.halving import axes
from defocus_core.pieces import Piece, alike, pieces

LEVEL = 2


def asked(count: int, size: tuple[int, int], seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.stack([torch.randint(n, (count,), generator=generator) for n in size], 1)


@pytest.mark.parametrize("size", [(640, 900), (641, 901), (40, 900), (20, 30)])
@pytest.mark.parametrize("count", [3, 400])
def test_each_pixel_has_what_its_values_come_from_around_it(
    size: tuple[int, int], count: int
) -> None:
    at, middle = asked(count, size, 1), axes(size)
    which = torch.arange(count) % 3
    found, of = pieces(at, which, 3, size, middle, LEVEL)
    assert len(found) == int(of.max()) + 1
    for (y, x), number, border in zip(at.tolist(), of.tolist(), which.tolist(), strict=True):
        piece = found[number]
        assert piece.border == border
        corner, extent = piece.corner(middle, LEVEL), piece.size(middle, LEVEL)
        for place, start, length, n in zip((y, x), corner, extent, size, strict=True):
            before, after = place - start, start + length - 1 - place
            assert before >= min(3 << LEVEL, place + 1)
            assert after >= min(3 << LEVEL, n - place)


def test_many_in_one_place_are_one_rectangle_and_few_far_apart_are_blocks() -> None:
    size = (4000, 4000)
    close = asked(500, (300, 300), 2) + 1000
    one, _ = pieces(close, torch.zeros(500, dtype=torch.long), 1, size, axes(size), LEVEL)
    assert len(one) == 1
    apart = torch.tensor([[100, 100], [3800, 100], [100, 3800], [3800, 3800]])
    four, _ = pieces(apart, torch.zeros(4, dtype=torch.long), 1, size, axes(size), LEVEL)
    assert len(four) == 4
    assert {piece.cells for piece in four} == {(14, 14)}


def test_a_rectangle_does_not_leave_the_frame_by_more_than_a_cell() -> None:
    size = (50, 70)
    at = torch.tensor([[0, 0], [49, 69]])
    (piece,), _ = pieces(at, torch.zeros(2, dtype=torch.long), 1, size, axes(size), LEVEL)
    (y, x), (height, width) = piece.corner(axes(size), LEVEL), piece.size(axes(size), LEVEL)
    assert min(y, x) >= -8
    assert y + height <= 50 + 8
    assert x + width <= 70 + 8


def test_only_pieces_of_one_size_are_computed_together() -> None:
    cells = [(4, 4), (4, 4), (5, 4), (4, 4)]
    some = [Piece((0, 0), size, n) for n, size in enumerate(cells)]
    batches = [some[part] for part in alike(some, LEVEL)]
    assert [len(batch) for batch in batches] == [2, 1, 1]
    assert [len(some[part]) for part in alike(some[:2], 8)] == [1, 1]

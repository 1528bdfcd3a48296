"""Half resolution: mirrored with the frame, and of an edge only what lies beyond it."""

import pytest
import torch
from measures import worst
from scenes import pattern

from defocus_core.halving import axes, farther


@pytest.mark.parametrize("size", [(12, 20), (13, 20), (12, 21), (13, 21)])
def test_mirrored_pictures_halve_to_mirrored_ones(size: tuple[int, int]) -> None:
    image = pattern(size)
    radius = 9 * torch.rand(size, dtype=torch.float64, generator=torch.manual_seed(1))
    half, whole = farther([image, radius[None]], radius, axes(size), 1.0)
    for dims in ((-1,), (-2,), (-2, -1)):
        mirrored = [image.flip(dims), radius.flip(dims)[None]]
        other, other_whole = farther(mirrored, radius.flip(dims), axes(size), 1.0)
        assert worst(other.values.flip(dims), half.values) < 1e-12
        assert torch.equal(other.rank.flip(dims), half.rank)
        assert torch.equal(other_whole.flip(dims), whole)


@pytest.mark.parametrize("edge", range(6, 12))
def test_cells_on_an_edge_show_what_lies_beyond(edge: int) -> None:
    x = torch.arange(20, dtype=torch.float64).expand(12, 20)
    near, color = x < edge, torch.where(x < edge, 0.2, 0.7)
    radius = torch.where(near, -5.0, 4.0).to(x)
    half, whole = farther([color[None], radius[None]], radius, axes((12, 20)), 1.0)
    assert torch.equal(half.rank, half.values[1])
    assert worst(half.values[0], torch.where(half.rank < 0, 0.2, 0.7)) < 1e-12
    assert int((half.rank[0] < 0).sum()) == edge // 2
    assert int((~whole[0]).sum()) == edge % 2


def test_one_surface_halves_to_its_means() -> None:
    image = pattern((8, 12))
    radius = torch.full((8, 12), 3.0, dtype=torch.float64)
    half, whole = farther([image], radius, axes((8, 12)), 1.0)
    assert worst(half.values, torch.nn.functional.avg_pool2d(image, 2)) < 1e-12
    assert whole.all()

"""Surfaces seen coarsely: mirrored with the frame, and of an edge both, apart."""

import pytest
import torch
from measures import worst
from scenes import pattern

from defocus_core.renderer.inpainting.two_layer_pyramid import coarser, pixels_of, stacked
from defocus_core.tensors.pyramid import axes


def levels(image, radius, count, weight=None):
    """A picture and its radii, halved some times."""
    size = (radius.shape[0], radius.shape[1])
    found = [pixels_of([image, radius[None]], radius, axes(size), weight)]
    for _ in range(count):
        found.append(coarser(found[-1]))
    return found


def planes(level):
    """All that a level tells, as pictures [..., h, w]; of the second surface 0 where it is none."""
    found = list(level.first.parts)
    if level.second is not None:
        second_index = level.second_index.long()
        found += [
            torch.where(second_index < 0, 0.0, each[..., second_index])
            for each in level.second.parts
        ]
    return [each.reshape(*each.shape[:-1], *level.size) for each in found]


def nearer(level):
    """The nearer surfaces of the coarse pixels that hold two."""
    if level.second is None:
        return level.first.select(torch.zeros(0, dtype=torch.long))
    return level.second.select(level.second_index[level.second_index >= 0].long())


@pytest.mark.parametrize("size", [(12, 20), (13, 20), (12, 21), (13, 21)])
def test_mirrored_pictures_halve_to_mirrored_ones(size):
    image = pattern(size)
    radius = 9 * torch.rand(size, dtype=torch.float64, generator=torch.manual_seed(1))
    ours = levels(image, radius, 3)
    for dims in ((-1,), (-2,), (-2, -1)):
        for one, other in zip(ours, levels(image.flip(dims), radius.flip(dims), 3), strict=True):
            for a, b in zip(planes(one), planes(other), strict=True):
                assert worst(b.flip(dims), a) < 1e-12


@pytest.mark.parametrize("edge", range(6, 12))
def test_cells_on_an_edge_hold_both_surfaces_apart(edge):
    x = torch.arange(20, dtype=torch.float64).expand(12, 20)
    near, color = x < edge, torch.where(x < edge, 0.2, 0.7)
    radius = torch.where(near, -5.0, 4.0).to(x)
    for level in levels(color[None], radius, 3)[1:]:
        assert torch.equal(level.first.minimum, level.first.maximum)
        expected = torch.where(level.first.minimum < 0, 0.2, 0.7)
        assert worst(level.first.values[0], expected) < 1e-12
        second = nearer(level).values
        assert (second.shape[1] > 0) == bool(level.level > 1 or edge % 2)
        assert torch.allclose(second, torch.tensor([[0.2], [-5.0]]).double(), rtol=0, atol=1e-12)


def test_one_surface_halves_to_its_means():
    image = pattern((8, 12))
    radius = torch.full((8, 12), 3.0, dtype=torch.float64)
    _, half, quarter = levels(image, radius, 2)
    means = torch.nn.functional.avg_pool2d(image, 2)
    assert worst(half.first.values[:-1].reshape(means.shape), means) < 1e-12
    assert not len(nearer(half).weight)
    assert not len(nearer(quarter).weight)
    assert worst(quarter.first.values[-1], 3.0) < 1e-12


def test_pixels_that_do_not_count_leave_no_trace():
    image, radius = torch.full((1, 16, 16), 0.5, dtype=torch.float64), torch.ones(16, 16) * 2.0
    image[:, 5:9, 3:12], counts = 1e6, torch.ones(16, 16, dtype=torch.bool)
    counts[5:9, 3:12] = False
    for level in levels(image, radius.double(), 3, counts.double()):
        held = level.first.weight > 0
        assert worst(level.first.values[0, held], 0.5) < 1e-12
        assert not held.all() or level.level > 1


@pytest.mark.parametrize("cut", [4, 6])
def test_rows_put_together_are_the_whole(cut):
    size = (16, 20)
    image = pattern(size)
    radius = 9 * torch.rand(size, dtype=torch.float64, generator=torch.manual_seed(2))
    whole = levels(image, radius, 2)[-1]
    rows = whole.size[0]
    parts = [(whole, 0, cut // 4), (whole, cut // 4, rows)]
    found = stacked(iter(parts), rows, whole.middle[0])
    for a, b in zip(planes(found), planes(whole), strict=True):
        assert torch.equal(a, b)

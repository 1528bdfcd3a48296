"""Views are cut into parts, and parts put together, without a change."""

from __future__ import annotations

import pytest
import torch

from defocus_core import Views
from defocus_core.tensors.box import Box, grid_over
from defocus_core.tensors.views import batch, joined

SIZE = (40, 70)  # H, W


def views(kinds=3, seed=0):
    generator = torch.Generator().manual_seed(seed)
    images = [torch.rand(3, *SIZE, generator=generator) for _ in range(kinds)]
    trust = torch.rand(1, *SIZE, generator=generator)
    return Views(images, trust, {"pixels": 5, "tiles": seed}, Box(16, 32, *SIZE))


@pytest.mark.parametrize("gradients", [True, False])
@pytest.mark.parametrize("kinds", [1, 3])
def test_parts_joined_are_the_whole(kinds, gradients):
    whole, grid = views(kinds), grid_over(*SIZE, 32)
    boxes = [tile.seen_from(Box(-16, -32, 0, 0)) for tile in grid.tiles]
    parts = [whole.within(box)._replace(stats={"pixels": box.area}) for box in boxes]
    rows = [parts[i : i + grid.columns] for i in range(0, len(parts), grid.columns)]
    with torch.set_grad_enabled(gradients):
        again = joined(rows)
    assert (again.box, again.stats) == (whole.box, {"pixels": whole.box.area})
    for one, other in zip([*again.images, again.trust], [*whole.images, whole.trust], strict=True):
        assert torch.equal(one, other)


def test_a_batch_holds_each_picture_and_the_sum_of_the_work():
    both = batch([views(seed=1), views(seed=2)])
    assert both.stats == {"pixels": 10, "tiles": 3}
    for i, one in enumerate((views(seed=1), views(seed=2))):
        assert torch.equal(both.render[i], one.render)
        assert torch.equal(both.left[i], one.left)
        assert torch.equal(both.trust[i], one.trust)


def test_without_left_and_right_there_are_none():
    alone = views(kinds=1)
    assert (alone.left, alone.right) == (None, None)
    assert alone.to(torch.float64).trust.dtype == torch.float64

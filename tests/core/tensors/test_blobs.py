"""Blobs are the areas that a flood of the mask finds, whatever the bands they are read in."""

from __future__ import annotations

import pytest
import torch

from defocus_core.tensors.clipped_lights import Runs


def flooded(mask):
    """A number for each blob of a mask, 0 outside: the greatest of its pixels' numbers spreads."""
    numbers = mask * (1.0 + torch.arange(mask.numel()).view(mask.shape))
    for _ in range(mask.numel()):
        numbers = mask * torch.nn.functional.max_pool2d(numbers[None], 3, 1, 1)[0]
    return numbers


@pytest.mark.parametrize("share", [0.0, 0.2, 0.45, 0.7, 1.0])
@pytest.mark.parametrize("band", [1, 7, 40])
def test_blobs_are_connected_areas(share, band):
    mask = torch.rand(40, 33, generator=torch.Generator().manual_seed(3)) < share
    width = mask.shape[1]
    runs = Runs.concatenate(
        [Runs.from_mask(mask[y : y + band], y) for y in range(0, len(mask), band)]
    )
    assert int(runs.area.sum()) == int(mask.sum())
    row, column = mask.nonzero().unbind(1)
    found = runs.blobs(width)[runs.holding(row, column, width)]
    expected = flooded(mask)[row, column]
    pairs = torch.stack([found, expected]).unique(dim=1)
    assert pairs.shape[1] == len(found.unique()) == len(expected.unique())

"""Blobs are the areas that a flood of the mask finds, whatever the bands they are read in."""

from __future__ import annotations

import pytest
import torch

from defocus_core.tensors.clipped_lights import Runs


def flooded(mask):
    """Numbers of the blobs of a mask, 0 outside, by flooding one after another."""
    numbers, count = torch.zeros_like(mask, dtype=torch.int64), 0
    for row, column in mask.nonzero().tolist():
        if numbers[row, column]:
            continue
        count, front = count + 1, [(row, column)]
        while front:
            y, x = front.pop()
            inside = 0 <= y < mask.shape[0] and 0 <= x < mask.shape[1]
            if inside and mask[y, x] and not numbers[y, x]:
                numbers[y, x] = count
                front += [(y + i, x + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return numbers


def spiral():
    """One blob, whose runs are far apart along it."""
    mask = torch.zeros(31, 31, dtype=torch.bool)
    for k in range(0, 15, 2):
        mask[k, max(k - 2, 0) : 31 - k] = True
        mask[k : 31 - k, 30 - k] = True
        mask[30 - k, k : 31 - k] = True
        mask[k + 2 : 31 - k, k] = True
    return mask


@pytest.mark.parametrize("share", [0.0, 0.2, 0.45, 0.7, 1.0])
@pytest.mark.parametrize("band", [1, 7, 40])
def test_blobs_are_connected_areas(share, band):
    mask = torch.rand(40, 33, generator=torch.Generator().manual_seed(3)) < share
    _check(mask, band)


def test_a_spiral_is_one_blob():
    assert flooded(spiral()).max() == 1
    _check(spiral(), 31)


def _check(mask, band):
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

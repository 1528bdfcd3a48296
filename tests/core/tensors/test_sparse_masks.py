"""Where masks hold, as torch tells it, only faster."""

from __future__ import annotations

import math

import pytest
import torch

from defocus_core.tensors.neighbourhoods import exceeding, flat_nonzero, positions_of

SIZES = [(0, 5), (1, 1), (1, 7), (5, 13), (31, 65), (1, 8199), (128, 64), (91, 97), (2, 4101)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 1.0])
def test_pixels_of_a_mask_are_found_in_their_order(size, share):
    mask = torch.rand(size, generator=torch.Generator().manual_seed(1)) < share
    assert torch.equal(positions_of(mask), torch.nonzero(mask))
    assert torch.equal(flat_nonzero(mask), torch.nonzero(mask.flatten())[:, 0])


@pytest.mark.parametrize("start", range(9))
def test_so_are_those_of_a_part_of_a_mask(start):
    mask = torch.rand(110, 96, generator=torch.Generator().manual_seed(2)) < 0.1
    for part in (mask[start:], mask[:, start:], mask.mT[start:], mask.flatten()[start:][None]):
        assert torch.equal(positions_of(part), torch.nonzero(part))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("bound", [0.0, 1.013, -2.0, 1e-30])
def test_what_exceeds_a_bound_is_greater_to_the_last_bit(bound, dtype):
    at = torch.tensor(bound, dtype=dtype)
    beside = [torch.nextafter(at, at.new_tensor(end)) for end in (math.inf, -math.inf)]
    values = torch.stack([at, *beside, at + 1, at - 1, at * 2, at.new_tensor(math.inf)])
    values = torch.cat([values, -values])
    assert torch.equal(exceeding(values, bound), values > bound)
    assert not exceeding(values[:6], math.inf).any()

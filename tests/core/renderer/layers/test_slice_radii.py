"""Shares of pixels in slices: a partition of unity that keeps the second moment."""

import pytest
import torch
from tolerances import ROUNDING

from defocus_core.allowed_values import QUALITIES
from defocus_core.renderer.engine.settings import quality_of
from defocus_core.renderer.layers.slice_radii import (
    SHARP,
    evenly,
    membership,
    slice_position,
    slice_radii,
)

RADII = torch.linspace(-23.0, 31.0, 217, dtype=torch.float64)[None]
EXACT = ROUNDING[torch.float64]


def shares(spaced):
    """[K, 1, n] of RADII."""
    slices = torch.arange(len(spaced), dtype=torch.float64)
    return membership(slice_position(RADII, spaced), slices)


def test_two_slices_have_gradients_too():
    r = torch.tensor([1.5, 2.0, 3.0], requires_grad=True)
    (gradient,) = torch.autograd.grad(slice_position(r, (1.5, 3.0)).sum(), r)
    assert (gradient > 0).all()


@pytest.mark.parametrize("quality", QUALITIES)
def test_shares_are_a_partition_of_unity(quality):
    share = shares(slice_radii(-23.0, 31.0, quality_of(quality)))
    assert (share.sum(0) - 1).abs().max() < EXACT
    assert share.min() >= 0
    assert (share > EXACT).sum(0).max() <= 2


@pytest.mark.parametrize("quality", QUALITIES)
def test_shares_keep_the_second_moment(quality):
    spaced = slice_radii(-23.0, 31.0, quality_of(quality))
    square = (shares(spaced) * torch.tensor(spaced, dtype=torch.float64)[:, None, None] ** 2).sum(0)
    off = (square - RADII**2) / RADII.abs().clamp(min=1) ** 2
    near = RADII.abs() < 0.25  # up to SHARP a pixel is in focus
    assert off[~near].abs().max() < EXACT
    assert (off[near] <= EXACT).all()
    assert off[near].min() >= -(0.25**2)
    assert (square[RADII.abs() <= SHARP] == 0).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("reach", [0.1, 5.0, 200.0, 1e6])
def test_a_pixel_stands_between_the_rungs_beside_it(reach, dtype):
    """On a slice radius and next to it, too; on long slice radii as on short ones, and with equal
    slice radii.
    """
    generator = torch.Generator().manual_seed(3)
    some = (torch.rand(4000, generator=generator, dtype=dtype) * 1.7 - 1) * reach
    for spaced in (
        slice_radii(-reach, 0.7 * reach, quality_of("standard")),
        evenly(-reach, 0.7 * reach, 7),
        evenly(reach, reach, 3),
    ):
        slice_index = torch.tensor(spaced, dtype=torch.float64).to(dtype)
        beside = [torch.nextafter(slice_index, slice_index + way) for way in (-1, 1)]
        r = torch.cat([some, slice_index, *beside]).clamp(slice_index[0], slice_index[-1])
        at = slice_position(r, spaced)
        low, high = slice_index[at.floor().long()], slice_index[at.ceil().long()]
        slack = 4 * torch.finfo(dtype).eps * slice_index.abs().amax()
        assert ((low - slack <= r) & (r <= high + slack) | (r.abs() <= SHARP)).all()


@pytest.mark.parametrize("quality", QUALITIES)
def test_the_ladder_stands_where_it_stands(quality):
    """A range only chooses which slice radii are there, focus among them, mirrored about it."""
    quality = quality_of(quality)
    wide, narrow = slice_radii(-40.0, 40.0, quality), slice_radii(-3.3, 7.9, quality)
    assert set(narrow) <= set(wide)
    assert 0.0 in narrow
    assert narrow[0] <= -3.3
    assert narrow[-1] >= 7.9
    assert wide == tuple(-r for r in reversed(wide))


def test_an_even_ladder_has_exactly_its_count_and_spans_the_range():
    assert evenly(-2.0, 6.0, 1) == (2.0,)
    assert evenly(-2.0, 6.0, 5) == (-2.0, 0.0, 2.0, 4.0, 6.0)
    assert (shares(evenly(-2.0, 6.0, 5)).sum(0) - 1).abs().max() < EXACT

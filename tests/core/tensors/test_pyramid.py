"""Coarse pixels interpolated by cubics: polynomials stay what they are."""

import pytest
import torch

from defocus_core.tensors.pyramid import cubic_weights, resampled

FIRSTS = (2.25, 2.75)


def squares(down, across):
    """Of two channels; numbers of order one where there are a hundred coarse pixels."""
    values = 1 + down[:, None] / 100 - across / 200
    return torch.stack([values, 1 - values]) ** 2


@pytest.mark.parametrize("level", [1, 2, 3])
@pytest.mark.parametrize("size", [(192, 192), (120, 55), (9, 1)])
def test_polynomials_stay_what_they_are(level, size):
    step, coarse = 0.5**level, squares(torch.arange(110).double(), torch.arange(120).double())
    axes = list(zip(FIRSTS, size, strict=True))
    sides = zip(axes, coarse.shape[1:], strict=True)
    weights = (cubic_weights(at, n, step, length, coarse) for (at, n), length in sides)
    expected = squares(*(at + step * torch.arange(n).double() for at, n in axes))
    torch.testing.assert_close(resampled(coarse, *weights), expected, rtol=0, atol=1e-13)

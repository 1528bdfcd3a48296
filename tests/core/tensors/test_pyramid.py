"""Coarse pixels interpolated by cubics: polynomials stay what they are."""

import pytest
import torch

from defocus_core.tensors.box import Box
from defocus_core.tensors.pyramid import Axis, upsampled

MIDDLE = Axis(0, False)


def squares(down, across):
    """Of two channels; numbers of order one where there are a hundred coarse pixels."""
    values = 1 + down[:, None] / 100 - across / 200
    return torch.stack([values, 1 - values]) ** 2


@pytest.mark.parametrize("level", [1, 2, 3])
@pytest.mark.parametrize("size", [(192, 192), (120, 55), (9, 1)])
def test_polynomials_stay_what_they_are(level, size):
    step, coarse = 0.5**level, squares(torch.arange(110).double(), torch.arange(120).double())
    read, box = Box(10, 20, 110, 120), Box(13 << level, 23 << level, *size)
    axes = (MIDDLE, MIDDLE), (MIDDLE, MIDDLE)
    starts = [(box[d] + 0.5) * step - 0.5 - read[d] for d in (0, 1)]
    sides = zip(starts, size, strict=True)
    expected = squares(*(at + step * torch.arange(n).double() for at, n in sides))
    found = upsampled(coarse, read, box, axes, level, cubic=True)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-13)

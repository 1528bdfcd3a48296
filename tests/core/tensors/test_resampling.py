"""Coarse pixels read in pixels: polynomials stay what they are, and coarse pixels that are not
there are 0.
"""

import pytest
import torch

from defocus_core.tensors.pyramid import cubic_weights, linear_weights, resampled

# By kind the degree of the polynomials that it keeps.
KINDS = {"tents": (linear_weights, 1), "cubics": (cubic_weights, 2)}
LIKE = torch.zeros((), dtype=torch.float64)
FIRSTS = (2.25, 2.75)


def line(count, step=1.0, first=0.0):
    return first + step * torch.arange(count, dtype=torch.float64)


def polynomial(down, across, degree):
    """Of two channels; numbers of order one where there are a hundred coarse pixels."""
    values = 1 + down[:, None] / 100 - across / 200
    return torch.stack([values, 1 - values]) ** degree


def read(coarse, kind, size, level):
    make, step = KINDS[kind][0], 0.5**level
    sides = zip(FIRSTS, size, coarse.shape[1:], strict=True)
    return resampled(coarse, *(make(first, n, step, length, LIKE) for first, n, length in sides))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("level", [1, 2, 3])
@pytest.mark.parametrize("size", [(192, 192), (120, 55), (9, 1)])
def test_polynomials_stay_what_they_are(kind, level, size):
    degree, step = KINDS[kind][1], 0.5**level
    coarse = polynomial(line(110), line(120), degree)
    down, across = (line(n, step, first) for first, n in zip(FIRSTS, size, strict=True))
    expected = polynomial(down, across, degree)
    torch.testing.assert_close(read(coarse, kind, size, level), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
def test_cells_that_are_not_there_are_dark(kind):
    """As if there were zeros around them."""
    coarse = torch.rand(1, 40, 31, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    framed = torch.nn.functional.pad(coarse, (5, 60, 5, 60))
    make, starts, size = KINDS[kind][0], (-3.25, 2.75), (120, 55)
    read_of, read_within = (
        resampled(
            of,
            *(
                make(at + more, n, 0.5, length, LIKE)
                for at, n, length in zip(starts, size, of.shape[1:], strict=True)
            ),
        )
        for of, more in ((coarse, 0), (framed, 5))
    )
    torch.testing.assert_close(read_of, read_within, rtol=0, atol=1e-14)

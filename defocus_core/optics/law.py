"""The law of the thin lens, for numbers, arrays and tensors alike; lengths are in mm.

For the focal length f, the f-number N and the focus distance s, with A = f / N and
v = f s / (s - f), the CoC at depth z is

    c(z) = A v (1/s - 1/z).

It is negative nearer than focus, and affine in disparity 1/z, so that infinity needs no clamp.
"""

from __future__ import annotations

from typing import Any


def coc_per_disparity(foclen: Any, fnum: Any, foc_dist: Any) -> Any:
    """A v = f² / (N (1 - f / s)) in mm², for f and s in mm: the CoC per disparity of 1 / mm."""
    return foclen * foclen / (fnum * (1 - foclen / foc_dist))


def coc_of(per_disparity: Any, focus: Any, depth: Any) -> Any:
    """The law: signed CoC in mm at a depth in mm, given A v in mm² and the focus 1/s in 1/mm."""
    return per_disparity * (focus - 1 / depth)

"""The lens whose blur has the radii asked for in a picture: focus and f-number from its depth."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from defocus_core.batch.lenses.lens import Lens
from defocus_core.errors import Rejected
from defocus_core.io.arrays import evenly
from defocus_core.io.depth_formats.depth import Depth

_MM_PER_M = 1000.0
_LIFE_SIZE = 2.0  # focal lengths: a focus nearer than this enlarges


def matched(lens: Lens, depth: Depth) -> Lens:
    """The lens with the focus and the f-number that give a picture its ``radii_px``.

    Both have six digits, so that machines that round differently find the same lens.

    Raises:
        Rejected: the picture holds nothing.
    """
    from defocus_core.fitting.matched_blur import fnum_of_strength, matched_blur

    assert lens.radii_px is not None
    disparity = disparities(depth)
    if not disparity.numel():
        problem = "has an alpha of 0 everywhere, and nothing that could be blurred"
        raise Rejected("no-valid-depth", problem, "leave it out", path=depth.path)
    nearest = 1 / (_LIFE_SIZE * lens.foclen)
    blur = matched_blur(disparity, lens.radii_px, nearest=nearest)
    focus = _six_digits(blur.focus)
    pitch = lens.sensor_width / depth.size[0]
    return dataclasses.replace(
        lens,
        foc_dist=1 / focus if focus else math.inf,
        fnum=_six_digits(fnum_of_strength(blur.strength, focus, lens.foclen, pitch)),
    )


def disparities(depth: Depth) -> Any:
    """The disparities per mm of a grid of pixels that hold something, [N] in float64."""
    import torch

    metres = evenly(depth.metres)
    if depth.nothing is not None:
        metres = metres[~evenly(depth.nothing)]
    return torch.from_numpy(1 / (metres.astype(np.float64).ravel() * _MM_PER_M))


def _six_digits(value: float) -> float:
    return float(f"{value:.6g}")

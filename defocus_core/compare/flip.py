"""FLIP, the visible difference when flipping between two pictures, by ``flip-evaluator``."""

from __future__ import annotations

import numpy as np

from defocus_core.compare.pixels import Pixels
from defocus_core.errors import UsageProblem
from defocus_core.io.images.color_space import srgb_to_linear

_LARGEST = 1e30  # greatest light
_BLACK = 1e-6  # light of A, below which the evaluator cannot choose an exposure and would exit


def measure_flip(pixels: Pixels) -> dict[str, float]:
    """Mean and maximum of FLIP over the compared, finite pixels; empty without colour."""
    try:
        from flip_evaluator import evaluate
    except ImportError:
        problem = "needs flip-evaluator, which is not installed"
        remedy = "run: pip install 'defocus[flip]'"
        raise UsageProblem("needs-extra", problem, remedy, field="flip") from None
    means, greatest = [], []
    for layer in pixels.color:
        a, b = (np.stack([pixels.plane(s, name) for name in layer], axis=2) for s in "ab")
        used = True if pixels.finite is None else pixels.finite[..., None]
        stored = (np.where(used, v.astype("f4").clip(0, _LARGEST), 0) for v in (a, b))
        light = (srgb_to_linear(v) if pixels.gamma is None else v**pixels.gamma for v in stored)
        a, b = (np.repeat(v.astype("f4"), 3 // len(layer), axis=2) for v in light)
        kind = "HDR" if max(a.max(), b.max()) > 1 else "LDR"
        dark = dict.fromkeys(("startExposure", "stopExposure"), 0.0) if a.max() < _BLACK else {}
        errors = evaluate(a, b, kind, False, False, False, dark)[0][..., 0]
        errors = errors if pixels.finite is None else errors[pixels.finite]
        if not errors.size:
            return {}
        means.append(float(errors.mean(dtype="f8")))
        greatest.append(float(errors.max()))
    return {"flip": max(means), "flip-max": max(greatest)} if means else {}

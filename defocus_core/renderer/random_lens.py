"""Options of a random lens: their names, the values they may have, and what they describe."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import CatEye
from defocus_core.optics.distributions import Distribution
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.renderer.defocus_lens import DefocusLens
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.validation import number, positive

Option = float | Distribution
_SHAPES = ("curvature", "obstruction", "spherical", "squeeze")
_RIM = ("rim_size", "rim_shift")
OPTIONS = (
    *("foclen", "fnum", "foc_dist", "blades", "blade_rotation", "sensor_width"),
    *(*_SHAPES, *_RIM, "crosstalk"),
)


def check_option(name: str, option: Option) -> None:
    """Check each value that an option of a lens may have."""
    kind = option.kind if isinstance(option, Distribution) else "number"
    if kind in ("disparity", "percentile") and name != "foc_dist":
        raise ValueError(f"{name} must not be drawn from a {kind}; it is for foc_dist only")
    if name == "blades" and kind not in ("number", "choice"):
        raise ValueError(f"blades must be whole numbers, got {option}; draw them by choice")
    for value in _values(option):
        if name == "blades":
            Aperture(value)
        elif name in _SHAPES:
            Aperture(6, **{name: value})
        elif name in _RIM:
            number(name, value, "in radii of the pupil, or a Distribution")
        elif name == "crosstalk":
            DualPixel(crosstalk=value)
        elif name == "blade_rotation":
            number(name, value, "in degrees, or a Distribution")
        elif kind != "percentile" and not (name == "foc_dist" and value == math.inf):
            positive(name, value, "in mm, or a Distribution")


def check_rim(size: Option, shift: Option) -> None:
    """Check that no rim that may be drawn hides the middle of the pupil."""
    sizes, shifts = ([float(value) for value in _values(option)] for option in (size, shift))
    CatEye(min(sizes), max(shifts))


def _values(option: Option) -> tuple[Any, ...]:
    """The ends of the range of an option, the values it is chosen from, or itself."""
    return option.values if isinstance(option, Distribution) else (option,)


def aperture_with(options: dict[str, Any]) -> Aperture:
    """The pupil of drawn options."""
    shape = {name: options[name] for name in _SHAPES}
    return Aperture(options["blades"], options["blade_rotation"], **shape)


def rim_with(options: dict[str, Any]) -> CatEye | None:
    """The rim of drawn options; None where it clips nothing."""
    size, shift = options["rim_size"], options["rim_shift"]
    return None if size >= 1 + shift else CatEye(size, shift)


def radii_of_each(lenses: Sequence[DefocusLens], depth: Tensor) -> Tensor:
    """Signed CoC radii in px of maps [B, H, W] of depth in mm, > 0, by a lens of each."""
    terms = torch.stack([lens.radius_terms(depth.dtype) for lens in lenses], 1)
    coc_per_disparity, focus, two_pixels = sent(terms[..., None, None], depth)
    radii: Tensor = coc_per_disparity * (focus - 1 / depth) / two_pixels
    return radii


def lens_with(options: dict[str, Any], size: torch.Size) -> DefocusLens:
    """The lens of drawn options before a sensor of (height, width) px."""
    height, width = size
    sensor = (options["sensor_width"], options["sensor_width"] * height / width)
    lens = DefocusLens(options["foclen"], options["fnum"], sensor, (width, height), "cpu")
    lens.refocus(options["foc_dist"])
    return lens

"""What the compiled back carries; it imports nothing of Numba."""

from __future__ import annotations

from functools import cache
from typing import Any

import torch
from torch import Tensor

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.parts import LEFT, RIGHT
from defocus_core.renderer.compiled.openings import has_spans
from defocus_core.renderer.engine.frame import SharedFrame
from defocus_core.renderer.engine.scene import InFocus, Surface
from defocus_core.renderer.engine.settings import Settings
from defocus_core.renderer.layers.slice_radii import plane_of

# Colours that are spread together.
CHANNELS = 3


@cache
def available() -> bool:
    """Whether Numba is installed, works with this Python, and compiles: ``NUMBA_DISABLE_JIT``."""
    try:
        import numba
    except ImportError:
        return False
    config: Any = numba.config
    return not config.DISABLE_JIT


def carries(frame: SharedFrame, scene: InFocus) -> bool:
    """Whether the compiled back renders the centre view of a scene as it is asked for.

    It does not: gradients, other devices, float64, qualities but the standard, an exact number of
    slices, tiles of a given side, openings with a hole or uneven light, cat's eyes, layers, and
    blur much wider than the frame. A plane is left to torch, for which it is one convolution.
    """
    is_plane = plane_of(*frame.content.limits) is not None
    whole = scene.layers is None and not is_plane and not frame.cut
    return whole and carries_surface(scene.surface, frame.settings)


def carries_surface(surface: Surface, settings: Settings) -> bool:
    """The same of any surface, but for its radii."""
    return bool(
        settings.back == "auto"
        and settings.quality == "standard"
        and settings.num_layers is None
        and settings.tile is None
        and settings.cat_eye is None
        and not any(x.dtype == torch.float64 for x in surface.tensors[:2])
        and not _needs_torch(surface.tensors)
        and _is_even(settings.aperture)
        and available()
    )


def carries_pair(settings: Settings) -> bool:
    """Whether it renders left and right, too: of photodiodes that each see a half of the lens."""
    apart = settings.dual_pixel.separation
    return settings.dual_pixel.halves == (LEFT, RIGHT) and isinstance(apart, float)


def by_loops(surface: Surface) -> bool:
    """Whether compiled loops find the surfaces of a picture, if it has no highlights; else torch.

    They take three colours and no matte.
    """
    return len(surface.image) == CHANNELS and surface.matte is None


def _is_even(aperture: Aperture) -> bool:
    """Whether the light of an opening is even, and each row of it one span."""
    spherical = aperture.spherical
    even = not isinstance(spherical, Tensor) and spherical == 0 and aperture.psf_type == "pillbox"
    return even and has_spans(aperture.outline)


def _needs_torch(tensors: list[Tensor]) -> bool:
    """Whether tensors are on another device, or want a gradient."""
    return not all(x.is_cpu for x in tensors) or (
        torch.is_grad_enabled() and any(x.requires_grad for x in tensors)
    )

"""Which scenes and settings the compiled back supports, told without importing Numba."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.optics.parts import LEFT, RIGHT
from defocus_core.renderer.compiled.openings import has_spans
from defocus_core.renderer.layers.slice_radii import plane_of
from defocus_core.tensors.later import Tensor, torch

if TYPE_CHECKING:
    from defocus_core.renderer.engine.frame import SharedFrame
    from defocus_core.renderer.engine.scene import InFocus, Surface
    from defocus_core.renderer.engine.settings import Settings

# Colours that are spread together.
CHANNELS = 3


@cache
def available() -> bool:
    """Whether Numba is installed, works with this Python, and is not disabled."""
    try:
        import numba
    except ImportError:
        return False
    config: Any = numba.config
    return not config.DISABLE_JIT


def carries(frame: SharedFrame, scene: InFocus) -> bool:
    """Whether the compiled back supports a scene and its settings.

    Not supported: gradients, other devices, float64, qualities other than standard, an exact number
    of slices, tiles of a given side, openings with a hole or uneven light, photodiodes that see
    more than half of the lens, cat's eyes, layers, and blur much wider than the frame. A plane is
    left to torch, which renders it by one convolution.
    """
    is_plane = plane_of(*frame.content.limits) is not None
    whole = scene.layers is None and not is_plane and not frame.cut
    return whole and carries_surface(scene.surface, frame.settings)


def carries_surface(surface: Surface, settings: Settings) -> bool:
    """Whether the compiled back supports a surface and the settings; radii are not examined."""
    return (
        carries_settings(settings)
        and not any(x.dtype == torch.float64 for x in surface.tensors[:2])
        and not _needs_torch(surface.tensors)
    )


def carries_settings(settings: Settings) -> bool:
    """Whether the compiled back supports the settings; no picture is examined."""
    return bool(
        settings.back == "auto"
        and settings.quality == "standard"
        and settings.num_layers is None
        and settings.tile is None
        and settings.cat_eye is None
        and _has_halves(settings.dual_pixel)
        and _is_uniform(settings.aperture)
        and available()
    )


# Bytes of Numba and of the functions that it has compiled.
_CODE = 140e6
# Bytes of a pixel, for a frame is rendered at once: in any case, and more if there are edges, left
# and right, highlights, and surfaces of other than three colours, which torch finds. Rows of all
# layers that a thread spreads in.
_PIXEL, _OF_EDGES, _OF_PAIR, _OF_LIGHTS, _OF_OTHERS, _ROWS = 75, 70, 65, 115, 60, 1500


def bytes_of_loops(
    size: tuple[int, int],
    settings: Settings,
    *,
    edges: bool,
    lights: bool = False,
    others: bool = False,
) -> float:
    """Upper bound of the memory in bytes that compiled loops need, without input and output.

    `size`: (height, width) of the picture; `edges`: whether surfaces hide others; `lights`: whether
    there are highlights; `others`: whether torch finds the surfaces.
    """
    height, width = size
    pair = settings.left_right
    pixel = _PIXEL + _OF_EDGES * edges + _OF_PAIR * pair + _OF_LIGHTS * lights + _OF_OTHERS * others
    row = width * 4 * 4 * (1 + pair)
    return _CODE + height * width * pixel + settings.threads * _ROWS * row


def _has_halves(dual_pixel: DualPixel) -> bool:
    """Whether left and right are exact halves of the lens, and their separation has no gradient."""
    return dual_pixel.halves == (LEFT, RIGHT) and isinstance(dual_pixel.separation, float)


def by_loops(surface: Surface) -> bool:
    """Whether compiled loops can find the surfaces of a picture if it has no highlights.

    They can if it has three channels and no matte; else torch finds the surfaces.
    """
    return len(surface.image) == CHANNELS and surface.matte is None


def _is_uniform(aperture: Aperture) -> bool:
    """Whether an opening has the same light everywhere, and each of its rows is a single span."""
    spherical = aperture.spherical
    even = not isinstance(spherical, Tensor) and spherical == 0 and aperture.psf_type == "pillbox"
    return even and has_spans(aperture.outline)


def _needs_torch(tensors: list[Tensor]) -> bool:
    """Whether any tensor is on another device than the CPU, or requires a gradient."""
    return not all(x.is_cpu for x in tensors) or (
        torch.is_grad_enabled() and any(x.requires_grad for x in tensors)
    )

"""Rendering and examination of scenes by compiled loops alone, without torch operations."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from defocus_core.renderer.compiled.carried import by_loops, carries_surface
from defocus_core.renderer.engine.scene import Scene, Surface
from defocus_core.renderer.engine.settings import Settings
from defocus_core.tensors.box import Box
from defocus_core.tensors.views import ViewTensors


def views_alone(scene: Scene, settings: Settings) -> ViewTensors | None:
    """The views of a scene, rendered by compiled loops alone; None if torch is needed."""
    if (
        not isinstance(scene, Surface)
        or not by_loops(scene)
        or scene.image.dtype != torch.float32
        or settings.psf_ks is not None
        or not _is_supported(scene, settings)
    ):
        return None
    from defocus_core.renderer.compiled.arrays import rendered_alone
    from defocus_core.renderer.compiled.once import compile_once

    compile_once()
    views = rendered_alone(*_arrays_of(scene), settings)
    if views is None:
        return None
    # each has memory of its own: a caller who keeps one does not keep the others
    images = [torch.from_numpy(image.copy()) for image in views.images]
    box = Box(0, 0, *scene.signed_radius.shape)
    return ViewTensors(images, torch.from_numpy(views.trust.copy()), views.stats, box)


def needs_no_repair(surface: Surface, settings: Settings) -> bool:
    """Whether compiled loops are certain that the depth of a surface needs no repair."""
    if settings.depth_repair == "off" or not _is_supported(surface, settings):
        return False
    from defocus_core.renderer.compiled.arrays import is_clean, look_at
    from defocus_core.renderer.compiled.once import compile_once

    compile_once()
    image, radius = _arrays_of(surface)
    return is_clean(image, radius, look_at(radius))


def _arrays_of(surface: Surface) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The colours [C, H, W] and the signed radii [H, W] of a surface, as float32 arrays."""
    image, radius = (x.detach().float().contiguous().numpy() for x in surface.tensors[:2])
    return image, radius


def _is_supported(surface: Surface, settings: Settings) -> bool:
    """Whether compiled loops can examine the depth of a surface, with these settings."""
    asked = surface.matte, settings.edge_width, settings.decided
    is_single = surface.signed_radius.dtype == torch.float32
    return is_single and all(x is None for x in asked) and carries_surface(surface, settings)

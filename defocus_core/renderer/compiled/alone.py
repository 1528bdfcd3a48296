"""Pictures that compiled loops render without torch, and depth that they find to need no repair."""

from __future__ import annotations

import torch

from defocus_core.renderer.compiled.carried import by_loops, carries_pair, carries_surface
from defocus_core.renderer.engine.scene import Scene, Surface
from defocus_core.renderer.engine.settings import Settings
from defocus_core.tensors.views import ViewTensors


def views_alone(scene: Scene, settings: Settings) -> ViewTensors | None:
    """The views of a picture by compiled loops alone; None where torch is needed, too."""
    if (
        not isinstance(scene, Surface)
        or not by_loops(scene)
        or scene.image.dtype != torch.float32
        or settings.psf_ks is not None
        or (settings.left_right and not carries_pair(settings))
        or not _is_seen(scene, settings)
    ):
        return None
    from defocus_core.renderer.compiled.once import compile_once
    from defocus_core.renderer.compiled.picture import rendered_alone

    compile_once()
    return rendered_alone(scene, settings)


def needs_no_repair(surface: Surface, settings: Settings) -> bool:
    """Whether compiled loops see that the depth of a surface is as it should be."""
    if settings.depth_repair == "off" or not _is_seen(surface, settings):
        return False
    from defocus_core.renderer.compiled.once import compile_once
    from defocus_core.renderer.compiled.picture import is_clean, look_at

    compile_once()
    return is_clean(surface, look_at(surface, settings))


def _is_seen(surface: Surface, settings: Settings) -> bool:
    """Whether compiled loops may look at the depth of a surface."""
    asked = surface.matte, settings.edge_width, settings.decided
    is_single = surface.signed_radius.dtype == torch.float32
    return is_single and all(x is None for x in asked) and carries_surface(surface, settings)

"""Pictures that compiled loops render alone, whose depth needs no repair."""

from __future__ import annotations

import torch

from defocus_core.renderer.compiled.carried import by_loops, carries_pair, carries_surface
from defocus_core.renderer.engine.scene import Scene, Surface
from defocus_core.renderer.engine.settings import Settings
from defocus_core.tensors.views import ViewTensors


def views_alone(surface: Scene, settings: Settings) -> ViewTensors | None:
    """The views of a picture by compiled loops alone; None where torch is needed, too."""
    asked = settings.psf_ks, settings.edge_width, settings.decided
    if (
        not isinstance(surface, Surface)
        or any(x is not None for x in asked)
        or not by_loops(surface)
        or (settings.left_right and not carries_pair(settings))
        or any(x.dtype != torch.float32 for x in surface.tensors)
        or not carries_surface(surface, settings)
    ):
        return None
    from defocus_core.renderer.compiled.once import compile_once
    from defocus_core.renderer.compiled.picture import rendered_alone

    compile_once()
    return rendered_alone(surface, settings)

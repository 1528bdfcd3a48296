"""Breathing of the focus: blur is drawn outwards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from defocus_core.errors import UsageProblem
from defocus_core.io.arrays import times
from defocus_core.picture.scene import Surfaces
from defocus_core.picture.sources import map_windows, windows


def scene(surfaces: Surfaces) -> Surfaces:
    """The surface of the picture as it is blurred."""
    import torch

    from defocus_core.renderer.breathing import breathed

    take, ((color,), (radii,)) = surfaces.take, (surfaces.colors, surfaces.radii)
    if take.inputs.layers or surfaces.knows_hidden or take.inputs.matte is not None:
        problem = "moves one picture with its depth, not layers"
        raise UsageProblem("unsupported", problem, "leave it out", field="breathing")
    planes = torch.from_numpy(np.stack([plane[:] for plane in color.planes]))
    image, px = breathed(planes.float(), torch.from_numpy(radii.px[:]), take.lens.breathing)
    color, radii = replace(color, planes=tuple(image.numpy())), radii._replace(px=px.numpy())
    return replace(
        surfaces,
        colors=(color,),
        radii=(radii,),
        light=(windows(color.planes, take.device),),
        px=(map_windows(times(radii.px, surfaces.longer), take.device),),
    )

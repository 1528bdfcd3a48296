"""Lamps: clipped lights of pictures, with the light that they lost."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.picture.scene import Surfaces


def scene(surfaces: Surfaces) -> Surfaces:
    """The surfaces with the light of their lamps, as they are if one of them has light above 1.

    What is in focus stays as it is.
    """
    from defocus_core.tensors.clipped_lights import ClippedLights

    lens, colors = surfaces.take.lens, len(surfaces.take.inputs.color.light)
    assert lens.highlights is not None
    lamps = [
        ClippedLights(light, *lens.highlights, colors=colors, signed_radius=radius)
        for light, radius in zip(surfaces.light, surfaces.px, strict=True)
    ]
    if any(each.measured for each in lamps):
        return replace(surfaces, lamps=0)
    light, count = tuple(each.added for each in lamps), sum(each.count for each in lamps)
    return replace(surfaces, light=light, lamps=count)

"""Colours that are in focus at different distances: a pass of each."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.picture.radii import color_offsets
from defocus_core.picture.scene import Passes, longer_axis
from defocus_core.picture.take import Take


def passes(whole: Passes) -> Passes:
    """Each group of colours; they share what is continued behind surfaces."""
    from defocus_core.renderer.engine.renderer import shared_surfaces

    take, (every,) = whole.take, whole.every
    longer, infinity = longer_axis(take), every.settings.infinity
    apart = [
        every._replace(
            settings=replace(
                every.settings, infinity=None if infinity is None else infinity + longer * px
            ),
            channels=channels,
            light=channels,
            px=longer * px,
        )
        for channels, px in _groups(take)
    ]
    if len(apart) > 1 and every.scene.layered is None:
        offsets = [each.px for each in apart]
        settings = apart[0].settings
        shared = shared_surfaces(every.scene, settings, offsets, keep=take.has_room)
        apart = [each._replace(shared=shared) for each in apart]
    return replace(whole, every=tuple(apart))


def _groups(take: Take) -> list[tuple[tuple[int, ...], float]]:
    """The channels that are rendered together: all, or red, blue, then all others.

    Of each the px that its radii are apart from those of the lens.
    """
    lens, names = take.lens, take.inputs.color.channels
    channels = tuple(range(len(take.inputs.color.planes)))
    if "R" not in names:
        return [(channels, 0.0)]
    offsets = color_offsets(lens, take.size)
    red, blue = names.index("R"), names.index("B")
    others = tuple(c for c in channels if c not in (red, blue))
    if offsets[0] == offsets[1]:
        return [((red, blue), offsets[0]), (others, 0.0)]
    return [((red,), offsets[0]), ((blue,), offsets[1]), (others, 0.0)]

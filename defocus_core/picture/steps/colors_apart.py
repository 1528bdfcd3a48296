"""Colours that are in focus at different distances: a pass of each."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.picture.radii import color_offsets
from defocus_core.picture.scene import Pass, longer_axis
from defocus_core.picture.take import Take


def passes(every: tuple[Pass, ...]) -> tuple[Pass, ...]:
    """Each group of colours; they share what is continued behind surfaces."""
    from defocus_core.renderer.engine.renderer import shared_surfaces

    (whole,) = every
    take, infinity = whole.take, whole.settings.infinity
    longer = longer_axis(take)
    apart = [
        whole._replace(
            settings=replace(
                whole.settings, infinity=None if infinity is None else infinity + longer * px
            ),
            channels=channels,
            light=channels,
            px=longer * px,
        )
        for channels, px in _groups(take)
    ]
    if len(apart) > 1 and whole.scene.layered is None:
        offsets = [each.px for each in apart]
        settings = apart[0].settings
        shared = shared_surfaces(whole.scene, settings, offsets, keep=take.has_room)
        apart = [each._replace(shared=shared) for each in apart]
    return tuple(apart)


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

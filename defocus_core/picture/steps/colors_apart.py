"""Colours that are in focus at different distances, and halves above one another: several passes.

Channels of the picture are rendered apart; up and down are left and right of rows for columns.
"""

from __future__ import annotations

from dataclasses import replace

from defocus_core.picture.radii import color_offsets
from defocus_core.picture.scene import Pass, Passes, longer_axis
from defocus_core.picture.take import Take


def passes(whole: Passes) -> Passes:
    """Each group of colours, first of rows for columns, then as they are."""
    take, (every,) = whole.take, whole.every
    rows = [kind for kind in take.job.outputs.rows if kind.rendered]
    transposed = _split(take, _transpose(every)) if any(k.transposed for k in rows) else ()
    upright = () if all(kind.transposed for kind in rows) else _split(take, every)
    return replace(whole, every=(*transposed, *upright))


def _transpose(whole: Pass) -> Pass:
    """A pass with rows for columns."""
    settings = whole.settings
    settings = replace(
        settings,
        aperture=settings.aperture.transposed(),
        dual_pixel=settings.dual_pixel.transposed(),
        left_right=True,
    )
    return whole._replace(scene=whole.scene.turned(), settings=settings, transposed=True)


def _split(take: Take, whole: Pass) -> tuple[Pass, ...]:
    """The pass in groups of colours, which share what is continued behind surfaces."""
    from defocus_core.renderer.engine.renderer import shared_surfaces

    longer, infinity = longer_axis(take), whole.settings.infinity
    passes = [
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
    if len(passes) == 1 or whole.scene.layered is not None:
        return tuple(passes)
    offsets = [each.px for each in passes]
    settings = passes[0].settings
    shared = shared_surfaces(whole.scene, settings, offsets, keep=take.has_room)
    return tuple(each._replace(shared=shared) for each in passes)


def _groups(take: Take) -> list[tuple[tuple[int, ...], float]]:
    """The channels that are rendered together: all, or red, blue, then all others.

    Of each the px that its radii are apart from those of the lens.
    """
    lens, names = take.lens, take.inputs.color.channels
    channels = tuple(range(len(take.inputs.color.planes)))
    if not lens.axial_color or "R" not in names:
        return [(channels, 0.0)]
    offsets = color_offsets(lens, take.size)
    red, blue = names.index("R"), names.index("B")
    others = tuple(c for c in channels if c not in (red, blue))
    if offsets[0] == offsets[1]:
        return [((red, blue), offsets[0]), (others, 0.0)]
    return [((red,), offsets[0]), ((blue,), offsets[1]), (others, 0.0)]

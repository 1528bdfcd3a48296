"""Colours that are in focus at different distances, and halves above one another: several passes.

Channels of the picture are rendered apart; up and down are left and right of rows for columns.
"""

from __future__ import annotations

from dataclasses import replace

from defocus_core.errors import UsageProblem
from defocus_core.picture.opening import aperture_in_pixels, pupil_images
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

    groups = _groups(take)
    longer, shared = longer_axis(take), None
    if len(groups) > 1 and whole.scene.layered is None:
        offsets = [longer * px for _, px, _ in groups]
        settings = _of_color(take, whole, groups[0][1], groups[0][2]).settings
        shared = shared_surfaces(whole.scene, settings, offsets, keep=take.has_room)
    return tuple(
        _of_color(take, whole, px, color)._replace(
            channels=channels, light=channels, px=longer * px, shared=shared
        )
        for channels, px, color in groups
    )


def _of_color(take: Take, whole: Pass, px: float, color: int | None) -> Pass:
    """The pass with the settings of a colour, whose radii are px apart from those of the lens."""
    pupil, longer = aperture_in_pixels(take.lens, take.inputs.color.pixel_aspect, color)
    infinity = take.blur.infinity
    settings = replace(
        whole.settings,
        aperture=pupil.transposed() if whole.transposed else pupil,
        infinity=None if infinity is None else longer * (infinity + px),
    )
    return whole._replace(settings=settings)


def _groups(take: Take) -> list[tuple[tuple[int, ...], float, int | None]]:
    """The channels that are rendered together: all, or red, blue, then all others.

    Of each the px that its radii are apart from those of the lens, and the colour of its light
    where the opening is coloured: red is 0, green 1, blue 2.
    """
    lens, names = take.lens, take.inputs.color.channels
    channels = tuple(range(len(take.inputs.color.planes)))
    colored = lens.aperture_image is not None and len(pupil_images(lens.aperture_image)) > 1
    if not (colored or lens.axial_color) or "R" not in names:
        return [(channels, 0.0, None)]
    if colored and any(kind.halves or kind.transposed for kind in take.job.outputs.rows):
        problem, remedy = "is coloured: its halves may have no light", "leave out left and right"
        raise UsageProblem("colored-pupil", problem, remedy, field="aperture-image")
    offsets = color_offsets(lens, take.size) if lens.axial_color else (0.0, 0.0)
    red, blue = names.index("R"), names.index("B")
    others = tuple(c for c in channels if c not in (red, blue))
    if offsets[0] == offsets[1] and not colored:
        return [((red, blue), offsets[0], None), (others, 0.0, None)]
    return [((red,), offsets[0], 0), ((blue,), offsets[1], 2), (others, 0.0, 1)]

"""Scene: what a lens sees of a take, and the settings of its renderer."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from defocus_core.io.arrays import times
from defocus_core.picture.opening import aperture_in_pixels, cat_eye_of, dual_pixel_of
from defocus_core.picture.radii import color_offsets, radii_of
from defocus_core.picture.sources import map_windows, windows
from defocus_core.picture.steps.table import PASSES, SCENE, through
from defocus_core.picture.take import Pass, Surfaces, Take

if TYPE_CHECKING:
    from defocus_core.renderer.engine.scene import Scene
    from defocus_core.renderer.engine.settings import Settings


def surfaces_of(take: Take) -> Surfaces:
    """The surfaces of a take, with all that happens to them."""
    color, device = take.inputs.color, take.device
    px = map_windows(times(take.blur.px, take.longer_axis), device)
    light = windows(color.planes, device)
    return through(SCENE, Surfaces(take, (color,), (take.blur,), (light,), (px,)))


def passes_of(take: Take, scene: Scene) -> tuple[Pass, ...]:
    """All that is rendered of a scene; what says most of the picture comes last."""
    channels = tuple(range(len(take.inputs.color.planes)))
    return through(PASSES, (Pass(take, scene, settings_of(take), channels, channels),))


def settings_of(take: Take) -> Settings:
    """The options of the renderer."""
    from defocus_core.renderer.engine.settings import Settings

    job, infinity = take.job, take.blur.infinity
    return Settings(
        aperture=aperture_in_pixels(take.lens, take.inputs.color.pixel_aspect)[0],
        dual_pixel=dual_pixel_of(take.lens),
        cat_eye=cat_eye_of(take.lens, take.size),
        quality=job.machine.quality,
        left_right=any(kind.halves for kind in job.outputs.rows),
        threads=job.machine.threads,
        tile=job.machine.tile,
        infinity=None if infinity is None else take.longer_axis * infinity,
    )


def stack_layers(surfaces: Surfaces) -> Surfaces:
    """The surface of each layer."""
    take = surfaces.take
    layers, device, keeping = take.inputs.layers, take.device, take.inputs.holding.keeping
    assert layers is not None
    every = tuple(
        take.radii if depth is take.inputs.depth else radii_of(take.lens, depth, keeping)
        for depth in layers.depths
    )
    return replace(
        surfaces,
        colors=layers.pictures,
        radii=every,
        light=tuple(windows(light, device) for light in layers.light),
        px=tuple(map_windows(times(each.px, take.longer_axis), device) for each in every),
        coverage=windows(layers.alpha, device),
    )


def pass_coverage(every: tuple[Pass, ...]) -> tuple[Pass, ...]:
    """The passes, whose light has no alpha, or that of a holdout at its end."""
    inputs = every[0].take.inputs
    layers, alpha = inputs.layers, len(inputs.color.light)
    assert layers is not None
    held_out, last = layers.held_out, len(layers.light[0]) - 1

    def of_layers(each: Pass) -> Pass:
        light = [c - (c > alpha) for c in each.channels if c != alpha]
        if held_out and alpha in each.channels:
            light.append(last)
        end = len(light) - held_out
        order = (end if c == alpha else light.index(c - (c > alpha)) for c in each.channels)
        return each._replace(light=tuple(light), order=tuple(order))

    return tuple(map(of_layers, every))


def repair_surfaces(surfaces: Surfaces) -> Surfaces:
    """The surfaces with the radii by which they are rendered; the repair is that of the first."""
    from defocus_core.depth.repair import repair_depth

    take, longer = surfaces.take, surfaces.take.longer_axis
    decided, infinity = take.decided, take.blur.infinity
    if decided is not None:
        from defocus_core.sequences.shot_repair import repair_through

        decided = repair_through(decided, longer, None if infinity is None else longer * infinity)
    reading = take.job.reading
    both = [
        repair_depth(
            px,
            windows(color.planes, take.device),
            None if radii.infinity is None else longer * radii.infinity,
            take.job.machine.threads,
            depth_repair=reading.depth_repair,
            edge_width=reading.edge_width,
            decided=decided,
            hold=surfaces.holds,
            matte=surfaces.matte,
        )
        for color, px, radii in zip(surfaces.colors, surfaces.px, surfaces.radii, strict=True)
    ]
    return replace(surfaces, px=tuple(px for px, _ in both), repair=both[0][1])


def light_lamps(surfaces: Surfaces) -> Surfaces:
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


def pass_colors(every: tuple[Pass, ...]) -> tuple[Pass, ...]:
    """Each group of colours; they share what is continued behind surfaces."""
    from defocus_core.renderer.engine.renderer import shared_surfaces

    (whole,) = every
    take, infinity = whole.take, whole.settings.infinity
    longer = take.longer_axis
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
    if len(apart) > 1 and whole.scene.layered is None and whole.scene.hidden is None:
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

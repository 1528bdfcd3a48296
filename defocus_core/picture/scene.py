"""What the renderer gets for a picture: scenes, settings, and one pass for each rendering."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.io.arrays import block_of, times
from defocus_core.picture.opening import aperture_in_pixels, cat_eye_of, dual_pixel_of
from defocus_core.picture.radii import color_offsets, radii_of
from defocus_core.picture.steps.table import PASSES, SCENE, apply_steps
from defocus_core.picture.take import Pass, Surfaces, Take

if TYPE_CHECKING:
    from torch import Tensor

    from defocus_core.renderer.engine.scene import Scene
    from defocus_core.renderer.engine.settings import Settings


def surfaces_of(take: Take) -> Surfaces:
    """The surfaces of a picture with radii and light, after all steps that change the scene."""
    from defocus_core.depth.diagnosis import DepthRepair

    color, device = take.inputs.color, take.device
    px = map_on(times(take.radii.px, take.longer_axis), device)
    light = picture_on(color.planes, device)
    first = Surfaces(take, (color,), (take.radii,), (light,), (px,), DepthRepair())
    return apply_steps(SCENE, first)


def passes_of(surfaces: Surfaces) -> tuple[Pass, ...]:
    """The renderings of a scene, in order; statistics are taken from the last one."""
    take = surfaces.take
    channels = tuple(range(len(take.inputs.color.planes)))
    whole = Pass(take, _scene(surfaces), settings_of(take), channels, channels)
    return apply_steps(PASSES, (whole,))


def _scene(surfaces: Surfaces) -> Scene:
    """Convert surfaces to a `Scene`, the input of the renderer."""
    from defocus_core.renderer.engine.scene import Surface, element_layers, with_hidden
    from defocus_core.renderer.layers.samples import Layered

    if surfaces.coverage is None:
        surface = Surface(surfaces.light[0], surfaces.px[0], surfaces.matte)
        return with_hidden(surface, surfaces.hidden)
    make = element_layers if surfaces.colors else Layered.from_layers
    return make(layers_on(surfaces.light), layers_on(surfaces.px), surfaces.coverage)


def settings_of(take: Take) -> Settings:
    """The settings of the renderer; depth repair is off, as a step repairs depth before."""
    from defocus_core.renderer.engine.settings import Settings

    job = take.job
    return Settings(
        aperture=aperture_in_pixels(take.lens, take.inputs.color.pixel_aspect)[0],
        dual_pixel=dual_pixel_of(take.lens),
        cat_eye=cat_eye_of(take.lens, take.size, take.inputs.color.pixel_aspect),
        quality=job.machine.quality,
        left_right=any(kind.halves for kind in job.outputs.rows),
        threads=job.machine.threads,
        tile=job.machine.tile,
        depth_repair="off",
    )


def stack_layers(surfaces: Surfaces) -> Surfaces:
    """Replace the surface of the picture by one for each layer."""
    take = surfaces.take
    layers, device = take.inputs.layers, take.device
    assert layers is not None
    every = tuple(
        take.radii if depth is take.inputs.depth else radii_of(take.lens, depth)
        for depth in layers.depths
    )
    return replace(
        surfaces,
        colors=layers.pictures,
        radii=every,
        light=tuple(picture_on(light, device) for light in layers.light),
        px=tuple(map_on(times(each.px, take.longer_axis), device) for each in every),
        coverage=picture_on(layers.alpha, device),
    )


def pass_coverage(every: tuple[Pass, ...]) -> tuple[Pass, ...]:
    """Leave alpha out of the light of layers, as the renderer computes it from their coverage.

    With a holdout, the alpha of the picture is a plane of light, which comes last.
    """
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
    """Repair the radii of all surfaces; the field `repair` records the repair of the first."""
    from defocus_core.depth.repair import repair_depth

    take, longer = surfaces.take, surfaces.take.longer_axis
    decided, infinity = take.decided, take.radii.infinity
    if decided is not None:
        from defocus_core.depth.shot_repair import repair_through

        decided = repair_through(decided, longer, None if infinity is None else longer * infinity)
    reading = take.job.reading
    both = [
        repair_depth(
            px,
            picture_on(color.planes, take.device),
            None if radii.infinity is None else longer * radii.infinity,
            take.job.machine.threads,
            depth_repair=reading.depth_repair,
            edge_width=reading.edge_width,
            decided=decided,
            matte=surfaces.matte,
        )
        for color, px, radii in zip(surfaces.colors, surfaces.px, surfaces.radii, strict=True)
    ]
    return replace(surfaces, px=tuple(px for px, _ in both), repair=both[0][1])


def light_lamps(surfaces: Surfaces) -> Surfaces:
    """Restore the light that clipped highlights have lost.

    Nothing changes if a surface has light above 1, as its highlights are not clipped.
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
    light = tuple(each.added for each in lamps)
    return replace(surfaces, light=light, lamps=sum(each.count for each in lamps))


def pass_colors(every: tuple[Pass, ...]) -> tuple[Pass, ...]:
    """Replace the pass by one for each group of colours with the same radii."""
    (whole,) = every
    take, color = whole.take, whole.take.inputs.color
    if "R" not in color.channels:
        return every
    ends = [name.rpartition(".")[2] for name in (*color.channels, *color.passes)]
    red, blue = (tuple(c for c, end in enumerate(ends) if end == name) for name in "RB")
    others = tuple(c for c, end in enumerate(ends) if end not in ("R", "B"))
    offsets = color_offsets(take.lens, take.size)
    groups = {red: offsets[0], blue: offsets[1], others: 0.0}
    if offsets[0] == offsets[1]:
        groups = {(*red, *blue): offsets[0], others: 0.0}
    return tuple(
        whole._replace(channels=channels, light=channels, px=take.longer_axis * px)
        for channels, px in groups.items()
    )


def picture_on(planes: Sequence[Any], device: str) -> Tensor:
    """NumPy planes [H, W] as a tensor [C, H, W] on a device, without a copy if possible."""
    return map_on(block_of(planes), device)


def map_on(values: Any, device: str) -> Tensor:
    """A NumPy array as a tensor on a device; on the CPU they share memory if possible."""
    import torch

    values = np.asarray(values)
    return torch.from_numpy(values if values.flags.writeable else values.copy()).to(device)


def layers_on(pictures: Sequence[Tensor]) -> Tensor:
    """Stack tensors [..., H, W] to one of float32, [L, ..., H, W]."""
    import torch

    return torch.stack([picture[...].to(torch.float32) for picture in pictures])


def to_array(values: Tensor) -> Any:
    """A tensor as a NumPy array, after the GPU has finished its work."""
    if isinstance(values, np.ndarray):
        return values
    import torch

    if not values.is_cuda:
        return values.cpu().numpy()
    held = torch.empty(values.shape, dtype=values.dtype, pin_memory=True)
    held.copy_(values, non_blocking=True)
    torch.cuda.current_stream(values.device).synchronize()
    return held.numpy()

"""Rendering a decoded picture to arrays of each kind of output, within the memory there is."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.batch.jobs.output_kinds import KINDS
from defocus_core.errors import TooLarge, UsageProblem
from defocus_core.io.exr.writing import clamped_half
from defocus_core.picture.memory_budget import image_type, regions_at_once
from defocus_core.picture.scene import Renderers
from defocus_core.picture.sources import to_array
from defocus_core.picture.steps.colors_apart import Colors, renderings
from defocus_core.picture.take import Rendered
from defocus_core.system import memory
from defocus_core.system.process import set_to_render

if TYPE_CHECKING:
    from defocus_core.renderer.engine.renderer import Renderer
    from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer
    from defocus_core.tensors.views import Views

Progress = Callable[[int, int], None]
# Share of the pixels of left or right from which on a warning says that they were negative.
_MANY_CLAMPED = 0.01
_TRUSTED = 0.99  # share of the lens


def with_views(
    rendered: Rendered,
    radius: Any = None,
    seen_behind: HiddenLayer | None = None,
    progress: Progress | None = None,
) -> Rendered:
    """The picture with the images and maps that need rendering.

    Args:
        rendered: as far as it is known before rendering.
        radius: signed radii [H, W] in px, averaged with other frames; None for its own.
        seen_behind: what other frames have seen of what is hidden.
        progress: called with (tiles done, tiles in all).

    Raises:
        TooLarge: it does not fit into memory.
    """
    import torch

    set_to_render()
    images, held = _Images(rendered), rendered.inputs.holding
    wall, cpu = time.perf_counter(), time.process_time()
    renderers = Renderers(*breathing_inputs(rendered, radius, seen_behind), seen_behind)
    renderer = _fill(images, renderers, progress)
    if rendered.device == "cuda":
        torch.cuda.synchronize()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    scratch = {"scratch_mb": held.arrays_mb} if held.scratch else {}
    lights = {} if renderers.lights is None else {"lights": renderers.lights}
    return replace(
        rendered,
        images=images.planes,
        clamped=images.clamped,
        reach=images.reach,
        lights=renderers.lights,
        repair=renderer.repair,
        seconds=wall,
        cpu_seconds=cpu,
        stats={**renderer.stats, "pixels_invented": images.invented, **lights, **scratch},
        warnings=(*rendered.warnings, *_clamped(renderer.stats)),
    )


def breathing_inputs(
    rendered: Rendered, radius: Any, seen_behind: HiddenLayer | None
) -> tuple[Rendered, Any]:
    """The picture and its radii as they are blurred, by a lens that breathes.

    Raises:
        UsageProblem: what lies behind the picture is known, too.
    """
    import torch

    from defocus_core.renderer.breathing import breathed

    inputs, breathing = rendered.inputs, rendered.lens.breathing
    if not breathing:
        return rendered, radius
    if inputs.is_layered or inputs.hidden is not None or seen_behind is not None:
        problem = "moves one picture with its depth, not layers"
        raise UsageProblem("unsupported", problem, "leave it out", field="breathing")
    planes = torch.from_numpy(np.stack([plane[:] for plane in inputs.color.planes]))
    px = torch.from_numpy((rendered.radii.picture.px if radius is None else radius)[:])
    image, moved = breathed(planes.float(), px, breathing)
    color = replace(inputs.color, planes=tuple(image.numpy()))
    return replace(rendered, inputs=replace(inputs, color=color)), moved.numpy()


def _clamped(stats: Mapping[str, float]) -> list[str]:
    """A warning if many pixels of left or right were negative."""
    fraction = stats.get("pixels_clamped", 0) / stats["pixels"]
    if fraction < _MANY_CLAMPED:
        return []
    why = "detail as fine as a pixel overshoots in half a lens"
    return [f"left, right: below 0 in {100 * fraction:.0f} % of the pixels, and made 0: {why}"]


def _fill(images: _Images, renderers: Renderers, progress: Progress | None) -> Renderer:
    """Render as many regions at once as fit, and one by one if a GPU runs out of memory."""
    import torch

    rendered, job, maximum = renderers.rendered, renderers.rendered.job, None
    colors = renderings(rendered)
    while True:
        images.clamped.clear()
        try:
            for number, color in enumerate(colors):
                renderer = renderers.of(color)
                images.reach = max(images.reach, renderer.reach)
                at_once = (
                    maximum
                    or regions_at_once(job, renderer, rendered.inputs.holding, rendered.device)[0]
                )
                if at_once < job.machine.threads:  # memory is short
                    memory.keep_freed(False)
                    memory.trim()
                shown = progress and partial(_of_all, progress, number, len(colors))
                images.invented = 0  # of one rendering
                for part in renderer.tiles(at_once, shown):
                    first = number == 0 or color.turned != colors[number - 1].turned
                    images.place(renderers.in_order(part, color), color, first=first)
            return renderer
        except torch.OutOfMemoryError:  # other programs use the GPU, too
            torch.cuda.empty_cache()
            if maximum == 1:
                problem = "does not fit into the memory of the GPU"
                remedy = "use ‹device› cpu, or a smaller ‹tile›"
                raise TooLarge("out-of-memory", problem, remedy, path=job.picture.color) from None
            maximum = 1


def _of_all(progress: Progress, number: int, count: int, done: int, tiles: int) -> None:
    """Report tiles of one of several renderings of a picture."""
    progress(number * tiles + done, count * tiles)


class _Images:
    """The images of a job while they are rendered.

    Attributes:
        planes: each rendered kind's arrays [H, W]: C of each view of an image, one of a map.
        clamped: number of pixels of each kind that were clamped to the range of half.
        reach: px that light reaches at most.
        invented: number of pixels of which less than `_TRUSTED` of the lens saw what is there.
    """

    def __init__(self, rendered: Rendered) -> None:
        job, (height, width, channels) = rendered.job, rendered.inputs.color.shape
        keeping = rendered.inputs.holding.keeping
        self.planes: dict[str, tuple[Any, ...]] = {}
        self.clamped: dict[str, int] = {}
        self.reach = self.invented = 0
        for kind in job.outputs.rows:
            if not kind.rendered:
                continue
            count, dtype = (channels, image_type(job)) if kind.image else (1, "float32")
            count *= len(kind.rendered_as)
            self.planes[kind.name] = tuple(
                keeping.new((height, width), dtype) for _ in range(count)
            )

    def place(self, part: Views, colors: Colors, *, first: bool = True) -> None:
        """Copy a rendered region to its place: the channels and kinds that were rendered.

        Of trust, after the first colours, the least of all.
        """
        top, left, height, width = part.box
        if colors.turned:
            top, left, height, width = left, top, width, height
        rows, columns = slice(top, top + height), slice(left, left + width)
        self.invented += int(np.count_nonzero(to_array(part.trust) < _TRUSTED))
        for kind, planes in self.planes.items():
            if bool(turned := KINDS[kind].turned) != colors.turned:
                continue
            names = (turned,) if turned else KINDS[kind].rendered_as
            views = [to_array(getattr(part, view)) for view in names]
            if turned:
                views = [view.swapaxes(-1, -2) for view in views]
            if KINDS[kind].image and len(colors.channels) * len(views) < len(planes):
                apart, some = len(planes) // len(views), colors.channels
                planes = tuple(planes[v * apart + c] for v in range(len(views)) for c in some)
            pixels = views[0] if len(views) == 1 else np.concatenate(views)
            pixels = pixels.reshape(len(planes), height, width)
            if planes[0].dtype == np.float16:
                pixels, beyond = clamped_half(pixels)
                if beyond.any():
                    count = int(np.count_nonzero(beyond.any(axis=0)))
                    self.clamped[kind] = self.clamped.get(kind, 0) + count
            for plane, values in zip(planes, pixels, strict=True):
                if not (first or KINDS[kind].image):
                    values = np.minimum(values, plane[rows, columns])
                plane[rows, columns] = values

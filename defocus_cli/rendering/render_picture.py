"""Rendering a decoded picture to arrays of each kind of output, within the memory there is."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from defocus_cli.depth.focusing import radius_at_infinity, radius_map
from defocus_cli.elements.layers import layered
from defocus_cli.elements.plate import layers_of
from defocus_cli.formats.kinds import KINDS
from defocus_cli.jobs.job import Job
from defocus_cli.look.opening import aperture_in_pixels, cat_eye_of, dual_pixel_of
from defocus_cli.rendering.colors_apart import (
    Colors,
    chosen,
    lit,
    of_colors,
    renderings,
    transposed,
    turned_layer,
)
from defocus_cli.rendering.memory_budget import holds_cells, image_type, regions_at_once, room_on
from defocus_cli.rendering.outcome import Loaded, Outcome, Rendering
from defocus_cli.system import memory
from defocus_cli.system.arrays import Windows, bands, times
from defocus_cli.system.errors import TooLarge
from defocus_cli.system.process import set_to_render

if TYPE_CHECKING:
    from defocus_core import Behind, HiddenLayer, Pixels, Stream, Views

Progress = Callable[[int, int], None]
# Share of the pixels of left or right from which on a warning says that they were negative.
_MANY_CLAMPED = 0.01
_TRUSTED = 0.99  # share of the lens


def rendered(
    loaded: Loaded,
    radius: Any,
    outcome: Outcome,
    progress: Progress | None = None,
    seen: HiddenLayer | None = None,
) -> Rendering:
    """The images and maps that need rendering.

    Args:
        loaded: its decoded inputs.
        radius: signed CoC radius in px, [H, W].
        outcome: the job, and what is known of it so far.
        progress: called with (tiles done, tiles in all).
        seen: what other frames have seen of what is hidden.

    Raises:
        TooLarge: it does not fit into memory.
    """
    import torch

    set_to_render()
    images = _Images(outcome.job, loaded)
    wall, cpu = time.perf_counter(), time.process_time()
    stream = _fill(images, loaded, radius, outcome, progress, seen)
    if outcome.device == "cuda":
        torch.cuda.synchronize()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    scratch = {"scratch_mb": loaded.holding.arrays_mb} if loaded.holding.scratch else {}
    outcome = replace(
        outcome,
        repair=stream.repair,
        render_seconds=wall,
        render_cpu_seconds=cpu,
        stats={**stream.stats, "pixels_invented": images.invented, **scratch},
        warnings=(*outcome.warnings, *_clamped(stream.stats)),
    )
    return loaded.rendering(outcome, radius, images.planes, images.clamped)


def _clamped(stats: Mapping[str, float]) -> list[str]:
    """A warning if many pixels of left or right were negative."""
    share = stats.get("pixels_clamped", 0) / stats["pixels"]
    if share < _MANY_CLAMPED:
        return []
    why = "detail as fine as a pixel overshoots in half a lens"
    return [f"left, right: below 0 in {100 * share:.0f} % of the pixels, and made 0: {why}"]


def _fill(
    images: _Images,
    loaded: Loaded,
    radius: Any,
    outcome: Outcome,
    progress: Progress | None,
    seen: HiddenLayer | None,
) -> Stream:
    """Render as many regions at once as fit, and one by one if a GPU runs out of memory."""
    import torch

    job, at_once = outcome.job, None
    while True:
        images.clamped.clear()
        try:
            colors = renderings(loaded, outcome)
            for number, color in enumerate(colors):
                stream = stream_of(loaded, radius, outcome, seen, color)
                if at_once is None:
                    at_once, _ = regions_at_once(job, stream, loaded.holding, outcome.device)
                    if at_once < job.machine.threads:  # memory is short
                        memory.keep_freed(False)
                        memory.trim()
                shown = progress and partial(_of_all, progress, number, len(colors))
                images.invented = 0  # of one rendering
                for part in stream.regions(at_once, shown):
                    images.place(loaded.in_order(part), color)
            return stream
        except torch.OutOfMemoryError:  # other programs use the GPU, too
            torch.cuda.empty_cache()
            if at_once == 1:
                problem = "does not fit into the memory of the GPU"
                remedy = "use --device cpu, or a smaller --tile"
                raise TooLarge(job.picture.color, problem, remedy) from None
            at_once = 1


def _of_all(progress: Progress, number: int, count: int, done: int, tiles: int) -> None:
    """Report tiles of one of several renderings of a picture."""
    progress(number * tiles + done, count * tiles)


def stream_of(
    loaded: Loaded,
    radius: Any,
    outcome: Outcome,
    seen: HiddenLayer | None = None,
    colors: Colors | None = None,
) -> Stream:
    """The renderer of a job, which works region by region.

    Args:
        loaded: its decoded inputs.
        radius: signed CoC radius in px, [H, W].
        outcome: the job, and what is known of it so far.
        seen: what other frames have seen of what is hidden.
        colors: the channels to render; None for all.
    """
    from defocus_core import Settings, Stream, repair_through

    job, lens, device = outcome.job, outcome.lens, outcome.device
    channels, px, turned, shade = colors or Colors(tuple(range(len(loaded.color.planes))))
    image = lit(Windows(loaded.color.planes, device), loaded.color.channels, lens)
    image = chosen(image, channels)
    aperture, longer = aperture_in_pixels(lens, loaded.color.pixel_aspect, shade)
    infinity = None
    if not loaded.depth.is_radius:
        infinity = longer * (radius_at_infinity(lens, outcome.size) + px)
    settings = Settings(
        aperture=aperture,
        dual_pixel=dual_pixel_of(lens),
        cat_eye=cat_eye_of(lens, outcome.size),
        quality=outcome.quality,
        left_right=turned or any(kind.halves for kind in job.outputs.rows),
        threads=job.machine.threads,
        tile=job.machine.tile,
        infinity=infinity,
        depth_repair=job.reading.depth_repair,
        edge_width=job.reading.edge_width,
        decided=outcome.decided and repair_through(outcome.decided, longer, infinity),
    )
    if loaded.layers is not None:
        keeping = loaded.holding.keeping
        of_layers = [times(radius_map(lens, d, keeping)[0], longer) for d in loaded.layers.depths]
        known = layered(loaded.layers, of_layers, device)
        if known.open or known.deepest > 1:
            return Stream(known.picture(alpha=True), known.nearest(), settings, layered=known)
    elif loaded.plate is not None:
        own, behind = (times(array, longer) for array in radius.arrays)
        layers, repair = layers_of(loaded.color, loaded.plate, (own, behind), settings, device)
        stream = Stream(layers.picture(alpha=True), layers.nearest(), settings, layered=layers)
        stream.repair = repair
        return stream
    radii: Pixels = Windows([times(radius, longer, longer * px)], device, lone=True)
    behind = of_colors(_hidden(loaded, outcome, seen, longer), channels, longer * px, image)
    if turned:
        settings = replace(settings, aperture=aperture.transposed())
        image, radii = transposed(image), transposed(radii)
        behind = behind and turned_layer(behind)
    return Stream(
        image,
        radii,
        settings,
        behind,
        hold=holds_cells(image.shape, room_on(device, loaded.holding.room_mb)),
    )


class _Images:
    """The images of a job while they are rendered.

    Attributes:
        planes: each rendered kind's arrays [H, W]: C of each view of an image, one of a map.
        clamped: number of pixels of each kind that were clamped to the range of half.
        invented: number of pixels of which less than `_TRUSTED` of the lens saw what is there.
    """

    def __init__(self, job: Job, loaded: Loaded) -> None:
        height, width, channels = loaded.color.shape
        self.planes: dict[str, tuple[Any, ...]] = {}
        self.clamped: dict[str, int] = {}
        self.invented = 0
        for kind in job.outputs.rows:
            if not kind.rendered:
                continue
            count, dtype = (channels, image_type(job)) if kind.image else (1, "float32")
            count *= len(kind.rendered_as)
            self.planes[kind.name] = tuple(
                loaded.holding.keeping.new((height, width), dtype) for _ in range(count)
            )

    def place(self, part: Views, colors: Colors) -> None:
        """Copy a rendered region to its place: the channels and kinds that were rendered."""
        import numpy as np

        from defocus_cli.exr.writing import clamped_half
        from defocus_cli.system.arrays import to_array

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
                plane[rows, columns] = values


def _hidden(
    loaded: Loaded, outcome: Outcome, seen: HiddenLayer | None, longer: float
) -> Behind | None:
    """The known hidden layer: that of files, and beside it what other frames have seen."""
    from defocus_core import Behind

    behind = None if loaded.behind is None else _behind(loaded, outcome, longer)
    if seen is None:
        return behind
    color, radius, mask = (each.to(outcome.device) for each in seen)
    radius = radius * longer
    if behind is None:
        return Behind(color, radius, mask)
    given = behind.mask[:]
    return Behind(
        behind.color[:].where(given, color),
        behind.signed_radius[:].where(given, radius),
        given | mask,
    )


def _behind(loaded: Loaded, outcome: Outcome, longer: float) -> Behind:
    """The hidden layer: it is unknown where depth is inf and colour 0."""
    import numpy as np

    from defocus_core import Behind

    assert loaded.behind is not None
    color, depth = loaded.behind
    keeping = loaded.holding.keeping
    radius, _ = radius_map(outcome.lens, depth, keeping)
    known = keeping.new(depth.metres.shape, np.bool_)
    for rows in bands(depth.metres.shape):
        lit = np.logical_or.reduce([plane[rows] != 0 for plane in color.planes])
        known[rows] = np.isfinite(depth.metres[rows]) | lit
    device = outcome.device
    return Behind(
        Windows(color.planes, device),
        Windows([times(radius, longer)], device, lone=True),
        Windows([known], device, lone=True),
    )

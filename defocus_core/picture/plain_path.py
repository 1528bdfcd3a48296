"""The path of a picture: read, radii, scene, render, write.

Optional steps on this path are rows of `steps.table`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from defocus_core.errors import InputError, TooLarge, UsageProblem
from defocus_core.io.arrays import block_of, times
from defocus_core.io.exr.writing import clamped_half
from defocus_core.picture.memory_budget import (
    arrays_mb,
    base_mb,
    bound_of,
    capacity_mb,
    image_type,
    limit_mb,
    require_room,
)
from defocus_core.picture.pair import read as read_pair
from defocus_core.picture.radii import radii_of
from defocus_core.picture.scene import passes_of, settings_of, surfaces_of, to_array
from defocus_core.picture.steps.table import LENS, PASSES, RADII, READ, SCENE, apply_steps
from defocus_core.picture.take import InputPair, Inputs, Pass, Surfaces, Take
from defocus_core.picture.write import write
from defocus_core.request.job import Job
from defocus_core.request.output_kinds import KINDS
from defocus_core.system import memory
from defocus_core.system.process import delayed_signals, imports, may_have_gpu, set_to_render

if TYPE_CHECKING:
    from defocus_core.renderer.engine.renderer import Renderer
    from defocus_core.tensors.views import ViewTensors


__all__ = ["choose_device", "compute", "load", "prepare", "read", "renderers", "write"]


def read(job: Job) -> Inputs:
    """Decode the files of a job: colour, depth, and others such as a plate or matte, if any."""
    require_room(job)
    color, depth = read_pair(InputPair.from_job(job))
    warnings = *color.warnings, *depth.warnings
    inputs = Inputs(arrays_mb(job), color, depth, empty=depth.empty, warnings=warnings)
    return apply_steps(READ, Take(job=job, inputs=inputs, lens=job.lens)).inputs


def prepare(job: Job, inputs: Inputs) -> Take:
    """Find the focus, and compute the blur radii of a picture, before it is rendered."""
    depth = inputs.depth
    if "depth" in job.outputs.kinds and depth.is_radius:
        holds = "relative disparity" if depth.is_relative else "radii"
        problem = f"holds {holds}, of which no depth can be written"
        raise InputError("radii", problem, "leave depth out of the outputs", path=depth.path)
    take = apply_steps(LENS, Take(job=job, inputs=inputs, lens=job.lens))
    radii, device = radii_of(take.lens, depth), choose_device(job.machine.device)
    take = replace(take, radii=radii, shown=radii.px, limits=radii.limits, device=device)
    take = apply_steps(RADII, take)
    return replace(take, warnings=(*take.warnings, *radii.warnings, *inputs.warnings))


def compute(take: Take, progress: Progress | None = None) -> Take:
    """Render the images and maps of a job; `take` must come from `prepare`.

    As many regions of the picture are computed at once as fit into memory; if a GPU runs out of
    memory, one by one. `progress` is called with the numbers of finished tiles and of all tiles.
    """
    job, inputs = take.job, take.inputs
    if not job.outputs.need_rendering:
        return take
    from defocus_core.renderer.compiled.carried import available

    begun = time.perf_counter(), time.process_time()
    if available() and (alone := _views_alone(take)) is not None:
        views, bound = alone
        images = _Images(take)
        images.bound = bound
        images.place(views)
        if progress is not None:
            progress(1, 1)
        return _rendered(take, images, views.stats, "compiled", begun)
    set_to_render()
    import torch

    images, limit = _Images(take), limit_mb(job.machine)
    surfaces = surfaces_of(take)
    passes = passes_of(surfaces)
    try:
        for number, (each, renderer) in enumerate(renderers(take, passes)):
            images.reach = max(images.reach, renderer.frame.farthest)
            bound = bound_of(job, renderer, inputs.arrays_mb, take.device)
            images.bound = max(images.bound, bound)
            if bound > _LARGE_MB or memory.held_mb() + bound > limit:
                memory.trim()  # much of the input is freed
            shown = partial(_of_all, progress, limit, number, len(passes))
            images.invented = 0  # passes count the same pixels
            for part in renderer.tiles(shown):
                images.place(part, each, first=number == 0)
    except torch.OutOfMemoryError:  # other programs use the GPU, too
        problem = "does not fit into the memory of the GPU"
        remedy = "use ‹device› cpu, or a smaller ‹tile›"
        raise TooLarge("out-of-memory", problem, remedy, path=job.picture.color) from None
    if take.device == "cuda":
        torch.cuda.synchronize()
    take = replace(take, lamps=surfaces.lamps, repair=surfaces.repair)
    return _rendered(take, images, renderer.stats, renderer.back, begun)


def _views_alone(take: Take) -> tuple[ViewTensors, float] | None:
    """Render a picture by compiled loops, as NumPy arrays, without importing torch (1 s faster).

    Returns:
        The views and an upper bound of the memory in MB; or None if torch is needed, because there
        are several surfaces, depth may need repair, or memory or settings do not allow it.
    """
    from defocus_core.renderer.compiled.carried import CHANNELS, bytes_of_loops, carries_settings
    from defocus_core.tensors.box import Box
    from defocus_core.tensors.views import ViewTensors

    color, reading = take.inputs.color, take.job.reading
    if take.device != "cpu" or len(color.planes) != CHANNELS or not _is_plain(take):
        return None
    infinity = None if take.radii.infinity is None else take.longer_axis * take.radii.infinity
    settings = replace(settings_of(take), depth_repair=reading.depth_repair, infinity=infinity)
    height, width = take.shown.shape
    bound = bytes_of_loops((height, width), settings, edges=True) / memory.MB
    fits = take.inputs.arrays_mb + bound <= capacity_mb(take.job.machine)
    if not (fits and carries_settings(settings)):
        return None
    from defocus_core.renderer.compiled.arrays import rendered_alone
    from defocus_core.renderer.compiled.once import compile_once

    compile_once()
    px = np.ascontiguousarray(times(take.radii.px, take.longer_axis), np.float32)
    views = rendered_alone(block_of(color.planes), px, settings)
    if views is None:
        return None
    arrays: Any = [*views.images], views.trust
    return ViewTensors(arrays[0], arrays[1], views.stats, Box(0, 0, height, width)), bound


def _is_plain(take: Take) -> bool:
    """Whether a picture has one surface and needs one rendering, independent of other frames."""
    from defocus_core.depth.diagnosis import DepthRepair

    color, reading = take.inputs.color, take.job.reading
    if color.is_cut or reading.edge_width is not None or take.decided is not None:
        return False
    surfaces = Surfaces(take, (color,), (take.radii,), (), (), DepthRepair())
    steps = {step.name for step in SCENE if step.applies(surfaces)}
    whole = Pass(take, cast(Any, None), cast(Any, None), (), ())
    return steps <= {"scene:repair_surfaces"} and not any(p.applies((whole,)) for p in PASSES)


def _rendered(
    take: Take, images: _Images, counts: Mapping[str, int], back: str, begun: tuple[float, float]
) -> Take:
    """Add rendered images and statistics to a take; `begun`: wall and CPU seconds at the start."""
    from defocus_core.depth.diagnosis import DepthRepair

    stats: dict[str, float] = {**counts, "pixels_invented": images.invented}
    if take.lamps is not None:
        stats["lights"] = take.lamps
    return replace(
        take,
        repair=take.repair or DepthRepair(),
        images=images.planes,
        clamped=images.clamped,
        reach=images.reach,
        back=back,
        bound_mb=images.bound if take.device == "cpu" else 0.0,
        seconds=time.perf_counter() - begun[0],
        cpu_seconds=time.process_time() - begun[1],
        stats=stats,
        warnings=(*take.warnings, *_doubts(take, counts)),
    )


def choose_device(name: str) -> str:
    """The device to render on, ``cpu`` or ``cuda``, for the option value auto, cpu or cuda."""
    available = False
    if name == "cuda" or (name == "auto" and may_have_gpu()):
        import torch

        available = torch.cuda.is_available()
    if name == "cuda" and not available:
        remedy = "use ‹device› cpu or auto"
        raise UsageProblem("no-gpu", "PyTorch finds no CUDA GPU here", remedy, field="device")
    return "cuda" if available else "cpu"


def load() -> None:
    """Import the libraries that every rendering needs, and configure memory allocation."""
    memory.share_heap()
    memory.keep_freed()  # freed inputs leave room for rendering
    with delayed_signals(), imports():
        import OpenImageIO  # noqa: F401

        from defocus_core.renderer.compiled.carried import available

        if available():
            import defocus_core.renderer.compiled.arrays  # noqa: F401
    base_mb()


Progress = Callable[[int, int], None]
# Share of negative pixels of left or right, from which on there is a warning.
_MANY_CLAMPED = 0.01
_TRUSTED = 0.99  # share of the lens
_LARGE_MB = 500.0  # bound of a picture that takes so long that giving memory back hardly counts
_FULL = 0.9  # share of the memory limit, from which on freed memory is given back


def renderers(take: Take, passes: tuple[Pass, ...]) -> Iterator[tuple[Pass, Renderer]]:
    """Yield each pass with its renderer."""
    from defocus_core.renderer.engine.renderer import Renderer
    from defocus_core.renderer.engine.scene import in_colors

    for each in passes:
        scene = in_colors(each.scene, each.light, each.px)
        yield each, Renderer(scene, each.settings)


def _doubts(take: Take, stats: Mapping[str, float]) -> Iterator[str]:
    """Warn of an edge-width without effect, and of many negative pixels in left or right."""
    width = take.job.reading.edge_width
    is_repaired = take.repair is not None and take.repair.fraction
    if width is not None and not (is_repaired or take.inputs.plate):
        yield f"{take.inputs.depth.path.name}: ‹edge-width› {width:g}px changes no pixel"
    if (fraction := stats.get("pixels_clamped", 0) / stats["pixels"]) >= _MANY_CLAMPED:
        why = "detail as fine as a pixel overshoots in half a lens"
        yield f"left, right: below 0, and set to 0, in {100 * fraction:.0f} % of the pixels: {why}"


def _of_all(
    progress: Progress | None, limit: float, number: int, count: int, done: int, tiles: int
) -> None:
    """Report progress over `count` passes; return freed memory to the system if little is left.

    In the pass of index `number`, `done` of `tiles` tiles are finished; `limit` is in MB.
    """
    if memory.held_mb() > _FULL * limit:
        memory.trim()
    if progress is not None:
        progress(number * tiles + done, count * tiles)


class _Images:
    """The images of a job while they are rendered.

    Attributes:
        planes: For each rendered kind its arrays [H, W]: all channels of each view, or one for a
            map.
        clamped: Number of pixels of each kind that were clamped to the range of half.
        reach: Greatest distance in px by which blur moves light.
        bound: Upper bound of the memory of rendering, in MB.
        invented: Number of pixels with a trust below `_TRUSTED`.
    """

    def __init__(self, take: Take) -> None:
        job, (height, width, channels) = take.job, take.inputs.color.shape
        self.planes: dict[str, tuple[Any, ...]] = {}
        self.clamped: dict[str, int] = {}
        self.reach = self.invented = 0
        self.bound = 0.0
        for kind in job.outputs.rows:
            if not kind.rendered:
                continue
            dtype = image_type(job) if kind.image else "float32"
            count = len(kind.rendered) * (channels if kind.whole else 1)
            self.planes[kind.name] = tuple(np.zeros((height, width), dtype) for _ in range(count))

    def place(self, part: ViewTensors, of: Pass | None = None, *, first: bool = True) -> None:
        """Copy a rendered region into the planes.

        `of` is its pass, None if it has all colours. `first` tells whether it is the first pass; in
        later ones, trust is the minimum with that of the passes before.
        """
        if of and of.order:
            part = part._replace(images=[image[list(of.order)] for image in part.images])
        top, left, height, width = part.box
        rows, columns = slice(top, top + height), slice(left, left + width)
        self.invented += int(np.count_nonzero(to_array(part.trust) < _TRUSTED))
        for kind, planes in self.planes.items():
            row = KINDS[kind]
            views = [to_array(getattr(part, view)) for view in row.rendered]
            if of and row.whole and len(of.channels) * len(views) < len(planes):
                apart, some = len(planes) // len(views), of.channels
                planes = tuple(planes[v * apart + c] for v in range(len(views)) for c in some)
            pixels = views[0] if len(views) == 1 else np.concatenate(views)
            pixels = pixels.reshape(len(planes), height, width)
            if planes[0].dtype == np.float16:
                pixels, beyond = clamped_half(pixels)
                if beyond.any():
                    count = int(np.count_nonzero(beyond.any(axis=0)))
                    self.clamped[kind] = self.clamped.get(kind, 0) + count
            for plane, values in zip(planes, pixels, strict=True):
                if not (first or row.whole):
                    values = np.minimum(values, plane[rows, columns])
                plane[rows, columns] = values

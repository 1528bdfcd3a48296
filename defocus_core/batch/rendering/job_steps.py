"""Steps of a job before it is written: read its inputs, compute its pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from defocus_core.batch.depth.focusing import quality_of, radius_map
from defocus_core.batch.depth.implausible import implausible
from defocus_core.batch.elements.deep import layers_of_scene
from defocus_core.batch.elements.overscan import overscan_of
from defocus_core.batch.elements.planes import Either
from defocus_core.batch.elements.plate import read_over
from defocus_core.batch.jobs.job import Job, Picture, Reading
from defocus_core.batch.rendering.memory_budget import Holding, base_mb, capacity_mb, holding
from defocus_core.batch.rendering.outcome import Loaded, Outcome, Rendering
from defocus_core.batch.rendering.render_picture import rendered
from defocus_core.batch.rendering.shot_decisions import decided_words, shot_focused, shot_repair
from defocus_core.batch.rendering.shot_frames import with_neighbours
from defocus_core.errors import InputError, TooLarge, UsageProblem
from defocus_core.io.arrays import IN_MEMORY, Keeping
from defocus_core.io.exr.views import require_view
from defocus_core.io.exr.windows import Overscan
from defocus_core.system import memory
from defocus_core.system.interrupts import put_off
from defocus_core.system.process import imports

if TYPE_CHECKING:
    from defocus_core.io.depth_formats.depth import Depth
    from defocus_core.io.images.color_planes import Color


def load_inputs(job: Job) -> Loaded:
    """Decode the picture of a job, and what lies behind it if that is wanted and there.

    Raises:
        InputError: an input cannot be used.
        UsageProblem: the options make no sense for it.
    """
    if job.reading.blur_channels and job.outputs.format != "exr":
        problem = f"has no effect in {job.outputs.format}, which holds the picture alone"
        raise UsageProblem("idle-option", problem, "use ‹format› exr", field="blur-channels")
    picture, held, left = job.picture, holding(job), capacity_mb(job.machine)
    if (at_once := held.files_mb + held.whole_mb * held.scratch) > left and held.whole_mb:
        problem = f"takes {at_once:.0f} MB to decode, {left:.0f} MB are left"
        raise TooLarge(
            "out-of-memory", problem, "save it as EXR, or allow more ‹memory›", path=picture.color
        )
    if picture.over is not None:
        return _over_plate(job, held)
    color, depth = read(picture, job.reading, held.keeping, job.lens_focal)
    if not job.outputs.need_rendering:
        return Loaded(held, color, depth)
    if (loaded := _with_layers(job, Loaded(held, color, depth))).layers is not None:
        return loaded
    if picture.hidden is None:
        return Loaded(held, color, depth)
    behind, behind_depth = read(picture.hidden, job.reading, held.keeping, job.lens_focal)
    if behind.shape != color.shape:
        size, wanted = (
            f"{width}x{height} px of {channels} channels"
            for height, width, channels in (behind.shape, color.shape)
        )
        problem = f"is {size} but the picture is {wanted}"
        raise InputError(
            "wrong-size", problem, "give ‹hidden› of the same kind", path=picture.hidden.color
        )
    return Loaded(held, color, depth, (behind, behind_depth))


def _over_plate(job: Job, held: Holding) -> Loaded:
    """An element and the plate that it lies over, decoded.

    Raises:
        InputError: an input cannot be used.
        UsageProblem: a hidden layer is given, too.
    """
    if job.picture.hidden is not None:
        raise UsageProblem(
            "contradiction", "stands beside ‹over›", "the plate is what lies behind", field="hidden"
        )

    def read_one(one: Picture, reading: Reading, most: Overscan) -> tuple[Color, Depth]:
        return read(one, reading, held.keeping, job.lens_focal, most)

    color, depth, plate = read_over(job.picture, job.reading, read_one, held.keeping)
    loaded = Loaded(held, color, depth, plate=plate)
    return _with_layers(job, loaded) if job.outputs.need_rendering else loaded


def _with_layers(job: Job, loaded: Loaded) -> Loaded:
    """A picture with its samples if it is deep or has a holdout."""
    picture = job.picture
    layers = layers_of_scene(
        picture,
        job.reading,
        parts_of(picture, job.reading)[0],
        (loaded.color, loaded.depth),
        loaded.plate,
        loaded.holding.keeping,
        job.lens_focal,
    )
    if layers is None:
        return loaded
    note = f"{loaded.color.note}, {layers.words}"
    return replace(loaded, color=replace(loaded.color, note=note), layers=layers)


def compute(
    job: Job, loaded: Loaded, progress: Callable[[int, int], None] | None = None
) -> Rendering:
    """The images and maps that a job asks for.

    Args:
        job: the job.
        loaded: its decoded inputs.
        progress: called with (tiles done, tiles in all) while it renders.

    Raises:
        InputError: the picture cannot be taken with this lens, or does not fit into memory.
        UsageProblem: the options make no sense for this picture or machine.
    """
    outcome, radius = prepare(job, loaded)
    if not job.outputs.need_rendering:
        return loaded.rendering(outcome, radius)
    outcome, quiet, seen = with_neighbours(outcome, loaded, radius, _read_for)
    return replace(rendered(loaded, quiet, outcome, progress, seen), radius=radius)


def prepare(job: Job, loaded: Loaded) -> tuple[Outcome, Any]:
    """The outcome as far as it is known before rendering, and the signed radii [H, W] in px.

    Raises:
        InputError: the picture cannot be taken with this lens.
        UsageProblem: the options make no sense for this picture or machine.
    """
    if "depth" in job.outputs.kinds and loaded.depth.is_radius:
        problem = "holds radii, of which no depth can be written"
        raise InputError("radii", problem, "leave depth out of the outputs", path=loaded.depth.path)
    lens = shot_focused(job, loaded, _read_for)
    decided = shot_repair(job, lens, loaded, _read_for)
    radius, ends = radius_map(lens, loaded.depth, loaded.holding.keeping)
    likely = implausible(loaded.depth, radius, ends, lens, declared=job.reading.says_scale)
    if loaded.plate is not None:
        behind, behind_ends = radius_map(lens, loaded.plate.depth, loaded.holding.keeping)
        radius = Either(radius, loaded.depth.nothing, behind)
        ends = (min(ends[0], behind_ends[0]), max(ends[1], behind_ends[1]))
    outcome = Outcome(
        job=job,
        lens=lens,
        size=loaded.depth.size,
        coc_px=ends,
        color_note=loaded.color.note,
        depth_note=loaded.depth.note,
        device=choose_device(job.machine.device),
        quality=quality_of(job.machine, ends),
        warnings=(*likely, *_warnings(loaded)),
        decided=decided,
        shot_note=decided_words(job.shot, decided),
    )
    return outcome, radius


def _read_for(job: Job, keeping: Keeping) -> tuple[Color, Depth]:
    """Colour and depth of the picture of a job."""
    return read(job.picture, job.reading, keeping, job.lens_focal)


def _warnings(loaded: Loaded) -> tuple[str, ...]:
    """Warnings about what the files hold and the renderer ignores."""
    behind = () if loaded.behind is None else loaded.behind[0].warnings
    hidden_warnings = (f"hidden: {warning}" for warning in behind)
    plate = () if loaded.plate is None else loaded.plate.warnings
    return *loaded.color.warnings, *loaded.depth.warnings, *hidden_warnings, *plate


def load() -> None:
    """Import torch and the renderer, which takes seconds, and set up the allocator."""
    memory.share_heap()
    memory.keep_freed(True)  # what is read leaves room for what is rendered
    with put_off(), imports():
        import torch  # noqa: F401

        import defocus_core.renderer.stream  # noqa: F401
    base_mb()


def choose_device(name: str) -> str:
    """``cpu`` or ``cuda``.

    Raises:
        UsageProblem: ``cuda`` was asked for and there is none.
    """
    import torch

    available = name != "cpu" and torch.cuda.is_available()
    if name == "cuda" and not available:
        raise UsageProblem(
            "no-gpu", "PyTorch finds no CUDA GPU here", "use ‹device› cpu or auto", field="device"
        )
    return "cuda" if available else "cpu"


def parts_of(picture: Picture, reading: Reading) -> tuple[int | None, int | None]:
    """The part to read in the colour and in the depth file; None where there is only one.

    Raises:
        InputError: neither file has such a part.
    """
    if reading.part is None:
        return None, None
    from defocus_core.io.array_files.containers import container_type
    from defocus_core.io.images.describe import describe
    from defocus_core.io.images.exr_channels import require_part
    from defocus_core.io.safe_files import read_head

    if container_type(read_head(picture.depth, 32)):  # which has frames
        return reading.part if len(describe(picture.color).parts) > 1 else None, reading.part
    paths = (picture.color, picture.depth)
    color, depth = (len(describe(path).parts) for path in paths)
    if picture.color == picture.depth or max(color, depth) == 1:
        require_part(picture.color, reading.part, color)
    return reading.part if color > 1 else None, reading.part if depth > 1 else None


def read(
    picture: Picture,
    reading: Reading,
    keeping: Keeping = IN_MEMORY,
    lens_focal: float | None = None,
    most: Overscan | None = None,
) -> tuple[Color, Depth]:
    """Colour and depth of the same size, whose pixels are all valid.

    Args:
        picture: where they are.
        reading: options that say how to read them.
        keeping: whether they go to memory or to scratch files.
        lens_focal: focal length of the lens in widths of its sensor, where depth needs it.
        most: the most pixels beyond the picture shown that are read; None for no limit.

    Raises:
        InputError: a file cannot be used.
        UsageProblem: the options make no sense for it.
    """
    from defocus_core.batch.depth.resizing import of_size
    from defocus_core.batch.elements.alpha import element_depth
    from defocus_core.io.depth_formats.depth import read_depth, require_valid
    from defocus_core.io.images.color import read_color, require_finite

    shared = picture.color == picture.depth
    parts = parts_of(picture, reading)
    require_view((picture.color, picture.depth), reading.view)
    overscan = overscan_of(picture, reading, parts)
    overscan = overscan if most is None else overscan.within(most)
    color = read_color(
        picture.color,
        layer=reading.color_layer,
        part=parts[0],
        view=reading.view,
        keeping=keeping,
        overscan=overscan,
        blur_channels=reading.blur_channels,
    )
    depth = read_depth(
        picture.depth,
        replace(reading, part=parts[1]),
        keeping=keeping,
        size=color.size,
        lens_focal=lens_focal,
        overscan=overscan,
        alpha=color.alpha,
    )
    radial = (reading.geometry or reading.row.geometry) == "radial"
    if radial and color.pixel_aspect != 1:
        problem = "holds distances to the point, and the pixels of the colour are not square"
        raise InputError(
            "not-square", problem, "convert it to depth along the axis", path=picture.depth
        )
    if shared and len(color.channels) == 1 and not color.extras:
        problem = f"has {depth.channel} alone, which is not both colour and depth"
        raise InputError(
            "no-depth", problem, "give the depth file as a second argument", path=picture.color
        )
    depth = element_depth(of_size(depth, color, reading, keeping), color, keeping)
    require_valid(depth)
    require_finite(color)
    return color, depth

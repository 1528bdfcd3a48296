"""The steps of a job: read, compute, write. What is written has been computed to its end."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_cli.errors import InputError, TooLarge, UsageProblem
from defocus_cli.focusing import focused, signed_radius
from defocus_cli.interrupts import put_off
from defocus_cli.job import IMAGE_KINDS, RENDERED_KINDS, Job, Lens, Picture, Reading

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from defocus_cli.depth import Depth
    from defocus_cli.images import Color


@dataclass(frozen=True)
class Outcome:
    """What became of a job."""

    job: Job
    lens: Lens  # with the focus distance that was found
    size: tuple[int, int]  # width, height
    coc_px: tuple[float, float]  # smallest and largest signed radius
    depth_note: str
    device: str
    render_seconds: float = 0.0
    render_cpu_seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    stats: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Loaded:
    """A picture, decoded; and what lies behind it, where a job needs and has it."""

    color: Color
    depth: Depth
    behind: tuple[Color, Depth] | None = None


@dataclass(frozen=True)
class Made:
    """What a job computed.

    Attributes:
        outcome: how.
        color: what it was made of, for the metadata and further channels to carry along.
        radius: signed CoC radius in px, [H, W].
        images: kind to linear pixels [H, W, C], and trust [H, W].
    """

    outcome: Outcome
    color: Color
    radius: NDArray[np.float32]
    images: Mapping[str, NDArray[np.float32]]


def load_inputs(picture: Picture, reading: Reading, *, hidden: bool) -> Loaded:
    """Decode a picture, and what lies behind it if ``hidden`` is wanted and there.

    Raises:
        InputError: an input cannot be used.
        UsageProblem: the options make no sense for it.
    """
    color, depth = read(picture, reading)
    if picture.hidden is None or not hidden:
        return Loaded(color, depth)
    behind, behind_depth = read(picture.hidden, reading)
    if behind.pixels.shape != color.pixels.shape:
        told, wanted = (
            f"{width}x{height} px of {channels} channels"
            for height, width, channels in (behind.pixels.shape, color.pixels.shape)
        )
        problem = f"is {told} but the picture is {wanted}"
        raise InputError(picture.hidden.color, problem, "give --hidden of the same kind")
    return Loaded(color, depth, (behind, behind_depth))


def needs_hidden(job: Job) -> bool:
    """Whether a job would look at what lies behind."""
    return bool(set(job.outputs.kinds) & set(RENDERED_KINDS))


def compute(job: Job, loaded: Loaded, progress: Callable[[int, int], None] | None = None) -> Made:
    """All that a job asks for, computed from its picture.

    Args:
        job: what to do.
        loaded: its picture.
        progress: called with (tiles done, tiles in all) while it renders.

    Raises:
        InputError: the picture cannot be taken with this lens, or does not fit into memory.
        UsageProblem: the options make no sense for this picture or machine.
    """
    device = choose_device(job.machine.device)
    height, width = loaded.depth.metres.shape
    lens = focused(job.lens, loaded.depth)
    radius = signed_radius(lens, loaded.depth.metres, (width, height))
    outcome = Outcome(
        job=job,
        lens=lens,
        size=(width, height),
        coc_px=(float(radius.min()), float(radius.max())),
        depth_note=loaded.depth.note,
        device=device,
    )
    images: dict[str, Any] = {}
    if set(job.outputs.kinds) & set(RENDERED_KINDS):
        known = None if loaded.behind is None else _known(*loaded.behind, lens)
        images, outcome = _render(loaded.color, radius, known, outcome, progress)
    return Made(outcome, loaded.color, radius, images)


def write(made: Made) -> Outcome:
    """Write what a job computed: all its files or none.

    Raises:
        InputError: a file cannot be written.
    """
    from defocus_cli.delivery import deliver

    warnings = deliver(made.color, made.radius, made.images, made.outcome)
    return dataclasses.replace(made.outcome, warnings=warnings)


def load() -> None:
    """Import what takes seconds to import."""
    with put_off():
        import torch  # noqa: F401

        import defocus_core  # noqa: F401


def choose_device(name: str) -> str:
    """``cpu`` or ``cuda``.

    Raises:
        UsageProblem: ``cuda`` was asked for and there is none.
    """
    import torch

    found = name != "cpu" and torch.cuda.is_available()
    if name == "cuda" and not found:
        raise UsageProblem("--device", "PyTorch finds no CUDA GPU here", "use --device cpu or auto")
    return "cuda" if found else "cpu"


def part_of(path: Path, reading: Reading, *, shared: bool) -> int | None:
    """Which part ``--part`` means in a file; None for one that has no other, if it is not alone.

    Raises:
        InputError: the file holds both colour and depth, and has no such part.
    """
    if reading.part is None:
        return None
    from defocus_cli.images import describe

    count = len(describe(path).parts)
    if shared and reading.part >= count:
        problem = f"has no part {reading.part}, only {count}"
        raise InputError(path, problem, "leave --part out" if count == 1 else "it counts from 0")
    return reading.part if count > 1 else None


def _known(
    behind: Color, depth: Depth, lens: Lens
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Pixels [H, W, C], signed radius [H, W] px and mask [H, W] of what is known to lie behind."""
    import numpy as np

    height, width = depth.metres.shape
    known = np.isfinite(depth.metres) | (behind.pixels != 0).any(-1)
    return behind.pixels, signed_radius(lens, depth.metres, (width, height)), known


def read(picture: Picture, reading: Reading) -> tuple[Color, Depth]:
    """Colour and depth of one size, all of whose pixels can be rendered.

    Raises:
        InputError: a file cannot be used.
    """
    from defocus_cli.depth import read_depth, require_valid
    from defocus_cli.images import read_color, require_finite

    shared = picture.color == picture.depth
    color = read_color(
        picture.color,
        layer=reading.color_layer,
        part=part_of(picture.color, reading, shared=shared),
    )
    depth = read_depth(
        picture.depth,
        channel=reading.depth_channel,
        part=part_of(picture.depth, reading, shared=shared),
        unit=reading.depth_unit,
    )
    (height, width), (rows, columns) = color.pixels.shape[:2], depth.metres.shape
    if (height, width) != (rows, columns):
        raise InputError(
            picture.depth,
            f"is {columns}x{rows} px but {picture.color} is {width}x{height} px",
            "give depth of the size of the colour",
        )
    require_valid(depth)
    require_finite(color)
    return color, depth


def _render(
    color: Color,
    radius: NDArray[np.float32],
    known: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]] | None,
    outcome: Outcome,
    progress: Callable[[int, int], None] | None,
) -> tuple[dict[str, Any], Outcome]:
    """The images [H, W, C] and trust [H, W] asked for, and the outcome with what they cost."""
    import torch

    from defocus_cli.forecast import refuse_too_large
    from defocus_core import Aperture, HiddenLayer, render

    job, device = outcome.job, outcome.device
    # Threads work on tiles; torch's own threads inside each would only wait for one another.
    torch.set_num_threads(1)
    image = torch.from_numpy(color.pixels.transpose(2, 0, 1).copy()).to(device)  # [C, H, W]
    signed = torch.from_numpy(radius).to(device)
    refuse_too_large(job, outcome.lens, image, signed, device=device)
    hidden = None
    if known is not None:
        behind, *rest = (torch.from_numpy(x).to(device) for x in known)
        hidden = HiddenLayer(behind.permute(2, 0, 1), *rest)

    wall, cpu = time.perf_counter(), time.process_time()
    try:
        rendering = render(
            image,
            signed,
            aperture=Aperture(outcome.lens.blades, outcome.lens.blade_rotation),
            quality=job.machine.quality,
            left_right=bool({"left", "right"} & set(job.outputs.kinds)),
            hidden=hidden,
            threads=job.machine.threads,
            progress=progress,
        )
    except torch.OutOfMemoryError:
        problem = "does not fit into the memory of the GPU"
        raise TooLarge(job.picture.color, problem, "use --device cpu") from None
    if device == "cuda":
        torch.cuda.synchronize()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    kinds = [kind for kind in IMAGE_KINDS if kind in job.outputs.kinds]
    images = {kind: getattr(rendering, kind).permute(1, 2, 0).cpu().numpy() for kind in kinds}
    if "trust" in job.outputs.kinds:
        images["trust"] = rendering.trust[0].cpu().numpy()
    return images, dataclasses.replace(
        outcome, render_seconds=wall, render_cpu_seconds=cpu, stats=rendering.stats
    )

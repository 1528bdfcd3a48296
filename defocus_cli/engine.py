"""Runs a job: read, render, write. Nothing of a picture is written before all of it is computed."""

from __future__ import annotations

import dataclasses
import math
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_cli.errors import InputError, UsageProblem, reason
from defocus_cli.job import IMAGE_KINDS, RENDERED_KINDS, Job, Lens, Picture, Reading
from defocus_cli.lens_file import refuse_near_focus

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from defocus_cli.depth import Depth
    from defocus_cli.images import Color

MM_PER_M = 1000.0


@dataclass(frozen=True)
class Outcome:
    """What became of a job."""

    job: Job
    lens: Lens  # with the focus distance that --focus-at found
    size: tuple[int, int]  # width, height
    coc_px: tuple[float, float]  # smallest and largest signed radius
    depth_note: str
    device: str
    render_seconds: float = 0.0
    render_cpu_seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    stats: Mapping[str, float] = field(default_factory=dict)


def run(job: Job, progress: Callable[[int, int], None] | None = None) -> Outcome:
    """Read, render and write one picture.

    Args:
        job: what to do.
        progress: called with (tiles done, tiles in all) while it renders.

    Raises:
        InputError: an input or output cannot be used.
        UsageProblem: the options make no sense for this picture or machine.
    """
    from defocus_cli.delivery import deliver

    device = choose_device(job.machine.device)
    color, depth = read(job.picture, job.reading)
    height, width = depth.metres.shape
    lens = focused(job.lens, depth)
    radius = signed_radius(lens, depth.metres, (width, height))
    outcome = Outcome(
        job=job,
        lens=lens,
        size=(width, height),
        coc_px=(float(radius.min()), float(radius.max())),
        depth_note=depth.note,
        device=device,
    )
    images: dict[str, Any] = {}
    if set(job.outputs.kinds) & set(RENDERED_KINDS):
        known = None
        if job.picture.hidden is not None:
            known = _known(job.picture.hidden, job.reading, color, lens)
        images, outcome = _render(color, radius, known, outcome, progress)
    return dataclasses.replace(outcome, warnings=deliver(color, radius, images, outcome))


def load() -> None:
    """Import what takes seconds to import."""
    with interrupts_held():
        import torch  # noqa: F401

        import defocus_core  # noqa: F401


@contextmanager
def interrupts_held() -> Iterator[None]:
    """Put Ctrl-C off to the end: an import that it hits swallows it, or leaves half a module."""
    pressed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        raise KeyboardInterrupt


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


def focused(lens: Lens, depth: Depth) -> Lens:
    """The lens with its focus distance known, looked up in ``depth`` for ``--focus-at``."""
    if lens.focus_at is None:
        return lens
    (x, y), (height, width) = lens.focus_at, depth.metres.shape
    if not (0 <= x < width and 0 <= y < height):
        raise UsageProblem(
            "--focus-at",
            f"{x},{y} lies outside {depth.path} of {width}x{height} px",
            f"give X from 0 to {width - 1} and Y from 0 to {height - 1}",
        )
    foc_dist = float(depth.metres[y, x]) * MM_PER_M
    refuse_near_focus(foc_dist, lens.foclen, f"--focus-at: {depth.path} at {x},{y}")
    return dataclasses.replace(lens, foc_dist=foc_dist)


def signed_radius(
    lens: Lens, metres: NDArray[np.float32], size: tuple[int, int]
) -> NDArray[np.float32]:
    """Signed CoC radius in px at depths in metres, for pictures of ``size`` (width, height)."""
    import numpy as np
    import torch

    from defocus_core import DefocusLens

    width, height = size
    sensor = (lens.sensor_width, lens.sensor_width * height / width)
    depth_mm = torch.from_numpy(metres.astype(np.float64)) * MM_PER_M
    try:
        thin = DefocusLens(lens.foclen, lens.fnum, sensor, (width, height), dtype=torch.float64)
        thin.refocus(math.inf if lens.foc_dist is None else lens.foc_dist)
    except ValueError as error:
        raise UsageProblem("--focus", reason(error), "check the lens options") from error
    radius: NDArray[np.float32] = thin.signed_radius(depth_mm).float().numpy()
    return radius


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
    hidden: Picture, reading: Reading, color: Color, lens: Lens
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Pixels [H, W, C], signed radius [H, W] px and mask [H, W] of what is known to lie behind."""
    import numpy as np

    behind, depth = read(hidden, reading)
    if behind.pixels.shape != color.pixels.shape:
        told, wanted = (
            f"{width}x{height} px of {channels} channels"
            for height, width, channels in (behind.pixels.shape, color.pixels.shape)
        )
        raise InputError(
            hidden.color, f"is {told} but the picture is {wanted}", "give --hidden of the same kind"
        )
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
            aperture=Aperture(job.lens.blades, job.lens.blade_rotation),
            quality=job.machine.quality,
            left_right=bool({"left", "right"} & set(job.outputs.kinds)),
            hidden=hidden,
            threads=job.machine.threads,
            progress=progress,
        )
    except torch.OutOfMemoryError:
        problem = "does not fit into the memory of the GPU"
        raise InputError(job.picture.color, problem, "use --device cpu") from None
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

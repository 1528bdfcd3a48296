"""Renders a shot by each method and measures what came out, how long it took and in how much.

Methods are the qualities of the renderer and the baselines it has to beat.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from defocus_cli import memory
from defocus_cli.errors import InputError
from defocus_cli.fft_unit import FftUnit, timed
from defocus_cli.focusing import radius_at_infinity
from defocus_cli.process_settings import set_to_render

if TYPE_CHECKING:
    from torch import Tensor

    from defocus_cli.bench_set import Pictures, Shot
    from defocus_core.metrics import Errors

BASELINES = {"input": "the sharp input", "sum": "plain sum of slices", "over": "over / alpha"}


@dataclass(frozen=True)
class Row:
    """One shot by one method.

    Attributes:
        scene: name.
        shot: name.
        method: a quality or a baseline.
        errors: against the truth.
        seconds: of the rendering alone, the median of its repetitions.
        fft_units: the same in transforms of the frame there and back, RGBA float32, of one thread.
        peak_mb: most memory that the process held meanwhile, MB; None where no system tells.
    """

    scene: str
    shot: str
    method: str
    errors: Errors
    seconds: float
    fft_units: float
    peak_mb: float | None


def measure_shot(
    shot: Shot,
    pictures: Pictures,
    methods: Sequence[str],
    *,
    device: str,
    threads: int,
    repeat: int,
) -> Iterator[Row]:
    """One row for each method, when it is done.

    Raises:
        InputError: the picture does not fit into the memory of the GPU.
    """
    import torch

    from defocus_core import metrics

    sharp, radius = pictures.sharp.to(device), pictures.signed_radius.to(device)
    try:
        unit = FftUnit(sharp).seconds()
        for method in methods:
            work = _work(method, shot, sharp, radius, threads)
            memory.reset_peak(device)
            picture, seconds = timed(work, repeat)
            peak = memory.peak_mb(device)
            errors = metrics.measure(
                picture.cpu(), pictures.truth, pictures.signed_radius, border=shot.border
            )
            yield Row(shot.scene, shot.name, method, errors, seconds, seconds / unit, peak)
    except torch.OutOfMemoryError:
        problem = "does not fit into the memory of the GPU"
        raise InputError(shot.folder, problem, "use --device cpu") from None


def _work(
    method: str, shot: Shot, sharp: Tensor, radius: Tensor, threads: int
) -> Callable[[], Tensor]:
    from defocus_core import Aperture, baselines, render

    aperture = Aperture(shot.lens.blades, shot.lens.blade_rotation)
    if method == "input":
        return lambda: sharp
    if method == "sum":
        return lambda: baselines.plain_sum(sharp, radius, aperture=aperture, threads=threads)
    if method == "over":
        return lambda: baselines.over(sharp, radius, aperture=aperture, threads=threads)
    height, width = radius.shape
    infinity = radius_at_infinity(shot.lens, (width, height))
    return lambda: (
        render(
            sharp, radius, aperture=aperture, quality=method, threads=threads, infinity=infinity
        ).render
    )


def warm_up(device: str) -> None:
    """Render a tiny picture: what a process does once belongs to no shot.

    From here on torch uses one thread: threads work on tiles or channels.
    """
    import torch

    from defocus_core import render

    set_to_render()
    radius = torch.linspace(-3, 3, 32, device=device).repeat(32, 1)
    render(radius[None].abs(), radius)

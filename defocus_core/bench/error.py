"""Error and cost of one shot of known truth, by each quality and baseline method.

Methods are the qualities of the renderer and the baselines it has to beat.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from defocus_core.bench.timing import FftUnit, MeasuredCost, measured
from defocus_core.bench.truth_set import Pictures, TruthShot
from defocus_core.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    from defocus_core.evaluation.metrics import Errors

BASELINES = {"input": "the sharp input", "sum": "plain sum of slices", "over": "over / alpha"}


@dataclass(frozen=True)
class Row:
    """One shot by one method."""

    scene: str  # name of the scene
    shot: str  # name of the shot
    method: str  # a quality or a baseline method
    errors: Errors  # errors against the truth
    cost: MeasuredCost  # cost of the rendering alone


def measure_shot(
    shot: TruthShot,
    pictures: Pictures,
    methods: Sequence[str],
    *,
    device: str,
    threads: int,
) -> Iterator[Row]:
    """One row for each method, when it is done."""
    import torch

    from defocus_core.evaluation import metrics

    sharp, radius = pictures.sharp.to(device), pictures.signed_radius.to(device)
    there = replace(pictures, sharp=sharp, signed_radius=radius)
    try:
        unit = FftUnit(sharp)
        for method in methods:
            picture, cost = measured(_work(method, shot, there, threads), unit, repeats=1)
            picture = picture.cpu()
            errors = metrics.measure(
                picture, pictures.truth, pictures.signed_radius, border=shot.border
            )
            yield Row(shot.scene, shot.name, method, errors, cost)
    except torch.OutOfMemoryError:
        problem = "does not fit into the memory of the GPU"
        raise InputError("out-of-memory", problem, "use ‹device› cpu", path=shot.folder) from None


def _work(method: str, shot: TruthShot, pictures: Pictures, threads: int) -> Callable[[], Tensor]:
    """The rendering of a shot by a method."""
    from defocus_core.evaluation import baselines
    from defocus_core.optics.aperture import Aperture
    from defocus_core.renderer.render import render

    aperture = Aperture(shot.lens.blades, shot.lens.blade_rotation)
    sharp, radius = pictures.sharp, pictures.signed_radius
    if method == "input":
        return lambda: sharp
    if method in BASELINES:
        layered = {"sum": baselines.plain_sum, "over": baselines.over}[method]
        return lambda: layered(sharp, radius, aperture=aperture, threads=threads)
    return lambda: (
        render(
            sharp,
            radius,
            aperture=aperture,
            quality=method,
            threads=threads,
            infinity=pictures.infinity,
        ).render
    )

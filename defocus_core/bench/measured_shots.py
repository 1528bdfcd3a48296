"""Table of the error and cost of each quality and of a plain baseline, on shots of scenes.

The unit of cost is the time of one Fourier transform of the frame and its inverse, RGBA float32, on
one thread. It is measured before and after each rendering: a busy machine slows both, so that the
ratio is the cost of the renderer itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from functools import partial
from statistics import fmean, median
from typing import TYPE_CHECKING, Any

from defocus_core.bench.truth_set import Pictures, TruthShot
from defocus_core.errors import InputError
from defocus_core.picture import plain_path
from defocus_core.system import memory
from defocus_core.system.process import set_to_render

if TYPE_CHECKING:
    from torch import Tensor

BASELINE = "sum"  # the method `plain_sum`, without occlusion
COMPILED, TORCH = "standard", "torch"  # the quality of compiled loops, and the same by torch
CAP = 50.0  # dB: greatest PSNR of a shot in a mean, so that easy scenes do not hide hard ones
_TRANSFORMS = 5  # timed transforms, whose median is the unit
# Title, width and decimals of each column; None decimals for words.
COLUMNS: dict[str, tuple[str, int, int | None]] = {
    "scene": ("scene", 10, None),
    "shot": ("shot", 8, None),
    "method": ("method", 9, None),
    "psnr": ("PSNR", 7, 2),
    "psnr_edges": ("edges", 7, 2),
    "psnr_elsewhere": ("other", 7, 2),
    "rel_rmse": ("relRMSE", 9, 5),
    "ssim": ("SSIM", 9, 5),
    "p999": ("p999", 9, 4),
    "seconds": ("seconds", 9, 3),
    "fft_units": ("FFTs", 9, 1),
}


Row = dict[str, Any]  # one shot by one method: the values of `COLUMNS`


def warm_up(device: str) -> str:
    """Render a tiny picture, so that no shot is charged for start-up; returns the chosen device."""
    plain_path.load()
    import torch

    from defocus_core.renderer.render import render

    set_to_render()
    device = plain_path.choose_device(device)
    radius = torch.linspace(-3, 3, 32, device=device).repeat(32, 1)
    render(radius[None].abs(), radius)
    return device


def methods(qualities: Sequence[str], device: str) -> list[str]:
    """The names of the methods to measure: the baseline, then each quality.

    The quality that compiled loops render, if they are available, is followed by the same quality
    rendered by torch.
    """
    from defocus_core.renderer.compiled.carried import available

    found = [BASELINE]
    for quality in qualities:
        found.append(quality)
        if quality == COMPILED and device == "cpu" and available():
            found.append(TORCH)
    return found


def measure_shot(
    shot: TruthShot, pictures: Pictures, methods: Sequence[str], *, device: str, threads: int
) -> Iterator[Row]:
    """Yield one row for each method as soon as it is measured."""
    import torch

    from defocus_core.evaluation import metrics

    sharp, radius = pictures.sharp.to(device), pictures.signed_radius.to(device)
    there = pictures._replace(sharp=sharp, signed_radius=radius)
    try:
        _unit_seconds(sharp)  # plans the transform
        after = _unit_seconds(sharp)
        for method in methods:
            picture, seconds = _timed(partial(_render, method, shot, there, threads))
            before, after = after, _unit_seconds(sharp)
            errors = metrics.measure(
                picture.cpu(), pictures.truth, pictures.signed_radius, border=shot.border
            )
            row = {"scene": shot.folder.name, "shot": shot.name, "method": method}
            cost = {"seconds": seconds, "fft_units": 2 * seconds / (before + after)}
            yield row | cost | asdict(errors)
    except torch.OutOfMemoryError:
        problem = "does not fit into the memory of the GPU"
        raise InputError("out-of-memory", problem, "use ‹device› cpu", path=shot.folder) from None


def _render(method: str, shot: TruthShot, pictures: Pictures, threads: int) -> Tensor:
    """The picture of a shot, rendered by a method."""
    from defocus_core.evaluation.baselines import plain_sum
    from defocus_core.optics.aperture import Aperture
    from defocus_core.renderer.engine.renderer import Renderer
    from defocus_core.renderer.engine.scene import Surface
    from defocus_core.renderer.engine.settings import Settings

    aperture = Aperture(shot.lens.blades, shot.lens.blade_rotation)
    sharp, radius, infinity = pictures.sharp, pictures.signed_radius, pictures.infinity
    if method == BASELINE:
        return plain_sum(sharp, radius, aperture=aperture)
    quality, back = (COMPILED, "torch") if method == TORCH else (method, "auto")
    settings = Settings(
        aperture=aperture, quality=quality, back=back, infinity=infinity, threads=threads
    )
    return Renderer(Surface(sharp, radius), settings).picture().images[0]


def _unit_seconds(image: Tensor) -> float:
    """The unit of cost in seconds: the median of several transforms of the image there and back."""
    import torch

    frame = torch.rand((4, *image.shape[-2:]), generator=torch.Generator().manual_seed(0))
    frame = frame.to(image.device)

    def round_trip() -> Tensor:
        memory.trim()  # memory that is in use already halves the time
        back: Tensor = torch.fft.irfft2(torch.fft.rfft2(frame), s=frame.shape[-2:])
        return back

    return median(_timed(round_trip)[1] for _ in range(_TRANSFORMS))


def _timed(work: Callable[[], Tensor]) -> tuple[Tensor, float]:
    """The result of some work, and its time in seconds."""
    import torch

    start = time.perf_counter()
    result = work()
    if result.is_cuda:
        torch.cuda.synchronize()
    return result, time.perf_counter() - start


def means(rows: Sequence[Row]) -> list[Row]:
    """One row for each method: the means over all shots, with each PSNR limited to 50 dB."""
    averages = []
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        mean: Row = {"method": method, "shots": len(own)}
        for name in (name for name, (*_, decimals) in COLUMNS.items() if decimals is not None):
            values = [r[name] for r in own if r[name] is not None]
            if name.startswith("psnr"):
                values = [min(value, CAP) for value in values]
            mean[name] = fmean(values) if values else None
        averages.append(mean)
    return averages


def heading() -> str:
    """The line of titles of the table."""
    return line({name: title for name, (title, *_) in COLUMNS.items()})


def line(values: Row) -> str:
    """A line of the table: words are aligned left, numbers right."""
    cells = []
    for name, (_, width, decimals) in COLUMNS.items():
        value = "-" if values[name] is None else values[name]
        is_number = decimals is not None and not isinstance(value, str)
        text = f"{value:.{decimals}f}" if is_number else f"{value}"
        cells.append(f"{text:<{width}}" if decimals is None else f"{text:>{width}}")
    return "".join(cells)

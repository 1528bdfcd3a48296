"""Seconds, Fourier transforms and memory that a rendering costs, and the scenes to time.

The unit of cost is one Fourier transform of the frame and its inverse, RGBA float32. It is measured
before and after each rendering: a busy machine slows both, so that their ratio is the cost of the
renderer itself.

The unit is measured on one thread, however many render: the time of two threads depends too much on
where their memory lies. Each measurement takes fresh memory from the system, as a new process does,
because memory in use before would halve the time of a transform.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import TYPE_CHECKING

from defocus_core.errors import InputError
from defocus_core.picture import plain_path
from defocus_core.system import memory
from defocus_core.system.process import set_to_render

if TYPE_CHECKING:
    from torch import Tensor

SIZES = ((480, 270), (960, 540))
RADII = (8.0, 32.0)
# A case is rendered this often, or until so many seconds are spent on it.
_REPEATS, _ENOUGH = 5, 1.0
# The unit is measured this often, or until so many seconds are spent on it.
_UNIT_REPEATS, _UNIT_ENOUGH = 7, 0.1

Size = tuple[int, int]


@dataclass(frozen=True)
class MeasuredCost:
    """Cost of a rendering."""

    seconds: float  # median of the repetitions
    fft_units: float  # median of the ratios to the unit measured beside each repetition
    # Peak memory of the process meanwhile, MB; None if the system does not report it
    peak_mb: float | None
    # Operations that the device is asked for; None if they were not counted
    launches: int | None = None
    waits: int | None = None  # how often the host waits for a value; the same
    written_mb: float | None = None  # what the operations write, MB; the same


@dataclass(frozen=True)
class Case:
    """A synthetic scene to time, at one size, radius and quality."""

    kind: str
    size: Size  # (width, height) in px
    radius: float  # greatest |r| in px; 0 where all is in focus
    quality: str  # quality of the renderer

    @property
    def name(self) -> str:
        """In one word, like ``floor-480x270-r8-standard``."""
        width, height = self.size
        return f"{self.kind}-{width}x{height}-r{self.radius:g}-{self.quality}"


def cases(sizes: Sequence[Size], radii: Sequence[float], qualities: Sequence[str]) -> list[Case]:
    """All combinations for each kind of scene, small ones first; no blur has one radius."""
    from defocus_core.evaluation.synthetic_scenes import KINDS as SCENE_KINDS

    return [
        Case(kind, size, radius, quality)
        for size in sorted(sizes, key=lambda size: size[0] * size[1])
        for kind in SCENE_KINDS
        for radius in ([0.0] if kind == "focus" else sorted(radii))
        for quality in qualities
    ]


def time_case(case: Case, *, device: str, threads: int) -> MeasuredCost:
    """The cost of a case, which is rendered several times, fewer if it takes long.

    Before, it is rendered by one thread to count what the device is asked for.
    """
    import torch

    from defocus_core.evaluation.cost import Launches
    from defocus_core.evaluation.synthetic_scenes import scenery
    from defocus_core.renderer.render import render

    width, height = case.size
    scene = scenery(case.kind, height, width, case.radius)
    image, radius = scene.image.to(device), scene.signed_radius.to(device)

    def work(threads: int = threads) -> Tensor:
        return render(image, radius, quality=case.quality, threads=threads).render

    try:
        with Launches(device) as counts:
            work(1)
        cost = measured(work, FftUnit(image), repeats=_REPEATS)[1]
        written = counts.written / 1e6
        return replace(
            cost, launches=counts.launches, waits=counts.waits, written_mb=round(written, 1)
        )
    except torch.OutOfMemoryError:
        problem = "does not fit into the memory of the GPU"
        raise InputError(
            "out-of-memory", problem, "leave that size out or use ‹device› cpu", path=case.name
        ) from None


def measured(
    work: Callable[[], Tensor], unit: FftUnit, *, repeats: int
) -> tuple[Tensor, MeasuredCost]:
    """The picture that some work makes, and its cost over so many repeats or one second."""
    device = unit.device
    seconds: list[float] = []
    ratios, peaks = [], []
    after = unit.seconds()
    while not seconds or (len(seconds) < repeats and sum(seconds) < _ENOUGH):
        memory.reset_peak(device)
        picture, taken = _timed(work)
        if (held := memory.peak_mb(device)) is not None:
            peaks.append(held)
        before, after = after, unit.seconds()
        seconds.append(taken)
        ratios.append(2 * taken / (before + after))
    return picture, MeasuredCost(median(seconds), median(ratios), max(peaks, default=None))


def warm_up(device: str) -> str:
    """Render a tiny picture, as what a process does once belongs to no shot; the device it is on.

    From here on torch uses one thread: threads work on tiles or channels.
    """
    plain_path.load()
    import torch

    from defocus_core.renderer.render import render

    set_to_render()
    device = plain_path.choose_device(device)
    radius = torch.linspace(-3, 3, 32, device=device).repeat(32, 1)
    render(radius[None].abs(), radius)
    return device


class FftUnit:
    """The unit for an image."""

    def __init__(self, image: Tensor) -> None:
        """Make a frame of noise; its transform is planned once, before anything is measured.

        `image`: [..., H, W], of its size, where it is.
        """
        import torch

        height, width = image.shape[-2:]
        frame = torch.rand((4, height, width), generator=torch.Generator().manual_seed(0))
        self._frame = frame.to(image.device)
        self.device = image.device.type
        self.seconds()

    def seconds(self) -> float:
        """The median of several transforms there and back, of fewer where one is long."""
        taken: list[float] = []
        while not taken or (len(taken) < _UNIT_REPEATS and sum(taken) < _UNIT_ENOUGH):
            memory.trim()
            taken.append(_timed(self._round_trip)[1])
        return median(taken)

    def _round_trip(self) -> Tensor:
        import torch

        back: Tensor = torch.fft.irfft2(torch.fft.rfft2(self._frame), s=self._frame.shape[-2:])
        return back


def _timed(work: Callable[[], Tensor]) -> tuple[Tensor, float]:
    """The result of some work, and the seconds that it takes."""
    import torch

    start = time.perf_counter()
    result = work()
    if result.is_cuda:
        torch.cuda.synchronize()
    return result, time.perf_counter() - start

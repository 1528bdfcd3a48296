"""Times renderings of made scenes, in seconds and in transforms of the same frame.

The unit, one transform there and back, is measured before and after each rendering: what slows the
machine meanwhile slows both, and their ratio says what the renderer itself costs.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING

from defocus_cli import memory
from defocus_cli.delivery import DISPARITY_PER_RADIUS
from defocus_cli.errors import InputError
from defocus_cli.fft_unit import FftUnit, timed
from defocus_cli.scene_rendering import rendered_scene

if TYPE_CHECKING:
    from torch import Tensor

    from defocus_cli.calibration import Calibration
    from defocus_core.scenery import Scenery

KINDS = {
    "focus": "all in focus",
    "plane": "one plane",
    "floor": "a floor through the focus",
    "cards": "overlapping cards",
    "thin": "wires close to the lens",
    "lights": "lights behind wires",
    "most": "80 % in focus",
}  # of defocus_core.scenery, which takes seconds to import
OUTPUTS = {
    "centre": ("render",),
    "pair": ("left", "right"),
    "all": ("render", "left", "right", "coc", "disparity", "trust"),
}
# A case is repeated until this many seconds are spent on it.
_ENOUGH = 1.0

Size = tuple[int, int]


@dataclass(frozen=True)
class Case:
    """What is timed.

    Attributes:
        kind: of scene.
        size: (width, height) in px.
        radius: greatest |r| in px; 0 where all is in focus.
        quality: of the renderer.
        outputs: a name of `OUTPUTS`.
    """

    kind: str
    size: Size
    radius: float
    quality: str
    outputs: str

    @property
    def name(self) -> str:
        """In one word, like ``floor-480x270-r8-standard-centre``."""
        width, height = self.size
        return f"{self.kind}-{width}x{height}-r{self.radius:g}-{self.quality}-{self.outputs}"


@dataclass(frozen=True)
class Timing:
    """What a case took.

    Attributes:
        case: that was timed.
        seconds: median of the repetitions.
        cpu_seconds: of all threads, median.
        fft_units: median of the ratios to the unit measured beside each.
        peak_mb: most memory that was held meanwhile, MB; None where no system tells.
        repeats: how often it was rendered.
        stats: what was computed and what was skipped.
        predicted_seconds: what a dry run would have said; None if it was not asked.
        predicted_mb: the same of the peak.
    """

    case: Case
    seconds: float
    cpu_seconds: float
    fft_units: float
    peak_mb: float | None
    repeats: int
    stats: Mapping[str, float]
    predicted_seconds: float | None = None
    predicted_mb: float | None = None


def cases(
    kinds: Sequence[str],
    sizes: Sequence[Size],
    radii: Sequence[float],
    qualities: Sequence[str],
    outputs: Sequence[str],
) -> list[Case]:
    """All combinations, the cheap ones first; what has no blur has one radius."""
    return [
        Case(kind, size, radius, quality, asked)
        for size in sorted(sizes, key=lambda size: size[0] * size[1])
        for kind in kinds
        for radius in ([0.0] if kind == "focus" else sorted(radii))
        for quality in qualities
        for asked in outputs
    ]


def measure(
    case: Case, *, device: str, threads: int, repeat: int, calibration: Calibration | None = None
) -> Timing:
    """Render a case `repeat` times, or until a second is spent on it.

    With a calibration, the result is predicted besides.

    Raises:
        InputError: the picture does not fit into the memory of the GPU.
    """
    import torch

    from defocus_core.scenery import scenery

    width, height = case.size
    scene = scenery(case.kind, height, width, case.radius)
    scene = type(scene)(*(part.to(device) for part in scene))
    work, done = _work(case, scene, threads)
    fft = FftUnit(scene.image)
    seconds: list[float] = []
    cpu, ratios, peaks = [], [], []
    foreseen = _predicted(case, scene, calibration)
    try:
        unit = fft.seconds()
        while not seconds or (len(seconds) < repeat and sum(seconds) < _ENOUGH):
            memory.reset_peak(device)
            start = time.process_time()
            seconds.append(timed(work, 1)[1])
            used = time.process_time() - start
            cpu.append(used)
            if (held := memory.peak_mb(device)) is not None:
                peaks.append(held)
            before, unit = unit, fft.seconds()
            ratios.append(2 * seconds[-1] / (before + unit))
    except torch.OutOfMemoryError:
        problem = "does not fit into the memory of the GPU"
        raise InputError(case.name, problem, "leave that size out or use --device cpu") from None
    peak = max(peaks, default=None)
    found = (case, median(seconds), median(cpu), median(ratios), peak, len(seconds), done[-1])
    return Timing(*found, *foreseen)


def _predicted(
    case: Case, scene: Scenery, calibration: Calibration | None
) -> tuple[float | None, float | None]:
    """Seconds and peak in MB, if there is a calibration."""
    if calibration is None:
        return None, None
    from defocus_core.planning import plan

    planned = plan(
        scene.signed_radius,
        image=scene.image,
        quality=case.quality,
        left_right="left" in OUTPUTS[case.outputs],
    )
    device = scene.image.device.type
    memory.reset_peak(device)  # hands back what planning took
    pictures = 3 if "left" in OUTPUTS[case.outputs] else 1
    of_pixel = (pictures * len(scene.image) + 1) * scene.image.itemsize  # and trust
    held = memory.held_mb(device) + of_pixel * scene.signed_radius.numel() / memory.MB
    held += calibration.predicted_mb(planned)
    return calibration.predicted_seconds(planned), held


def _work(
    case: Case, scene: Scenery, threads: int
) -> tuple[Callable[[], Tensor], list[Mapping[str, float]]]:
    """What makes all outputs of a case, and of each time the statistics."""
    kinds = OUTPUTS[case.outputs]
    done: list[Mapping[str, float]] = []

    def work() -> Tensor:
        if "disparity" in kinds:
            _ = scene.signed_radius * DISPARITY_PER_RADIUS
        rendered = rendered_scene(
            scene,
            quality=case.quality,
            left_right="left" in kinds,
            threads=threads,
        )
        done.append(rendered.stats)
        return rendered.pictures

    return work, done

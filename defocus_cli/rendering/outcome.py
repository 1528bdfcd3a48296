"""Records between the steps of a job: decoded inputs, computed images and maps, the outcome."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from defocus_cli.jobs.job import Job, Lens
from defocus_cli.rendering.memory_budget import Holding

if TYPE_CHECKING:
    from defocus_cli.depth_formats.depth import Depth
    from defocus_cli.formats.color import Color
    from defocus_core import DepthRepair


@dataclass(frozen=True)
class Outcome:
    """Lens, size, CoC, notes, time and warnings of a job."""

    job: Job
    lens: Lens  # with its focus distance
    size: tuple[int, int]  # width, height
    coc_px: tuple[float, float]  # smallest and largest signed radius
    color_note: str
    depth_note: str
    device: str
    quality: str
    render_seconds: float = 0.0
    render_cpu_seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    stats: Mapping[str, float] = field(default_factory=dict)
    repair_note: str = ""  # how it was repaired before it was rendered
    repair: DepthRepair | None = None  # that of its shot; None if the frame decides
    shot_note: str = ""  # what other frames decided

    def depth_words(self, *, rendered: bool = True) -> str:
        """How the depth was read and, for a rendered kind, repaired; maps show it unrepaired."""
        notes = (self.repair_note, self.shot_note) if rendered else ()
        return "; ".join(filter(None, (self.depth_note, *notes)))


@dataclass(frozen=True)
class Loaded:
    """A picture, decoded, and its hidden layer if the job has and needs one."""

    holding: Holding
    color: Color
    depth: Depth
    behind: tuple[Color, Depth] | None = None


@dataclass(frozen=True)
class Rendering:
    """The images and maps of a job, computed but not written.

    Attributes:
        outcome: lens, notes, time and warnings of the job.
        color: the colour input, whose metadata and further channels are written too.
        radius: signed CoC radius in px, [H, W].
        images: each rendered kind's arrays [H, W]: C of an image, in linear light; one of a map.
        clamped: number of pixels of each kind that were clamped to the range of half.
    """

    outcome: Outcome
    color: Color
    radius: Any
    images: Mapping[str, tuple[Any, ...]]
    clamped: Mapping[str, int]


def repair_words(repair: DepthRepair) -> str:
    """How the depth was repaired before it was rendered; empty if it was not."""
    done = []
    if repair.noise is not None:
        done.append(f"noisy by {repair.noise:.2g} px of radius, smoothed within surfaces")
    if repair.antialiased is not None:
        of = "disparity" if math.isinf(repair.antialiased) else "distance"
        done.append(f"anti-aliased as averages of {of}, its edges made hard")
    if repair.soft_edges:
        done.append("its soft edges made steps")
    if repair.edge_shifts is not None:
        shift = repair.edge_shifts.median
        done.append(f"its edges moved to those of the colours, {shift:+.1f} px in the median")
    if repair.quantised:
        done.append("of few levels, smoothed between them")
    return "; ".join(done)

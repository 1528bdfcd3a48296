"""What the steps of a job pass on: decoded inputs, computed pictures, the outcome."""

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
    """What became of a job."""

    job: Job
    lens: Lens  # with the focus distance that was found
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
    repair_note: str = ""  # what was done to it before it was rendered

    def depth_told(self, *, rendered: bool = True) -> str:
        """How the depth of an output was understood; maps of radii show it as it was given."""
        repair_note = self.repair_note if rendered else ""
        return "; ".join(filter(None, (self.depth_note, repair_note)))


@dataclass(frozen=True)
class Loaded:
    """A picture, decoded; and what lies behind it, where a job needs and has it."""

    holding: Holding
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
        images: each rendered kind's arrays [H, W]: C of an image, in linear light; one of a map.
        clamped: how many pixels of a kind were clamped to be half.
    """

    outcome: Outcome
    color: Color
    radius: Any
    images: Mapping[str, tuple[Any, ...]]
    clamped: Mapping[str, int]


def repair_words(repair: DepthRepair) -> str:
    """What was done to the depth before it was rendered; empty if nothing."""
    done = []
    if repair.noise is not None:
        done.append(f"noisy by {repair.noise:.2g} px of radius, smoothed within surfaces")
    if repair.antialiased is not None:
        of = "disparity" if math.isinf(repair.antialiased) else "distance"
        done.append(f"anti-aliased as averages of {of}, its edges made hard")
    if repair.soft_edges:
        done.append("its soft edges moved to where the colours have edges")
    if repair.quantised:
        done.append("of few levels, smoothed between them")
    return "; ".join(done)

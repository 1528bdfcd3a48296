"""Records between the steps of a job: decoded inputs, computed images and maps, the outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from defocus_core.batch.depth.repair_words import repair_words
from defocus_core.batch.elements.plate import Plate, nothing_of
from defocus_core.batch.jobs.job import Job
from defocus_core.batch.lenses.lens import Lens
from defocus_core.batch.rendering.memory_budget import Holding

if TYPE_CHECKING:
    from defocus_core.batch.elements.layers import Layers
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.io.depth_formats.depth import Depth
    from defocus_core.io.images.color_planes import Color


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
    repair: DepthRepair | None = None  # of the depth; None if nothing was rendered
    decided: DepthRepair | None = None  # by its shot; None if the frame decides
    shot_note: str = ""  # what other frames did for its depth

    def depth_words(self, *, rendered: bool = True) -> str:
        """How the depth was read and, for a rendered kind, repaired; maps show it unrepaired."""
        notes = (repair_words(self.repair), self.shot_note) if rendered else ()
        return "; ".join(filter(None, (self.depth_note, *notes)))


@dataclass(frozen=True)
class Loaded:
    """A picture, decoded, and its hidden layer or its plate if the job has and needs one."""

    holding: Holding
    color: Color
    depth: Depth
    behind: tuple[Color, Depth] | None = None
    plate: Plate | None = None
    layers: Layers | None = None  # of a deep picture that is rendered

    @property
    def is_layered(self) -> bool:
        """Whether it is rendered as layers, whose depth is not repaired."""
        return self.plate is not None or self.layers is not None

    @property
    def nothing(self) -> Any:
        """Where an element holds nothing, bool [H, W]; None if nowhere."""
        return self.depth.nothing if self.plate is None else nothing_of(self.depth, self.plate)

    def rendering(
        self,
        outcome: Outcome,
        radius: Any,
        images: Mapping[str, tuple[Any, ...]] = MappingProxyType({}),
        clamped: Mapping[str, int] = MappingProxyType({}),
    ) -> Rendering:
        """What is to be written of it; the arguments are the attributes of `Rendering`."""
        metres = None if self.depth.is_radius else self.depth.metres
        return Rendering(outcome, self.color, radius, images, clamped, self.nothing, metres)


@dataclass(frozen=True)
class Rendering:
    """The images and maps of a job, computed but not written.

    Attributes:
        outcome: lens, notes, time and warnings of the job.
        color: the colour input, whose metadata and further channels are written too.
        radius: signed CoC radius in px, [H, W].
        images: each rendered kind's arrays [H, W]: C of each view
            of an image, in linear light; one of a map.
        clamped: number of pixels of each kind that were clamped to the range of half.
        nothing: where an element holds nothing, bool [H, W]; None if nowhere.
        metres: planar depth in metres [H, W]; None if the file holds radii.
    """

    outcome: Outcome
    color: Color
    radius: Any
    images: Mapping[str, tuple[Any, ...]]
    clamped: Mapping[str, int]
    nothing: Any = None
    metres: Any = None

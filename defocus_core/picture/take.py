"""A picture on its way from its inputs to its files: planes, and what is known of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from defocus_core.batch.jobs.job import Job
from defocus_core.batch.lenses.lens import Lens
from defocus_core.picture.inputs import Inputs, SceneRadii
from defocus_core.picture.repair_words import repair_words
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair


@dataclass(frozen=True, kw_only=True)
class Rendered:
    """The images and maps of a job, before they are written.

    Attributes:
        job: what was asked for.
        inputs: its decoded inputs.
        lens: with its focus distance.
        radii: of all that the lens sees.
        device: where it is rendered.
        quality: of the rendering.
        images: each rendered kind's arrays [H, W]: C of each view of an image, in linear light;
            one of a map.
        clamped: number of pixels of each kind that were clamped to the range of half.
        reach: px that light of the picture reaches at most.
        lights: number of clipped lights that were made brighter; None if this is not asked for.
        seconds: that rendering took.
        cpu_seconds: that it took of processors.
        warnings: for people.
        stats: of the renderer.
        repair: of the depth; None if nothing was rendered.
        decided: the repair, by its shot; None if the frame decides.
        shot_note: what other frames did for its depth.
    """

    job: Job
    inputs: Inputs
    lens: Lens
    radii: SceneRadii
    device: str
    quality: str
    images: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    clamped: Mapping[str, int] = field(default_factory=dict)
    reach: int = 0
    lights: int | None = None
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    stats: Mapping[str, float] = field(default_factory=dict)
    repair: DepthRepair | None = None
    decided: DepthRepair | None = None
    shot_note: str = ""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the picture shown, in px."""
        return self.inputs.depth.size

    @property
    def metres(self) -> Any:
        """Planar depth in metres [H, W]; None if the file holds radii."""
        return None if self.inputs.depth.is_radius else self.inputs.depth.metres

    @property
    def color_note(self) -> str:
        """How the colour was read, and what became of clipped lights, for people."""
        lit = "" if self.lights is None else f"{counted(self.lights, 'clipped light')} brightened"
        return ", ".join(filter(None, (self.inputs.color.note, lit)))

    def depth_words(self, *, rendered: bool = True) -> str:
        """How the depth was read and, for a rendered kind, repaired; maps show it unrepaired."""
        notes = (repair_words(self.repair), self.shot_note) if rendered else ()
        return "; ".join(filter(None, (self.inputs.depth.note, *notes)))

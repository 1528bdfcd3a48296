"""A take: a job on its way from its files to its outputs, and what is known of it so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.images.color import Color
from defocus_core.picture.memory_budget import Holding, holds_cells, room_on
from defocus_core.picture.radii import Radii
from defocus_core.picture.repair_words import repair_words
from defocus_core.request.job import Job, Picture, Reading
from defocus_core.request.lens import Lens
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.picture.layers import Layers
    from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer

_UNKNOWN = Radii(None, (0.0, 0.0), None, 1.0)


@dataclass(frozen=True)
class Plate:
    """A decoded plate."""

    picture: Picture
    reading: Reading  # how it was read
    color: Color
    depth: Depth  # infinitely far if its file has none
    warnings: tuple[str, ...] = ()  # what was taken for granted of it, and of the element over it


@dataclass(frozen=True)
class Inputs:
    """The decoded inputs of a job; jobs of one picture share them."""

    holding: Holding  # memory of the picture
    color: Color
    depth: Depth
    hidden: tuple[Color, Depth] | None = None  # of the hidden layer, if it is needed
    plate: Plate | None = None  # the plate that it lies over, if it is an element
    layers: Layers | None = None  # of a deep picture, or of an element and its plate
    matte: Any = None  # [H, W], the coverage of its subject; None if it is not known
    empty: Any = None  # where there is nothing, bool [H, W]; None if nowhere
    warnings: tuple[str, ...] = ()  # what the files hold and the renderer ignores
    stamps: Mapping[str, Any] = field(default_factory=dict)  # of the files, by role
    seconds: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Take:
    """A job on its way."""

    job: Job  # what was asked for
    inputs: Inputs
    lens: Lens  # with its focus distance, once that is known
    radii: Radii = _UNKNOWN  # of the picture, or of the element over a plate
    # [H, W] px, the radii of what is in front: of the plate where the element is empty
    shown: Any = None
    limits: tuple[float, float] = (0.0, 0.0)  # the least and the greatest of those shown
    blur: Radii = _UNKNOWN  # the radii that it is rendered by
    # What other frames have seen of what is hidden; None if that is not asked
    seen: HiddenLayer | None = None
    device: str = "cpu"  # where it is rendered
    # Each rendered kind's arrays [H, W]: C of each view of an image, in linear light; one of a
    # map
    images: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    # Number of pixels of each kind that were clamped to the range of half
    clamped: Mapping[str, int] = field(default_factory=dict)
    reach: int = 0  # px that light of the picture reaches at most
    # Number of clipped lights that were made brighter; None if this is not asked for
    lamps: int | None = None
    seconds: float = 0.0
    cpu_seconds: float = 0.0  # that it took of processors
    warnings: tuple[str, ...] = ()
    stats: Mapping[str, float] = field(default_factory=dict)
    repair: DepthRepair | None = None  # of the depth; None if nothing was rendered
    decided: DepthRepair | None = None  # the repair, by its shot; None if the frame decides
    shot_note: str = ""  # what other frames did for its depth

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the picture shown, in px."""
        return self.inputs.depth.size

    @cached_property
    def has_room(self) -> bool:
        """Whether there is room for what is derived from the whole picture."""
        color, room = self.inputs.color, room_on(self.device, self.inputs.holding.room_mb)
        return holds_cells((len(color.planes), *color.shape[:2]), room)

    @property
    def metres(self) -> Any:
        """Planar depth in metres [H, W]; None if the file holds radii."""
        return None if self.inputs.depth.is_radius else self.inputs.depth.metres

    def reading(self, **changes: Any) -> Take:
        """The take with other inputs in some fields."""
        return replace(self, inputs=replace(self.inputs, **changes))

    @property
    def color_note(self) -> str:
        """How the colour was read, and what became of clipped lights, for people."""
        lit = "" if self.lamps is None else f"{counted(self.lamps, 'clipped light')} brightened"
        return ", ".join(filter(None, (self.inputs.color.note, lit)))

    def depth_words(self, *, rendered: bool = True) -> str:
        """How the depth was read and, for a rendered kind, repaired; maps show it unrepaired."""
        notes = (repair_words(self.repair), self.shot_note) if rendered else ()
        return "; ".join(filter(None, (self.inputs.depth.note, *notes)))

"""The table of optional steps of the path of a picture, in their order.

The module of a step is imported only if it applies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any, Generic, TypeVar

from defocus_core.io.images.describe import describe
from defocus_core.picture.take import Contents, InputPair, Pass, Surfaces, Take

T = TypeVar("T")


@dataclass(frozen=True)
class Step(Generic[T]):
    """A row of the table."""

    name: str  # name of its function, in a module beside or above this one
    when: str  # purpose, for readers of the table
    applies: Callable[[T], object]  # tells from the subject of the stage whether the step applies

    @property
    def function(self) -> Callable[[T], T]:
        """The function of the step, imported on access."""
        function: Callable[[T], T] = resolve_name(f"defocus_core.picture.{self.name}")
        return function


def apply_steps(steps: tuple[Step[T], ...], subject: T) -> T:
    """The subject of a stage, changed by the steps that apply."""
    for step in steps:
        if step.applies(subject):
            subject = step.function(subject)
    return subject


def _is_deep(take: Take) -> bool:
    """Whether rendered samples lie behind each other, in its files or a holdout."""
    picture = take.job.picture
    colors = [each.color for each in (picture, picture.over) if each is not None]
    is_deep = picture.holdout is not None or any(describe(path).deep for path in colors)
    return take.job.outputs.need_rendering and is_deep


def _lens_is_found(take: Take) -> bool:
    lens = take.lens
    decided = (lens.focus_at, lens.focus_percentile, lens.blur)
    return any(value is not None for value in decided)


def _frames_focus(take: Take) -> bool:
    """Whether frames share the focus; deep frames decide alone."""
    layers = take.inputs.layers
    is_deep = layers is not None and not layers.pictures
    return take.job.shot is not None and _lens_is_found(take) and not is_deep


def _frames_repair(take: Take) -> bool:
    shot, is_off = take.job.shot, take.job.reading.depth_repair == "off"
    if shot is None or not shot.sample or is_off:
        return False
    return take.job.outputs.need_rendering and take.inputs.layers is None


def _is_noisy(contents: Contents) -> bool:
    kind = contents.kind
    return kind.image and bool(kind.rendered) and contents.take.lens.noise is not None


def _may_end(contents: Contents) -> bool:
    """Whether an image may have fewer pixels than the picture, as nothing lies beyond the blur."""
    take, kind, lens = contents.take, contents.kind, contents.take.lens
    lit = take.inputs.plate or take.inputs.hidden or lens.noise
    is_cut = take.job.outputs.format == "exr" and take.inputs.color.is_cut
    return kind.image and bool(kind.rendered) and is_cut and not lit


# Files: an element and its plate, before and after decoding; then companions.
WINDOW: tuple[Step[InputPair], ...] = (
    Step(
        "steps.companions:window_of_plate",
        "an element has the overscan of its plate",
        lambda p: p.picture.over,
    ),
    Step("pair:read_overscan", "pixels beyond the picture are read", lambda p: p.has_overscan),
)
PAIR: tuple[Step[InputPair], ...] = (
    Step("pair:resized", "depth has the size of the colour", lambda p: p.differs),
    Step("element:empty_where_clear", "it is empty somewhere", lambda p: p.color.alpha is not None),
)
READ: tuple[Step[Take], ...] = (
    Step("steps.companions:read_plate", "a plate lies below", lambda t: t.job.picture.over),
    Step(
        "steps.companions:read_matte",
        "its subject is cut out",
        lambda t: t.job.picture.matte is not None,
    ),
    Step("steps.deep:read", "samples lie behind each other", _is_deep),
    Step(
        "steps.companions:read_hidden",
        "a file has what is hidden",
        lambda t: t.job.outputs.need_rendering and t.job.picture.hidden,
    ),
)
# The lens and its radii.
LENS: tuple[Step[Take], ...] = (
    Step("steps.shot:lens", "frames find the focus", _frames_focus),
    Step("focus:find_focus", "the picture decides the focus", _lens_is_found),
)
RADII: tuple[Step[Take], ...] = (
    Step(
        "steps.companions:radii_of_both",
        "the plate shows where nothing is",
        lambda t: t.inputs.plate,
    ),
    Step("radii:doubt_depth", "depth is doubted", lambda t: not t.inputs.depth.is_exact),
    Step("steps.shot:radii", "frames repair depth together", _frames_repair),
)
# The scene, and its passes.
SCENE: tuple[Step[Surfaces], ...] = (
    Step("scene:stack_layers", "layers are stacked", lambda s: s.take.inputs.layers),
    Step(
        "steps.companions:show_matte",
        "its subject has a coverage; layers have their own",
        lambda s: s.take.inputs.matte is not None and s.take.inputs.layers is None,
    ),
    Step(
        "scene:repair_surfaces",
        "depth is repaired, unless deep",
        lambda s: s.colors and s.take.job.reading.depth_repair != "off",
    ),
    Step("scene:light_lamps", "lamps get back their light", lambda s: s.take.lens.highlights),
    Step("steps.companions:show_hidden", "what is hidden is known", lambda s: s.take.inputs.hidden),
)
PASSES: tuple[Step[tuple[Pass, ...]], ...] = (
    Step("scene:pass_colors", "colours focus apart", lambda p: p[0].take.lens.axial_color),
    Step("scene:pass_coverage", "alpha is the coverage", lambda p: p[0].take.inputs.layers),
)
# The planes of a file to write.
WRITE: tuple[Step[Contents], ...] = (
    Step("write:add_noise", "the sensor is noisy", _is_noisy),
    Step(
        "write:cut_overscan",
        "pixels beyond the picture are cut, or kept",
        lambda c: any(c.take.inputs.color.overscan),
    ),
    Step("write:cut_border", "a border without light is cut", _may_end),
)
STAGES: tuple[tuple[Step[Any], ...], ...] = (
    *(WINDOW, PAIR, READ, LENS),
    *(RADII, SCENE, PASSES, WRITE),
)

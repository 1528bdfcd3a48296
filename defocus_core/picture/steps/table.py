"""The tables of optional steps on the path of a picture, in order, one for each stage.

The module of a step is imported only if the step applies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Generic, TypeVar

from defocus_core.io.depth_formats.reading import own_format
from defocus_core.io.images.describe import describe
from defocus_core.picture.take import Contents, InputPair, Pass, Surfaces, Take

T = TypeVar("T")


@dataclass(frozen=True)
class Step(Generic[T]):
    """An optional step: a function that changes the data of a stage, if a condition holds."""

    name: str  # name of its function, in a module beside or above this one
    applies: Callable[[T], object]  # whether the step applies to the data of its stage

    @property
    def function(self) -> Callable[[T], T]:
        """The function of the step, which is imported on access."""
        function: Callable[[T], T] = resolve_name(f"defocus_core.picture.{self.name}")
        return function


def apply_steps(steps: tuple[Step[T], ...], subject: T) -> T:
    """Apply those steps whose condition holds to the data of a stage, one after the other."""
    for step in steps:
        if step.applies(subject):
            subject = step.function(subject)
    return subject


def _has_overscan(pair: InputPair) -> bool:
    """Whether the colour file has pixels beyond its display window."""
    return not all(p.display.covers(p.data) for p in describe(pair.picture.color).parts)


def _may_doubt(take: Take) -> bool:
    """Whether depth may have been misread; blur radii in px from a file cannot be."""
    return take.inputs.depth.is_relative or not take.inputs.depth.is_radius


def _is_deep(take: Take) -> bool:
    """Whether layers are to be rendered, because a file is deep or there is a holdout."""
    picture = take.job.picture
    colors = [each.color for each in (picture, picture.over) if each is not None]
    is_deep = picture.holdout is not None or any(describe(path).deep for path in colors)
    return take.job.outputs.need_rendering and is_deep


def _lens_is_found(take: Take) -> bool:
    lens = take.lens
    decided = (lens.focus_at, lens.focus_percentile, lens.blur)
    return any(value is not None for value in decided)


def _frames_focus(take: Take) -> bool:
    """Whether frames of a shot share the focus; those of deep files do not."""
    layers = take.inputs.layers
    is_deep = layers is not None and not layers.pictures
    return take.job.shot is not None and _lens_is_found(take) and not is_deep


def _has_matte(take: Take) -> bool:
    picture = take.job.picture
    return picture.matte is not None or own_format(picture.color) == "apple-heic"


def _frames_repair(take: Take) -> bool:
    shot, is_off = take.job.shot, take.job.reading.depth_repair == "off"
    if shot is None or not shot.sample or is_off:
        return False
    return take.job.outputs.need_rendering and take.inputs.layers is None


def _is_noisy(contents: Contents) -> bool:
    kind = contents.kind
    return kind.image and bool(kind.rendered) and contents.take.lens.noise is not None


def _may_end(contents: Contents) -> bool:
    """Whether an image may be cropped to its data window, extended by the reach of the blur."""
    take, kind, lens = contents.take, contents.kind, contents.take.lens
    lit = take.inputs.plate or take.inputs.hidden or lens.noise
    is_cut = take.job.outputs.format == "exr" and take.inputs.color.is_cut
    return kind.image and bool(kind.rendered) and is_cut and not lit


# Files before decoding: an element has the overscan of its plate.
WINDOW: tuple[Step[InputPair], ...] = (
    Step("steps.companions:window_of_plate", lambda p: p.picture.over),
    Step("pair:read_overscan", _has_overscan),
)
# Decoded files: depth gets the size of the colour, and is empty where an element is.
PAIR: tuple[Step[InputPair], ...] = (
    Step("pair:resized", lambda p: p.differs),
    Step("element:empty_where_clear", lambda p: p.color.alpha is not None),
)
# Further inputs of a picture.
READ: tuple[Step[Take], ...] = (
    Step("steps.companions:read_plate", lambda t: t.job.picture.over),
    Step("steps.companions:read_matte", _has_matte),
    Step("steps.deep:read", _is_deep),
    Step(
        "steps.companions:read_hidden",
        lambda t: t.job.outputs.need_rendering and t.job.picture.hidden,
    ),
)
# The focus, found from all frames of a shot or from the picture.
LENS: tuple[Step[Take], ...] = (
    Step("steps.shot:lens", _frames_focus),
    Step("focus:find_focus", _lens_is_found),
)
# Radii: maps show those of a plate where its element is empty; frames share the repair of depth.
RADII: tuple[Step[Take], ...] = (
    Step("steps.companions:radii_of_both", lambda t: t.inputs.plate),
    Step("radii:doubt_depth", _may_doubt),
    Step("steps.shot:radii", _frames_repair),
)
# The scene; layers have their own coverage, and deep pixels need no repair.
SCENE: tuple[Step[Surfaces], ...] = (
    Step("scene:stack_layers", lambda s: s.take.inputs.layers),
    Step(
        "steps.companions:show_matte",
        lambda s: s.take.inputs.matte is not None and s.take.inputs.layers is None,
    ),
    Step("scene:repair_surfaces", lambda s: s.colors and s.take.job.reading.depth_repair != "off"),
    Step("scene:light_lamps", lambda s: s.take.lens.highlights),
    Step("steps.companions:show_hidden", lambda s: s.take.inputs.hidden),
)
# Renderings of the scene: colours may focus at other distances; alpha of layers is their coverage.
PASSES: tuple[Step[tuple[Pass, ...]], ...] = (
    Step("scene:pass_colors", lambda p: p[0].take.lens.axial_color),
    Step("scene:pass_coverage", lambda p: p[0].take.inputs.layers),
)
# The planes of a file to write, without pixels beyond the picture and borders without light.
WRITE: tuple[Step[Contents], ...] = (
    Step("write:add_noise", _is_noisy),
    Step("write:cut_overscan", lambda c: any(c.take.inputs.color.overscan)),
    Step("write:cut_border", _may_end),
)

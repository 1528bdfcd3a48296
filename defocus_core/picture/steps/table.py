"""All that may happen to a picture beside the plain path, in the order in which it happens.

A step is asked only whether it applies; its module is imported if it does. Its function has the
name of the stage that it belongs to, takes what the stage hands on, and gives it back changed.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple, TypeVar

from defocus_core.io.images.describe import describe

Subject = TypeVar("Subject")


class Step(NamedTuple):
    """A row of the table."""

    stage: str  # of the plain path, and the name of the function
    module: str  # beside this one
    when: str  # what it is for, for people who read the table
    applies: Callable[[Any], object]  # to what the stage hands on: true or false


def _is_deep(take: Any) -> bool:
    """Whether samples that are rendered lie behind each other, in its files or a holdout."""
    picture = take.job.picture
    colors = [each.color for each in (picture, picture.over) if each is not None]
    is_deep = picture.holdout is not None or any(describe(path).deep for path in colors)
    return take.job.outputs.need_rendering and is_deep


def _has_hidden(take: Any) -> bool:
    """Whether a file of what is hidden is needed."""
    return take.job.outputs.need_rendering and take.job.picture.hidden is not None


def _lens_is_found(take: Any) -> bool:
    """Whether the lens depends on the picture."""
    decided = ("focus_at", "focus_percentile", "blur", "max_coc", "draw")
    return any(getattr(take.lens, name) is not None for name in decided)


def _frames_focus(take: Any) -> bool:
    """Whether frames decide together where the focus lies; each deep one decides alone."""
    layers = take.inputs.layers
    is_deep = layers is not None and not layers.pictures
    return take.job.shot is not None and _lens_is_found(take) and not is_deep


def _frames_repair(take: Any) -> bool:
    """Whether frames decide together how depth is repaired."""
    shot, is_off = take.job.shot, take.job.reading.depth_repair == "off"
    if shot is None or not shot.sample or is_off:
        return False
    return take.job.outputs.need_rendering and take.inputs.layers is None


def _has_neighbours(take: Any) -> bool:
    """Whether there are frames beside it."""
    return take.job.shot is not None and len(take.job.shot.window) > 1


def _has_matte(surfaces: Any) -> bool:
    """Whether the coverage of the subject counts: layers have their own."""
    inputs = surfaces.take.inputs
    return inputs.matte is not None and inputs.layers is None


def _is_noisy(contents: Any) -> bool:
    """Whether an image has the noise of a sensor."""
    kind = contents.kind
    return kind.image and kind.rendered and contents.take.lens.noise is not None


def _has_overscan(contents: Any) -> bool:
    """Whether arrays go beyond the picture."""
    return any(contents.take.inputs.color.overscan)


def _may_end(contents: Any) -> bool:
    """Whether an image may have fewer pixels than the picture: nothing is beyond the blur."""
    take, kind, lens = contents.take, contents.kind, contents.take.lens
    lit = take.inputs.plate or take.inputs.hidden or lens.noise
    is_cut = take.job.outputs.format == "exr" and take.inputs.color.is_cut
    return kind.image and kind.rendered and is_cut and not lit


# What a stage hands on: `window` and `pair` an InputPair, before and after it is decoded; `read`,
# `lens`, `radii` and `blur` a Take; `scene` Surfaces; `passes` each Pass; `write` Contents.
STEPS = (
    # Files: colour and depth, then what belongs to them.
    Step("window", "plate", "an element has the overscan of its plate", lambda p: p.picture.over),
    Step("window", "overscan", "pixels beyond the picture are read", lambda p: p.has_overscan),
    Step("pair", "resizing", "depth has the size of the colour", lambda p: p.differs),
    Step("pair", "alpha", "an element is empty somewhere", lambda p: p.color.alpha is not None),
    Step("read", "plate", "a plate lies below", lambda t: t.job.picture.over),
    Step("read", "matte", "its subject is cut out", lambda t: t.job.picture.matte is not None),
    Step("read", "deep", "samples lie behind each other", _is_deep),
    Step("read", "hidden", "a file has what is hidden", _has_hidden),
    # The lens and its radii.
    Step("lens", "shot_decisions", "frames find the focus", _frames_focus),
    Step("lens", "focusing", "the picture decides the focus", _lens_is_found),
    Step("radii", "plate", "the plate shows where nothing is", lambda t: t.inputs.plate),
    Step("radii", "implausible", "depth is doubted", lambda t: not t.inputs.depth.is_exact),
    Step("radii", "shot_decisions", "frames repair depth together", _frames_repair),
    Step("blur", "neighbours", "frames show each other more", _has_neighbours),
    # The scene, and how often it is rendered.
    Step("scene", "layers", "layers are stacked", lambda s: s.take.inputs.layers),
    Step("scene", "matte", "its subject has a coverage", _has_matte),
    Step("scene", "repair", "depth is repaired", lambda s: s.is_repaired),
    Step("scene", "lamps", "lamps get back their light", lambda s: s.take.lens.highlights),
    Step("scene", "hidden", "what is hidden is known", lambda s: s.knows_hidden),
    Step(
        "passes", "colors_apart", "colours are in focus apart", lambda p: p[0].take.lens.axial_color
    ),
    Step("passes", "layers", "alpha is the coverage", lambda p: p[0].take.inputs.layers),
    # The planes of a file, as they are written.
    Step("write", "noise", "the sensor is noisy", _is_noisy),
    Step("write", "overscan", "pixels beyond the picture are cut, or kept", _has_overscan),
    Step("write", "empty_border", "a border without light is cut", _may_end),
)


def through(stage: str, subject: Subject) -> Subject:
    """What a stage hands on, changed by the steps that apply to it."""
    for step in STEPS:
        if step.stage == stage and step.applies(subject):
            module = import_module(f"defocus_core.picture.steps.{step.module}")
            subject = getattr(module, stage)(subject)
    return subject

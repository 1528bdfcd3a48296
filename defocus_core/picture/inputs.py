"""The inputs of a job, decoded: its picture, what lies behind or below it, its layers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from defocus_core.batch.jobs.job import Job
from defocus_core.batch.lenses.lens import Lens
from defocus_core.errors import InputError, TooLarge, UsageProblem
from defocus_core.io.arrays import computed
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.images.color_planes import Color
from defocus_core.io.images.primaries import refuse_other_primaries
from defocus_core.picture.layers import Layers
from defocus_core.picture.memory_budget import (
    Holding,
    base_mb,
    capacity_mb,
    holding,
    refuse_small,
)
from defocus_core.picture.pair import parts_of, read
from defocus_core.picture.radii import Radii, radii_of
from defocus_core.picture.steps.deep import layers_of_scene
from defocus_core.picture.steps.plate import Plate, nothing_of, read_over


class SceneRadii(NamedTuple):
    """The radii of all that a lens sees."""

    picture: Radii  # of the picture, or of the element over a plate
    plate: Radii | None
    hidden: Radii | None  # of the hidden layer
    layers: tuple[Radii, ...]  # of each layer of a deep picture
    shown: Any  # [H, W] px of what is in front: of the plate where the element has nothing
    limits: tuple[float, float]  # the least and the greatest of those shown


@dataclass(frozen=True)
class Inputs:
    """The decoded inputs of a job; jobs of one picture share them."""

    holding: Holding  # memory of the picture
    color: Color
    depth: Depth
    # Colour and depth of the hidden layer, if there is one and it is needed
    hidden: tuple[Color, Depth] | None = None
    plate: Plate | None = None  # the plate that it lies over, if it is an element
    layers: Layers | None = None  # of a deep picture that is rendered
    stamps: Mapping[str, Any] = field(default_factory=dict)  # of the files, by role
    seconds: float = 0.0

    @property
    def is_layered(self) -> bool:
        """Whether it is rendered as layers, whose depth is not repaired."""
        return self.plate is not None or self.layers is not None

    @property
    def depths(self) -> tuple[Depth, ...]:
        """The depths of all that is shown."""
        of_layers = () if self.layers is None else tuple(self.layers.depths)
        return self.depth, *(() if self.plate is None else (self.plate.depth,)), *of_layers

    @property
    def nothing(self) -> Any:
        """Where an element holds nothing, bool [H, W]; None if nowhere."""
        return self.depth.nothing if self.plate is None else nothing_of(self.depth, self.plate)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the files hold and the renderer ignores."""
        behind = () if self.hidden is None else self.hidden[0].warnings
        hidden_warnings = (f"hidden: {warning}" for warning in behind)
        plate = () if self.plate is None else self.plate.warnings
        return *self.color.warnings, *self.depth.warnings, *hidden_warnings, *plate

    def radii(self, lens: Lens) -> SceneRadii:
        """The radii of all of it through a lens with its focus distance."""
        keeping, nothing = self.holding.keeping, self.depth.nothing
        own_radii = radii_of(lens, self.depth, keeping)
        plate = None if self.plate is None else radii_of(lens, self.plate.depth, keeping)
        hidden = None if self.hidden is None else radii_of(lens, self.hidden[1], keeping)
        depths = () if self.layers is None else self.layers.depths
        layers = tuple(radii_of(lens, depth, keeping) for depth in depths)
        if plate is None:
            return SceneRadii(own_radii, None, hidden, layers, own_radii.px, own_radii.limits)
        limits = (
            min(own_radii.limits[0], plate.limits[0]),
            max(own_radii.limits[1], plate.limits[1]),
        )
        shown = own_radii.px
        if nothing is not None:
            shown = computed(lambda a, n, b: np.where(n, b, a), own_radii.px, nothing, plate.px)
        return SceneRadii(own_radii, plate, hidden, layers, shown, limits)


def load_inputs(job: Job) -> Inputs:
    """Decode the picture of a job, and what lies behind it if that is wanted and there."""
    if job.reading.blur_channels and job.outputs.format != "exr":
        problem = f"has no effect in {job.outputs.format}, which holds the picture alone"
        raise UsageProblem("idle-option", problem, "use ‹format› exr", field="blur-channels")
    refuse_small(job, base_mb())
    picture, held, left = job.picture, holding(job), capacity_mb(job.machine)
    if (at_once := held.files_mb + held.whole_mb * held.scratch) > left and held.whole_mb:
        problem = f"takes {at_once:.0f} MB to decode, {left:.0f} MB are left"
        raise TooLarge(
            "out-of-memory", problem, "save it as EXR, or allow more ‹memory›", path=picture.color
        )
    if picture.over is not None:
        return _over_plate(job, held)
    whole = job.outputs.keep_overscan
    color, depth = read(picture, job.reading, held.keeping, job.lens_focal, whole=whole)
    if not job.outputs.need_rendering:
        return Inputs(held, color, depth)
    if (inputs := _with_layers(job, Inputs(held, color, depth))).layers is not None:
        return inputs
    if picture.hidden is None:
        return Inputs(held, color, depth)
    behind, behind_depth = read(
        picture.hidden, job.reading, held.keeping, job.lens_focal, whole=whole
    )
    if behind.shape != color.shape:
        size, wanted = (
            f"{width}x{height} px of {channels} channels"
            for height, width, channels in (behind.shape, color.shape)
        )
        problem = f"is {size} but the picture is {wanted}"
        raise InputError(
            "wrong-size", problem, "give ‹hidden› of the same kind", path=picture.hidden.color
        )
    refuse_other_primaries(behind.path, behind.attributes, color.attributes, "the picture")
    return Inputs(held, color, depth, (behind, behind_depth))


def _over_plate(job: Job, held: Holding) -> Inputs:
    """An element and the plate that it lies over, decoded."""
    if job.picture.hidden is not None:
        raise UsageProblem(
            "contradiction", "stands beside ‹over›", "the plate is what lies behind", field="hidden"
        )
    color, depth, plate = read_over(
        job.picture,
        job.reading,
        held.keeping,
        job.lens_focal,
        whole=job.outputs.keep_overscan,
    )
    inputs = Inputs(held, color, depth, plate=plate)
    return _with_layers(job, inputs) if job.outputs.need_rendering else inputs


def _with_layers(job: Job, inputs: Inputs) -> Inputs:
    """A picture with its samples if it is deep or has a holdout."""
    picture = job.picture
    layers = layers_of_scene(
        picture,
        job.reading,
        parts_of(picture, job.reading)[0],
        (inputs.color, inputs.depth),
        inputs.plate,
        inputs.holding.keeping,
        job.lens_focal,
    )
    if layers is None:
        return inputs
    note = f"{inputs.color.note}, {layers.words}"
    return replace(inputs, color=replace(inputs.color, note=note), layers=layers)

"""Shot options: the frames of a shot, their lenses, and what the frames have in common.

``@shot_options`` hands a command ``shot: ShotOptions``, ``@shot_lens_options`` ``lenses``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from defocus_cli.options.lens import lens_decorators
from defocus_cli.options.reading import asked_reading
from defocus_cli.options.rows import given_options, param_option
from defocus_cli.options.types import (
    Command,
    Decorator,
    bundle,
    lens_option,
    option,
)
from defocus_core.errors import CALLER, UsageProblem
from defocus_core.io.depth_formats.table import UNITS
from defocus_core.io.shots.frame_patterns import FrameChoice
from defocus_core.request.animation import Animation, read_animation
from defocus_core.request.inputs import choice_of
from defocus_core.request.job_options import ANIMATION_OPTIONS, INPUT_OPTIONS, SHOT_OPTIONS
from defocus_core.request.parameters import LENS_OPTIONS
from defocus_core.request.picture_lenses import PictureLenses
from defocus_core.request.resolver import Layer
from defocus_core.request.shots import SharedDecisions, decisions_of


@dataclass(frozen=True)
class ShotOptions:
    """The options of a shot beside its lens."""

    frames: Layer  # which are wanted
    together: SharedDecisions  # what the frames have in common
    contact: int | None = None  # number of pictures on a contact sheet; None for no sheet

    def choice(self, animation: Animation) -> FrameChoice:
        """The frames that are wanted."""
        return choice_of(self.frames, CALLER.at, animation.frames)


def shot_options(command: Command) -> Command:
    """Hand a command ``shot``."""
    rows = (INPUT_OPTIONS["frames"], INPUT_OPTIONS["missing"], *SHOT_OPTIONS.values())
    contact = option(
        "--contact N",
        "Also write N of the pictures, small, to OUT/contact.png.",
        click.IntRange(min=1, max=400),
        heading="Shot",
    )

    def make(contact: int | None, **values: Any) -> ShotOptions:
        frames, together = (given_options(values, rows) for rows in (INPUT_OPTIONS, SHOT_OPTIONS))
        return ShotOptions(frames, decisions_of(together), contact)

    return bundle("shot", make, [*map(param_option, rows), contact])(command)


def shot_lens_options(
    *, required: bool, names: Iterable[str] = LENS_OPTIONS, moving: bool = True
) -> Decorator:
    """Hand a command ``lenses``: PictureLenses, or None if none are asked for nor required.

    `names`: the options that show in what it makes; `moving`: whether it knows frames.
    """
    options = [
        *lens_decorators(names),
        *map(param_option, ANIMATION_OPTIONS.values() if moving else ()),
        lens_option(
            "--lens-from-metadata",
            "Take the lens from each colour file: OpenEXR's attributes, V-Ray's, or Exif; -v "
            "says which. What is given beside it wins.",
            into="metadata",
        ),
    ]

    def make(
        lens_file: Path | None,
        metadata: bool,
        animate: tuple[str, ...] = (),
        interpolate: str | None = None,
        **values: Any,
    ) -> PictureLenses | None:
        if interpolate is not None and not animate:
            problem, remedy = "has no keys to go between", "add --animate FILE"
            raise UsageProblem("idle-option", problem, remedy, field="interpolate")
        given_options({"interpolate": interpolate}, ANIMATION_OPTIONS)
        own = given_options(values, LENS_OPTIONS)
        if not (required or own or animate or metadata or lens_file is not None):
            return None
        reading = asked_reading()
        lenses = PictureLenses(
            own,
            file=lens_file,
            radii=reading.holds_radii,
            animation=read_animation(animate, interpolate),
            metadata=metadata,
            metres=UNITS[reading.depth_unit or "m"],
        )
        try:
            _ = lenses.fixed  # raises what is wrong before any picture is looked for
        except UsageProblem as error:
            if error.code != "missing-option":  # which may follow from the depth
                raise
        return lenses

    return bundle("lenses", make, options)

"""Shot options: the frames of a shot, their lenses, and what the frames have in common.

``@shot_options`` hands a command ``shot: ShotOptions``, ``@shot_lens_options`` ``lenses``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
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
from defocus_core.io.shots.frame_patterns import MISSING, FrameChoice, frame_choice
from defocus_core.request.animation import INTERPOLATIONS, Animation, read_animation
from defocus_core.request.job_options import SHOT_OPTIONS
from defocus_core.request.parameters import LENS_OPTIONS
from defocus_core.request.picture_lenses import PictureLenses
from defocus_core.request.shots import SharedDecisions, decisions_of

_shot_option = partial(option, heading="Shot")

_PLACES = (CALLER.at("frames"), CALLER.at("missing"))


@dataclass(frozen=True)
class ShotOptions:
    """The options of a shot beside its lens."""

    frames: str | None  # the frames wanted, as text; None for all
    missing: str | None
    together: SharedDecisions  # what the frames have in common
    contact: int | None = None  # number of pictures on a contact sheet; None for no sheet

    def choice(self, animation: Animation) -> FrameChoice:
        """The frames that are wanted."""
        return frame_choice(self.frames, self.missing, _PLACES, animation.frames)


def shot_options(command: Command) -> Command:
    """Hand a command ``shot``."""
    options = [
        _shot_option(
            "--frames LIST",
            "Frames of patterns like 'shot.####.exr': 1001-1240, 1001-1240x2, 1001,1005; or "
            "keys, those with a key of --animate.  [default: all that are there]",
        ),
        _shot_option(
            "--missing",
            "Frames that have no file: an error, or left out.  [default: error]",
            MISSING,
        ),
        *(param_option("Shot", row) for row in SHOT_OPTIONS.values()),
        _shot_option(
            "--contact N",
            "Also write N of the pictures, small, to OUT/contact.png.",
            click.IntRange(min=1, max=400),
        ),
    ]

    def make(
        frames: str | None, missing: str | None, contact: int | None, **together: Any
    ) -> ShotOptions:
        shared = decisions_of(given_options(together, SHOT_OPTIONS))
        return ShotOptions(frames, missing, shared, contact)

    return bundle("shot", make, options)(command)


def shot_lens_options(
    *, required: bool, names: Iterable[str] = LENS_OPTIONS, moving: bool = True
) -> Decorator:
    """Hand a command ``lenses``: PictureLenses, or None if none are asked for nor required.

    `names`: the options that show in what it makes; `moving`: whether it knows frames.
    """
    keys = [
        lens_option(
            "--animate FILE",
            "Options of the lens by frame: CSV with columns like frame,focus,fnumber, TOML, or "
            "Nuke's .chan.  ('defocus help shots')",
            multiple=True,
        ),
        lens_option(
            "--interpolate",
            "Between keys: evenly, or slow at each key.  [default: linear]",
            INTERPOLATIONS,
        ),
    ]
    options = [
        *lens_decorators(names),
        *(keys if moving else ()),
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

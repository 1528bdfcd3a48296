"""Options of jobs, made from the tables of `defocus_core.request`, which parses their values."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from defocus_cli.options.shared import (
    Command,
    Decorator,
    FilePath,
    bundle,
    contact_option,
    lens_option,
    option,
    output_option,
    position_of,
)
from defocus_core.errors import CALLER, UsageProblem, with_dashes
from defocus_core.io.shots.frame_patterns import FrameChoice
from defocus_core.request.job import Machine, Outputs, Reading
from defocus_core.request.job_options import (
    ANIMATION_OPTIONS,
    INPUT_OPTIONS,
    MACHINE_OPTIONS,
    OUTPUT_OPTIONS,
    READING_OPTIONS,
    SHOT_OPTIONS,
    ReadingParam,
)
from defocus_core.request.lens import LensValues
from defocus_core.request.pairing import Others, choice_of, others_of
from defocus_core.request.parameters import LENS_OPTIONS, OPENING, SHAPES, Param
from defocus_core.request.picture_lenses import PictureLenses
from defocus_core.request.resolver import (
    Given,
    Layer,
    check_lens,
    fields_of,
    laid_over,
    layer_of,
    lens_of,
    outputs_of,
    reading_of,
)
from defocus_core.system.process import cores


def param_option(param: Param, text: str = "") -> Decorator:
    """The click option of a row of a table; its value stays a text or a path.

    `text`: a help text that replaces that of the row.
    """
    settings: dict[str, Any] = {"heading": param.heading, "is_common": param.is_common}
    spelling = f"--{param.name} {param.metavar}"
    if param.toggle:
        spelling = f"--{param.name}/--no-{param.name}"
    elif not param.flag:
        spelling += f"[{'|'.join(param.choices)}]" if param.choices else ""
        settings["kind"] = FilePath() if param.is_path else click.STRING
        settings |= {"multiple": True} if param.multiple else {"nargs": param.words}
    if not param.multiple:
        settings["default"] = None
    return option(spelling, with_dashes(text or param.help), **settings)


def given_options(values: Mapping[str, Any], rows: Mapping[str, Param]) -> Layer:
    """The options of `rows` that were given on the command line.

    `values`: the values of all parameters of the command, by name.
    """
    given = {name: values.get(name.replace("-", "_")) for name in rows}
    return layer_of(given, rows, CALLER.with_field)


class LensFile(FilePath):
    """The type of ``--lens``: the path of a lens file, or the @NAME of a shipped one."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path of the file."""
        from defocus_core.request.lens_files import lens_path

        return lens_path(super().convert(value, param, ctx), position_of(param))


def _lens_options(names: Iterable[str]) -> list[Decorator]:
    text = (
        'TOML file of lens options, with lines like focal-length = "50mm"; or the @NAME of a lens '
        "that comes with defocus, as 'defocus lenses' lists them. Options on the command line win "
        "over the file."
    )
    file = lens_option("--lens FILE.toml", text, LensFile(), into="lens_file", is_common=True)
    return [*(param_option(LENS_OPTIONS[name]) for name in names), file]


def opening_options() -> Decorator:
    """Add the options of aperture and photodiodes to a command, which gets them as ``lens``."""

    def make(lens_file: Path | None, **values: Any) -> LensValues:
        from defocus_core.request.lens_files import read_lens_file

        shape = read_lens_file(lens_file, SHAPES)
        options = laid_over(shape, given_options(values, LENS_OPTIONS))
        check_lens(options, CALLER, radii=True)
        return lens_of(options)

    return bundle("lens", make, _lens_options(OPENING))


def reading_options(
    are_of: Callable[[ReadingParam], bool] = lambda row: not row.of_render,
) -> Decorator:
    """Add options of reading to a command, which gets them as ``reading``.

    `are_of`: whether the command has the option of a row.
    """
    rows = filter(are_of, READING_OPTIONS.values())
    return bundle("reading", _asked_reading, list(map(param_option, rows)))


def _asked_reading(**_: Any) -> Reading:
    params, below = click.get_current_context().params, dict[str, Given]()
    if (file := params.get("lens_file")) is not None:
        from defocus_core.request.lens_files import read_lens_file

        below = read_lens_file(file, READING_OPTIONS)
    return reading_of(below, given_options(params, READING_OPTIONS))


@dataclass(frozen=True)
class ShotOptions:
    """The options of a shot, without those of its lens."""

    frames: FrameChoice  # the wanted frames
    together: Layer  # decisions that the frames share
    contact: int | None = None  # number of pictures on a contact sheet; None for no sheet


def shot_options(command: Command) -> Command:
    """Add the options of shots to a command, which gets them as ``shot``."""
    rows = (INPUT_OPTIONS["frames"], INPUT_OPTIONS["missing"], *SHOT_OPTIONS.values())

    def make(contact: int | None, **values: Any) -> ShotOptions:
        frames, together = (given_options(values, rows) for rows in (INPUT_OPTIONS, SHOT_OPTIONS))
        return ShotOptions(choice_of(frames, CALLER.with_field), together, contact)

    return bundle("shot", make, [*map(param_option, rows), contact_option])(command)


def shot_lens_options(
    *, required: bool, names: Iterable[str] = LENS_OPTIONS, moving: bool = True
) -> Decorator:
    """Add lens options to a command, which gets them as ``lenses``, or None if none are given.

    `required`: whether ``lenses`` is an object even then. `names`: the lens options of the command.
    `moving`: whether it has the option ``--animate``.
    """
    options = [
        *_lens_options(names),
        *map(param_option, ANIMATION_OPTIONS.values() if moving else ()),
        lens_option(
            "--lens-from-metadata",
            "Take the lens from the metadata of each colour file: attributes of OpenEXR or V-Ray, "
            "or Exif. Options on the command line win over it; -v prints what was found.",
            into="metadata",
        ),
    ]

    def make(
        lens_file: Path | None, metadata: bool, animate: tuple[str, ...] = (), **values: Any
    ) -> PictureLenses | None:
        own = given_options(values, LENS_OPTIONS)
        if not (required or own or animate or metadata or lens_file is not None):
            return None
        reading, animation = _asked_reading(), None
        if animate:
            from defocus_core.request.animation import read_animation

            animation = read_animation(animate)
        lenses = PictureLenses(
            own, file=lens_file, reading=reading, animation=animation, metadata=metadata
        )
        try:
            _ = lenses.fixed  # raises errors before pictures are searched
        except UsageProblem as error:
            if error.code != "missing-option":  # they may follow from the depth
                raise
        return lenses

    return bundle("lenses", make, options)


def others_options(command: Command) -> Command:
    """Add the options of further input files to a command, which gets them as ``others``."""
    rows = [INPUT_OPTIONS[name] for name in ("hidden", "over", "over-depth", "holdout", "matte")]
    return bundle("others", _others, list(map(param_option, rows)))(command)


def _others(**given: Any) -> Others:
    if given["hidden"] is not None:
        given["hidden"], given["hidden_depth"] = given["hidden"]
    paths = {name.replace("_", "-"): path for name, path in given.items() if path is not None}
    return others_of(paths, CALLER)


def output_options(command: Command) -> Command:
    """Add the options of outputs to a command, which gets them as ``outputs``."""
    rows = [row for row in OUTPUT_OPTIONS.values() if row.only != "files"]
    options = [
        output_option(
            "-o --out OUT",
            "Directory to write to. For one kind of output of one picture it may be a file, like "
            "picture.png; no journal is written then.",
            FilePath(),
            into="root",
            required=True,
        ),
        *map(param_option, rows),
        output_option(
            "--overwrite", "Render all pictures again, and replace existing files.", is_common=True
        ),
    ]

    def make(root: Path, overwrite: bool, **values: Any) -> Outputs:
        given = given_options(values, OUTPUT_OPTIONS)
        return outputs_of(given, Outputs(root, overwrite=overwrite), one_file=True)

    return bundle("outputs", make, options)(command)


def machine_options(*names: str) -> Decorator:
    """Add the named options of the machine to a command, which gets them as ``machine``."""

    def make(**values: Any) -> Machine:
        given = fields_of(given_options(values, MACHINE_OPTIONS))
        return Machine(**{"threads": cores(), **given})

    return bundle("machine", make, [param_option(MACHINE_OPTIONS[name]) for name in names])

"""``defocus choose``: a page for choosing focus and blur."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from defocus_cli.options.job import machine_options, reading_options, shot_lens_options
from defocus_cli.options.shared import (
    FilePath,
    GroupedCommand,
    ReportPath,
    output_option,
    verbose_option,
)
from defocus_cli.words import console
from defocus_cli.words.batch import tile_bar
from defocus_core.errors import UsageProblem
from defocus_core.io.depth_formats.reading import own_format
from defocus_core.picture.subject import with_blur_and_focus
from defocus_core.reports.html.focus_choice import write_choice
from defocus_core.request.job import Machine, Reading
from defocus_core.request.pairing import find_pictures
from defocus_core.request.parameters import LENS_OPTIONS
from defocus_core.request.picture_lenses import PictureLenses

# Options that the page chooses, with their values, and others of this command alone.
_CHOSEN = ("--blur", "--fnumber", "--focus", "--focus-at", "--focus-value", "-o", "--out")
_OWN = ("--quiet", "-q", "--verbose", "-v")
_SHOWN = [name for name in LENS_OPTIONS if not name.startswith("dp-")]  # there is no pair


@click.command("choose", cls=GroupedCommand)
@click.argument("color", type=FilePath())
@click.argument("depth", type=FilePath(), required=False)
@output_option(
    "-o --out FILE.html",
    "HTML page to write; an existing page is replaced.",
    ReportPath("html"),
    required=True,
)
@shot_lens_options(required=True, names=_SHOWN, moving=False)
@reading_options()
@machine_options("device", "threads")
@verbose_option
def command(
    color: Path,
    depth: Path | None,
    out: Path,
    lenses: PictureLenses,
    reading: Reading,
    machine: Machine,
    verbose: bool,
) -> None:
    """Write an HTML page on which you choose focus and blur by clicks.

    Open the page in a browser: click on the picture to set the focus, and move a slider to set the
    blur. Below the picture stands the command that renders your choice. The page holds 8 x 5 small
    pictures, of 8 focus distances and 5 strengths of blur, and shows the nearest one; it needs no
    other file and no network.

    Without lens options, depth must be relative (without a unit), as for 'render'. Then the whole
    surface in focus is sharp, and a button swaps near and far.

    \b
    Examples:
      defocus choose photo.jpg depth.png -o choose.html
      defocus choose rgb.exr depth.exr -o choose.html --lens @portrait-85 --focus 2m
    """  # noqa: D301  click reads the backspace
    pictures = find_pictures(color, depth)
    if len(pictures) > 1:
        problem = f"holds {len(pictures)} pictures, and the page shows one"
        raise UsageProblem("contradiction", problem, "name one file", path=color)
    typed = click.get_current_context().meta["typed"]
    one, known = with_blur_and_focus(lenses, pictures, reading, typed)
    lens, _ = one.lens_of(pictures[0])
    with tile_bar("picture") as progress:
        write_choice(
            *(pictures[0], lens, known, out, machine, progress),
            command=_rendering(typed),
            whole_surface="sharp-range" in one.own.keys() - lenses.own.keys(),
            either_end=reading.invert is None and not own_format(pictures[0].depth),
        )
    console.stdout(f"{out}: a page to choose on, for a browser")


def _rendering(typed: Sequence[str]) -> list[str]:
    """The words of a command that renders the picture, without the options that the page sets."""
    words, rest = ["defocus", "render"], iter(typed[2:])
    for word in rest:
        if word in _CHOSEN:
            next(rest)
        elif word not in _OWN and not word.startswith(tuple(f"{name}=" for name in _CHOSEN)):
            words.append(word)
    return words

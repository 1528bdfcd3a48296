"""``defocus aperture``: draw the aperture of a lens and the blur of a point."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.options.job import opening_options
from defocus_cli.options.shared import FilePath, GroupedCommand, output_option
from defocus_cli.words import console
from defocus_core.io.write_files import identities, require_replaceable
from defocus_core.picture.opening import write_aperture
from defocus_core.request.lens import LensValues
from defocus_core.request.quantities import pixel_count


@click.command("aperture", cls=GroupedCommand)
@output_option(
    "-o --out FILE", "File to write: .png to look at, .exr to measure.", FilePath(), required=True
)
@output_option(
    "--radius PX",
    "Radius of the blur of the point.",
    pixel_count,
    default="16px",
    show_default=True,
)
@output_option("--nearer", "Draw a point nearer than the focus, not beyond it.")
@output_option("--overwrite", "Replace an existing file.")
@opening_options()
def command(out: Path, radius: float, nearer: bool, overwrite: bool, lens: LensValues) -> None:
    """Draw the aperture of a lens, and the blur of a point beyond the focus.

    A PNG shows four pictures, from left to right: the aperture; the blur of a point, with enlarged
    pixels; its blur through the left half of the aperture; and through the right half. An EXR holds
    the weights of the blur, whose sum is 1, in channel 'kernel', and those of the halves in 'left'
    and 'right'.

    \b
    Examples:
      defocus aperture -o hexagon.png --blades 6 --blade-curvature 0.4
      defocus aperture -o mirror.exr --obstruction 0.4 --radius 40px
    """  # noqa: D301  click reads the backspace
    require_replaceable(out, overwrite=overwrite, inputs=identities(lens.files.values()))
    write_aperture(out, lens, -radius if nearer else radius)
    console.stdout(f"wrote {out}")

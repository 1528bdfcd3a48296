"""``defocus aperture``: the opening of a lens, and the blur of a point, to look at."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.options.job import opening_options
from defocus_cli.options.shared import FilePath, GroupedCommand, output_option
from defocus_cli.words import console
from defocus_core.io.replacing import identities, require_replaceable
from defocus_core.picture.opening import write_aperture
from defocus_core.request.lens import LensValues
from defocus_core.request.quantities import pixel_count


@click.command("aperture", cls=GroupedCommand)
@output_option(
    "-o --out FILE", "File to write: .png to look at, .exr to measure.", FilePath(), required=True
)
@output_option("--radius PX", "Radius of the blur.", pixel_count, default="16px", show_default=True)
@output_option("--nearer", "Of a point nearer than the focus.")
@output_option("--overwrite", "Replace a file that is there.")
@opening_options()
def command(out: Path, radius: float, nearer: bool, overwrite: bool, lens: LensValues) -> None:
    """Draw the opening of a lens, and the blur of a point beyond the focus.

    A PNG shows four squares: the opening, the blur of a point at --radius with every pixel of it
    enlarged, and what the left and the right half of the opening make of it. An EXR has the blur
    in channel 'kernel', whose sum is 1, and what the halves make of it in 'left' and 'right'.

    \b
    Examples:
      defocus aperture -o hexagon.png --blades 6 --blade-curvature 0.4
      defocus aperture -o mirror.exr --obstruction 0.4 --radius 40px
    """  # noqa: D301  click reads the backspace
    require_replaceable(out, overwrite=overwrite, inputs=identities(lens.files.values()))
    write_aperture(out, lens, -radius if nearer else radius)
    console.stdout(f"wrote {out}")

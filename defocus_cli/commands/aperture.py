"""``defocus aperture``: draw the opening of a lens and the blur of a point."""

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
@output_option("--radius PX", "Radius of the blur.", pixel_count, default="16px", show_default=True)
@output_option("--nearer", "Draw the blur of a point nearer than the focus.")
@output_option("--overwrite", "Replace an existing file.")
@opening_options()
def command(out: Path, radius: float, nearer: bool, overwrite: bool, lens: LensValues) -> None:
    """Draw the opening of a lens, and the blur of a point beyond the focus.

    A PNG shows four squares: the opening, the blur of a point at --radius with enlarged pixels, and
    its blur by the left and the right half of the opening. An EXR has the blur in channel 'kernel',
    with sum 1, and those of the halves in 'left' and 'right'.

    \b
    Examples:
      defocus aperture -o hexagon.png --blades 6 --blade-curvature 0.4
      defocus aperture -o mirror.exr --obstruction 0.4 --radius 40px
    """  # noqa: D301  click reads the backspace
    require_replaceable(out, overwrite=overwrite, inputs=identities(lens.files.values()))
    write_aperture(out, lens, -radius if nearer else radius)
    console.stdout(f"wrote {out}")

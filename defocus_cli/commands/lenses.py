"""``defocus lenses``: list the lens files that come with defocus, or draw their blur."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.options.shared import FilePath, GroupedCommand, json_option, output_option
from defocus_cli.words import console
from defocus_core.allowed_values import DUAL_PIXEL_SENSORS
from defocus_core.errors import InputError
from defocus_core.io.write_files import require_replaceable
from defocus_core.request.lens_files import shipped_lenses


@click.command("lenses", cls=GroupedCommand)
@output_option(
    "-o --out FILE.png",
    "Sheet to write, which shows the same lights, blurred by the same radii, with each lens.",
    FilePath(),
)
@output_option("--overwrite", "Replace an existing file.")
@json_option
def command(out: Path | None, overwrite: bool, as_json: bool) -> None:
    """List the lens files that come with defocus, by their names for --lens.

    They set no focus: add --focus or --focus-at. Other options win over those of the lens file.
    Below them, the measured sensors are listed, by their names for --dp-model.

    \b
    Examples:
      defocus lenses -o looks.png
      defocus render rgb.exr depth.exr -o out --lens @portrait-85 --focus 2m
    """  # noqa: D301  click reads the backspace
    lenses = shipped_lenses()
    if out is not None:
        if out.suffix.lower() != ".png":
            raise InputError("malformed", "is not a PNG", "end its name in .png", path=out)
        require_replaceable(out, overwrite=overwrite)
        from defocus_core.reports.sheets import write_lens_sheet

        write_lens_sheet(out, lenses)
    sensors = [
        {"name": name, "subject": subject, "model": model, "crosstalk": crosstalk}
        for name, (model, crosstalk, subject) in DUAL_PIXEL_SENSORS.items()
    ]
    if as_json:
        rows = [{"name": x.name, "subject": x.subject, "file": str(x.path)} for x in lenses]
        console.print_json(lenses=rows, sensors=sensors)
        return
    for lens in lenses:
        console.stdout(f"{lens.name:<16}{lens.subject}")
    console.stdout("")
    for sensor in sensors:
        measured = f"{sensor['model']}, crosstalk {sensor['crosstalk']:g}: {sensor['subject']}"
        console.stdout(f"--dp-model {sensor['name']:<13}{measured}")

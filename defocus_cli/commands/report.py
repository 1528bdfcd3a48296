"""``defocus report``: a batch as one HTML file to look at."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.options.shared import FilePath, GroupedCommand, html_option, json_option
from defocus_cli.words import console
from defocus_core.reports.html import batches
from defocus_core.system.process import cores
from defocus_core.system.text import counted

_NAME = "report.html"


@click.command("report", cls=GroupedCommand)
@click.argument("out", type=FilePath())
@html_option(f"The file to write.  [default: OUT/{_NAME}]")
@json_option
def command(out: Path, html: Path | None, as_json: bool) -> None:
    """Write one HTML file with the samples of the batch in OUT, for a browser.

    Each sample has its input, its pictures and its maps: a slider between two of them, exposure,
    CoC over the picture, left and right in turn, values under the pointer, and the command that
    renders it again. Samples that failed come first. The file holds all it needs. Pictures beyond
    8192 x 4096 px are left out, as are files that cannot be read.

    \b
    Examples:
      defocus report out
      defocus report out --html /var/www/out.html
    """  # noqa: D301  click reads the backspace
    path = html or out / _NAME
    count = batches.write(out, path, None, cores())
    if as_json:
        console.print_json(html=str(path), samples=count)
    else:
        console.stdout(f"{path}: {counted(count, 'sample')}")

"""``defocus bench``: error and time on scenes with known truth."""

from __future__ import annotations

from pathlib import Path

import click

from defocus_cli.options.shared import FilePath, GroupedCommand, json_option, option
from defocus_cli.words import console
from defocus_core.allowed_values import QUALITIES
from defocus_core.bench import measured_shots
from defocus_core.bench.truth_set import find_shots, read, sample_set
from defocus_core.request.job import DEVICES
from defocus_core.request.job_options import MAX_THREADS
from defocus_core.request.quantities import one_of, several
from defocus_core.system.process import cores

_QUALITIES = ("standard", "high")


@click.command("bench", cls=GroupedCommand)
@option(
    "--truth DIR",
    "Set of scenes, <scene>/camera.json.  [default: sample_scenes of the repository]",
    FilePath(),
)
@option(
    "--quality QUALITY,…",
    f"Qualities to measure, of {', '.join(QUALITIES)}.  [default: {','.join(_QUALITIES)}]",
    several(one_of(QUALITIES)),
    into="qualities",
    default=_QUALITIES,
)
@option(
    "--threads N",
    "Threads to compute with.  [default: one for each core]",
    click.IntRange(1, MAX_THREADS),
)
@option("--device", "", DEVICES, default="auto", show_default=True)
@json_option
def command(
    truth: Path | None, qualities: tuple[str, ...], threads: int | None, device: str, as_json: bool
) -> None:
    """Render scenes with known truth and print the error and the time of each shot.

    The table also has 'sum', the plain sum of blurred slices, and 'torch', which is 'standard' by
    the torch back, if compiled loops render 'standard'.

    PSNR (dB) and SSIM are of sRGB-encoded pictures, relRMSE and p999 (99.9th percentile of the
    error) of linear light. A border as wide as the largest blur is left out. 'edges' is PSNR
    within the largest blur radius of a depth edge, 'other' that of the rest. FFTs is the time in
    transforms of the frame there and back, measured alongside. With --json the table is on stderr.

    \b
    Examples:
      defocus bench
      defocus bench --truth ../truth --quality standard
      defocus bench --json > bench.json
    """  # noqa: D301  click reads the backspace
    echo = console.stderr if as_json else console.stdout
    truth, threads = truth or sample_set(), threads or cores()
    shots, device = find_shots(truth), measured_shots.warm_up(device)
    methods = measured_shots.methods(qualities, device)
    echo(measured_shots.heading())
    rows: list[measured_shots.Row] = []
    for shot in shots:
        for row in measured_shots.measure_shot(
            shot, read(shot), methods, device=device, threads=threads
        ):
            rows.append(row)
            echo(measured_shots.line(row))
    means = measured_shots.means(rows)
    echo(f"means, PSNR capped at {measured_shots.CAP:g} dB")
    for mean in means:
        echo(measured_shots.line({"scene": "mean", "shot": "", **mean}))
    if as_json:
        settings = {"truth": str(truth), "device": device, "threads": threads}
        console.print_json(**settings, rows=rows, means=means)

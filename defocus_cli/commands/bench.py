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
    "Directory of scenes with known truth, each with a <scene>/camera.json.  "
    "[default: sample_scenes of the repository]",
    FilePath(),
)
@option(
    "--quality QUALITY,…",
    f"Qualities to measure: one or several of {', '.join(QUALITIES)}, separated by commas.  "
    f"[default: {','.join(_QUALITIES)}]",
    several(one_of(QUALITIES)),
    into="qualities",
    default=_QUALITIES,
)
@option(
    "--threads N",
    "Number of CPU threads.  [default: one for each core]",
    click.IntRange(1, MAX_THREADS),
)
@option(
    "--device",
    "Where to compute: on the CPU, on a GPU (cuda), or auto: on a GPU if there is one.",
    DEVICES,
    default="auto",
    show_default=True,
)
@json_option
def command(
    truth: Path | None, qualities: tuple[str, ...], threads: int | None, device: str, as_json: bool
) -> None:
    """Render scenes with known truth, and print the error and the time of each picture.

    A row of the table is a scene, rendered through the lens of column 'shot' in a quality. Two
    more rows are for comparison: 'sum' adds up blurred depth slices without occlusion; 'torch' is
    quality 'standard' by torch, if the row above is by compiled loops ('defocus help quality').

    
    PSNR     in dB, of sRGB-encoded pictures; a border as wide as the largest blur is left out
    edges    PSNR of the pixels within the largest blur radius of a depth edge
    other    PSNR of all other pixels
    relRMSE  RMSE of linear light, divided by the mean light
    p999     99.9 % of the pixels have at most this error of linear light
    SSIM     structural similarity of sRGB-encoded pictures
    FFTs     the time, divided by that of a Fourier transform of the picture and back

    With --json the table is printed on stderr.

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

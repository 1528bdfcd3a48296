"""``defocus bench``: error and time on scenes with known truth."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from defocus_cli import bench_table, options
from defocus_cli.bench_files import Files
from defocus_cli.bench_run import BASELINES, Row, measure_shot, warm_up
from defocus_cli.bench_set import find_shots, read, sample_set
from defocus_cli.option_types import FilePath, Names


@click.command(
    "bench",
    cls=options.GroupedCommand,
    short_help="Render scenes with known truth; say error and time.",
)
@click.option(
    "--truth",
    type=FilePath(),
    metavar="DIR",
    help="Set of scenes, <scene>/camera.json.  [default: sample_scenes of the repository]",
)
@click.option(
    "--quality",
    "qualities",
    type=Names(options.QUALITIES),
    default="draft,standard,high",
    show_default=True,
    metavar="QUALITY,…",
    help=f"What to measure, of {', '.join(options.QUALITIES)}.",
)
@click.option("--only", type=Names(), default=(), metavar="SCENE,…", help="Only these scenes.")
@click.option(
    "--baselines/--no-baselines",
    default=True,
    show_default=True,
    help="Also measure the sharp input, the plain sum of slices, and over / alpha.",
)
@click.option("--json", "json_file", type=FilePath(), metavar="FILE", help="Write all as JSON.")
@click.option("--csv", "csv_file", type=FilePath(), metavar="FILE", help="Write the rows as CSV.")
@click.option(
    "--plot",
    "plot_file",
    type=FilePath(),
    metavar="FILE.png",
    help="Draw run time against PSNR; needs matplotlib: pip install 'defocus[bench]'.",
)
@click.option(
    "--threads",
    type=click.IntRange(min=1),
    default=options.cores,
    metavar="N",
    help="Threads to compute with.  [default: one for each core]",
)
@click.option("--device", type=click.Choice(options.DEVICES), default="auto", show_default=True)
@click.option(
    "--repeat",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    metavar="N",
    help="Render so often, and take the median of the times.",
)
def command(
    truth: Path | None,
    qualities: tuple[str, ...],
    only: tuple[str, ...],
    baselines: bool,
    json_file: Path | None,
    csv_file: Path | None,
    plot_file: Path | None,
    threads: int,
    device: str,
    repeat: int,
) -> None:
    """Render scenes with known truth and say how far off each shot is and how long it took.

    PSNR (dB) and SSIM are of sRGB-encoded pictures, relRMSE and p999 (99.9th percentile of the
    error) of linear light. A border as wide as the largest blur is left out. 'edges' is PSNR
    within the largest blur radius of a depth edge, 'other' that of the rest. FFTs is the time in
    transforms of the frame there and back, measured alongside. MB is the peak of the process.

    '!' marks shots on which standard is worse than a baseline by more than 0.1 dB, 0.001 SSIM or
    1 % relative RMSE; they are listed at the end.

    \b
    Examples:
      defocus bench
      defocus bench --truth ../truth --quality standard --only cards,fence
      defocus bench --repeat 3 --json bench.json --csv bench.csv --plot bench.png
    """  # noqa: D301  click reads the backspace
    root = truth or sample_set()
    shots = find_shots(root, only)
    files = Files(json_file, csv_file, plot_file)
    files.refuse_unwritable()
    from defocus_cli import engine

    engine.load()
    found = engine.choose_device(device)
    methods = (*qualities, *(BASELINES if baselines else ()))
    rows: list[Row] = []
    warm_up(found)
    click.echo(bench_table.heading())
    with _progress(len(shots) * len(methods)) as (step, tell):
        for shot in shots:
            done = []
            for row in measure_shot(
                shot, read(shot), methods, device=found, threads=threads, repeat=repeat
            ):
                done.append(row)
                step()
            for line in bench_table.shot_lines(done):
                tell(line)
            rows += done
    for line in bench_table.summary_lines(rows):
        click.echo(line)
    machine = {"device": found, "threads": threads, "repeat": repeat}
    files.write(rows, {"truth": str(root), **machine})


@contextmanager
def _progress(total: int) -> Iterator[tuple[Callable[[], object], Callable[[str], object]]]:
    """What to call after each rendering, and what says a line above the bar, if a terminal sees."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda: None, click.echo
        return
    from tqdm import tqdm

    with tqdm(total=total, unit="rendering", file=sys.stderr, leave=False) as bar:
        yield bar.update, lambda line: tqdm.write(line, file=sys.stdout)

"""``defocus bench``: error and time on scenes with known truth, or time on made scenes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import click

from defocus_cli import bench_table, bench_time_table, options
from defocus_cli.bench_baseline import faster, read_baseline
from defocus_cli.bench_files import STDOUT, Files
from defocus_cli.bench_options import QUALITIES, Times, refuse_others, time_options
from defocus_cli.bench_run import BASELINES, Row, measure_shot, warm_up
from defocus_cli.bench_set import Shot, find_shots, read, sample_set
from defocus_cli.bench_time import Case, Size, measure
from defocus_cli.calibration import calibrated
from defocus_cli.grouped import GroupedCommand
from defocus_cli.option_types import FilePath, Names


@click.command(
    "bench",
    cls=GroupedCommand,
    short_help="Render scenes with known truth or made ones; say error and time.",
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
    default=(),
    metavar="QUALITY,…",
    help=f"What to measure, of {', '.join(options.QUALITIES)}.  "
    f"[default: {','.join(QUALITIES)}; standard with --time]",
)
@click.option("--only", type=Names(), default=(), metavar="SCENE,…", help="Only these scenes.")
@click.option(
    "--baselines/--no-baselines",
    default=True,
    show_default=True,
    help="Also measure the sharp input, the plain sum of slices, and over / alpha.",
)
@click.option(
    "--json",
    "json_file",
    type=FilePath(),
    is_flag=False,
    flag_value=str(STDOUT),
    metavar="[FILE]",
    help="Write all as one JSON document, to FILE or else on stdout; then the table is on stderr.",
)
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
    default=None,
    metavar="N",
    help="Threads to compute with.  [default: one for each core; 1 with --time]",
)
@click.option("--device", type=click.Choice(options.DEVICES), default="auto", show_default=True)
@click.option(
    "--repeat",
    type=click.IntRange(min=1),
    default=None,
    metavar="N",
    help="Render so often, and take the median of the times.  "
    "[default: 1; with --time 5, but no more after a second]",
)
@time_options
@click.pass_context
def command(
    ctx: click.Context,
    truth: Path | None,
    qualities: tuple[str, ...],
    only: tuple[str, ...],
    baselines: bool,
    json_file: Path | None,
    csv_file: Path | None,
    plot_file: Path | None,
    threads: int | None,
    device: str,
    repeat: int | None,
    timing: bool,
    kinds: tuple[str, ...],
    sizes: tuple[Size, ...],
    radii: tuple[float, ...],
    outputs: tuple[str, ...],
    full: bool,
    baseline: Path | None,
    tolerance: float,
    predict: bool,
) -> int:
    """Render scenes with known truth and say how far off each shot is and how long it took.

    PSNR (dB) and SSIM are of sRGB-encoded pictures, relRMSE and p999 (99.9th percentile of the
    error) of linear light. A border as wide as the largest blur is left out. 'edges' is PSNR
    within the largest blur radius of a depth edge, 'other' that of the rest. FFTs is the time in
    transforms of the frame there and back, measured alongside. MB is the peak of the process.

    '!' marks shots on which standard is worse than a baseline by more than 0.1 dB, 0.001 SSIM or
    1 % relative RMSE; they are listed at the end.

    With --time, scenes of several kinds are made and timed on one thread, as one thread makes the
    transforms: at two sizes and radii in half a minute, or at those given. The exponents with
    which times grow follow. --baseline compares FFTs with a stored run.

    \b
    Examples:
      defocus bench
      defocus bench --truth ../truth --quality standard --only cards,fence
      defocus bench --repeat 3 --json bench.json --csv bench.csv --plot bench.png
      defocus bench --time --json before.json
      defocus bench --time --baseline before.json --tolerance 0.1
      defocus bench --time --predict --threads 2
      defocus bench --time --kinds floor,cards --sizes 1920x1080 --radii 2,8,32,128
    """  # noqa: D301  click reads the backspace
    refuse_others(ctx, timing=timing)
    files = Files(json_file, csv_file, plot_file)
    files.refuse_unwritable()
    if timing:
        times = Times(kinds, sizes, radii, outputs, full, baseline, tolerance, predict)
        return _times(times, times.cases(qualities), files, device, threads or 1, repeat or 5)
    shots = find_shots(truth or sample_set(), only)
    methods = (*(qualities or QUALITIES), *(BASELINES if baselines else ()))
    settings = {"truth": str(truth or sample_set())}
    _errors(shots, methods, files, settings, device, threads or options.cores(), repeat or 1)
    return 0


def _errors(
    shots: Sequence[Shot],
    methods: Sequence[str],
    files: Files,
    settings: dict[str, Any],
    device: str,
    threads: int,
    repeat: int,
) -> None:
    from defocus_cli import engine

    engine.load()
    found, echo = engine.choose_device(device), files.echo
    rows: list[Row] = []
    warm_up(found)
    echo(bench_table.heading())
    with _progress(len(shots) * len(methods), echo) as (step, tell):
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
        echo(line)
    files.write(rows, {**settings, "device": found, "threads": threads, "repeat": repeat})


def _times(
    times: Times, cases: Sequence[Case], files: Files, device: str, threads: int, repeat: int
) -> int:
    """The exit code: 1 if anything got slower than the stored run."""
    stored = read_baseline(times.baseline) if times.baseline else None
    from defocus_cli import engine

    engine.load()
    found, echo = engine.choose_device(device), files.echo
    if stored:
        stored.refuse_incomparable(cases, threads=threads, device=found)
    known = calibrated(found, threads) if times.predict else None
    timed = partial(measure, device=found, threads=threads, repeat=repeat, calibration=known)
    warm_up(found)
    echo(bench_time_table.heading(predicted=times.predict))
    timings = []
    with _progress(len(cases), echo) as (step, tell):
        for case in cases:
            timings.append(timed(case))
            step()
            tell(bench_time_table.line(timings[-1]))
    for line in bench_time_table.scaling_lines(timings):
        echo(line)
    if times.predict:
        for line in bench_time_table.prediction_lines(timings):
            echo(line)
    settings: dict[str, Any] = {"device": found, "threads": threads, "repeat": repeat}
    worse: Sequence[Mapping[str, Any]] = ()
    if stored:
        worse = stored.slower(timings, times.tolerance)
        if worse:  # once more: what was slow for another reason is not slow twice
            named = {each["case"] for each in worse}
            again = {case: timed(case) for case in cases if case.name in named}
            timings = [faster(again.get(timing.case), timing) for timing in timings]
            worse = stored.slower(timings, times.tolerance)
        compared = stored.compare(timings)
        settings["baseline"] = {"tolerance": times.tolerance, "cases": compared}
        for line in bench_time_table.comparison_lines(compared, worse, times.tolerance):
            echo(line)
    document = {**settings, **bench_time_table.document(timings)}
    files.write_tables(document, lambda: bench_time_table.csv_text(timings))
    return 1 if worse else 0


@contextmanager
def _progress(
    total: int, echo: Callable[[str], object]
) -> Iterator[tuple[Callable[[], object], Callable[[str], object]]]:
    """What to call after each rendering, and what says a line above the bar, if a terminal sees."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda: None, echo
        return
    from tqdm import tqdm

    with tqdm(total=total, unit="rendering", file=sys.stderr, leave=False) as bar:

        def tell(line: str) -> None:
            with tqdm.external_write_mode(file=sys.stdout):
                echo(line)

        yield bar.update, tell

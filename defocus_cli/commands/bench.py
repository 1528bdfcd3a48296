"""``defocus bench``: error and time on scenes with known truth, or time on made scenes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click

from defocus_cli.bench import error_plot, tables
from defocus_cli.bench.baseline import read_baseline
from defocus_cli.bench.error import BASELINES, Row, measure_shot
from defocus_cli.bench.result_files import STDOUT, Files, progress
from defocus_cli.bench.timing import RADII, SIZES, Case, Size, cases, time_case, warm_up
from defocus_cli.bench.truth_set import find_shots, read, sample_set
from defocus_cli.jobs.job import DEVICES, QUALITIES
from defocus_cli.options import shared
from defocus_cli.options.types import FilePath, GroupedCommand, GroupedOption, Listed, Names
from defocus_cli.system.errors import UsageProblem

_QUALITIES = ("draft", "standard", "high")
# By the name of the parameter; options in neither go with both.
_ERRORS_ALONE = {"truth": "--truth", "plot_file": "--plot"}
_TIMES_ALONE = {"sizes": "--sizes", "radii": "--radii", "baseline": "--baseline"}
_LONGEST = 1 << 15  # px on a side


def _size(word: str) -> Size:
    width, height = map(int, word.lower().replace("×", "x").split("x"))
    if not (1 <= width <= _LONGEST and 1 <= height <= _LONGEST):
        raise ValueError(word)
    return width, height


def _radius(word: str) -> float:
    radius = float(word.removesuffix("px"))
    if not 0 < radius < math.inf:
        raise ValueError(word)
    return radius


_time_option = partial(click.option, cls=GroupedOption, heading="Time")


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
    type=Names(QUALITIES),
    default=(),
    metavar="QUALITY,…",
    help=f"What to measure, of {', '.join(QUALITIES)}.  "
    f"[default: {','.join(_QUALITIES)}; standard with --time]",
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
@click.option("--device", type=click.Choice(DEVICES), default="auto", show_default=True)
@_time_option("--time", "timing", is_flag=True, help="Time made scenes instead.")
@_time_option(
    "--sizes",
    type=Listed(_size, "size", "480x270,1920x1080"),
    default=SIZES,
    metavar="WxH,…",
    help="Sizes in px.  [default: 480x270,960x540]",
)
@_time_option(
    "--radii",
    type=Listed(_radius, "radius", "8,32"),
    default=RADII,
    metavar="R,…",
    help="Largest blur radii in px.  [default: 8,32]",
)
@_time_option(
    "--baseline",
    type=FilePath(),
    default=None,
    metavar="FILE",
    help="A stored run (--json) to compare with; exit 1 if a case takes 25 % more FFTs.",
)
@click.pass_context
def command(
    ctx: click.Context,
    truth: Path | None,
    qualities: tuple[str, ...],
    json_file: Path | None,
    plot_file: Path | None,
    threads: int | None,
    device: str,
    timing: bool,
    sizes: tuple[Size, ...],
    radii: tuple[float, ...],
    baseline: Path | None,
) -> int:
    """Render scenes with known truth and say how far off each shot is and how long it took.

    Beside the qualities stand the sharp input, the plain sum of slices, and over / alpha.

    PSNR (dB) and SSIM are of sRGB-encoded pictures, relRMSE and p999 (99.9th percentile of the
    error) of linear light. A border as wide as the largest blur is left out. 'edges' is PSNR
    within the largest blur radius of a depth edge, 'other' that of the rest. FFTs is the time in
    transforms of the frame there and back, measured alongside. MB is the peak of the process.

    '!' marks shots on which standard is worse than a baseline by more than 0.1 dB, 0.001 SSIM or
    1 % relative RMSE; they are listed at the end.

    With --time, scenes of several kinds are made and timed on one thread, as one thread makes the
    transforms: at two sizes and radii in half a minute, or at those given. --baseline compares
    FFTs with a stored run.

    \b
    Examples:
      defocus bench
      defocus bench --truth ../truth --quality standard
      defocus bench --json bench.json --plot bench.png
      defocus bench --time --json before.json
      defocus bench --time --baseline before.json
      defocus bench --time --sizes 1920x1080 --radii 2,8,32,128
    """  # noqa: D301  click reads the backspace
    _refuse_others(ctx, timing=timing)
    files = Files(json_file, plot_file)
    files.refuse_unwritable()
    if timing:
        asked = cases(sizes, radii, qualities or ("standard",))
        return _times(asked, baseline, files, device, threads or 1)
    _errors(truth or sample_set(), qualities or _QUALITIES, files, device, threads)
    return 0


def _refuse_others(ctx: click.Context, *, timing: bool) -> None:
    """Refuse options that would mean nothing.

    Raises:
        UsageProblem: one was given.
    """
    for name, option in (_ERRORS_ALONE if timing else _TIMES_ALONE).items():
        if ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            if timing:
                raise UsageProblem(option, "means nothing with --time", "leave one of them out")
            raise UsageProblem(option, "means nothing without --time", "add --time")


def _errors(
    truth: Path, qualities: Sequence[str], files: Files, device: str, threads: int | None
) -> None:
    """Measure all shots of a set, by each quality and each baseline."""
    from defocus_cli.rendering import job_steps

    shots, methods = find_shots(truth), (*qualities, *BASELINES)
    job_steps.load()
    device, threads = job_steps.choose_device(device), threads or shared.cores()
    warm_up(device)
    files.echo(tables.error_heading())
    rows: list[Row] = []
    with progress(len(shots) * len(methods), files.echo) as (step, tell):
        for shot in shots:
            of_shot = []
            for row in measure_shot(shot, read(shot), methods, device=device, threads=threads):
                of_shot.append(row)
                step()
            for line in tables.shot_lines(of_shot):
                tell(line)
            rows += of_shot
    for line in tables.summary_lines(rows):
        files.echo(line)
    settings = {"truth": str(truth), "device": device, "threads": threads}
    files.write_json({**settings, **tables.error_document(rows)})
    if files.plot is not None:
        error_plot.draw(files.plot, rows)


def _times(
    asked: Sequence[Case], baseline: Path | None, files: Files, device: str, threads: int
) -> int:
    """Time all cases; the exit code is 1 if one got slower than the stored run."""
    from defocus_cli.rendering import job_steps

    stored = read_baseline(baseline) if baseline else None
    job_steps.load()
    device = job_steps.choose_device(device)
    if stored:
        stored.refuse_incomparable(asked, threads=threads, device=device)
    timed = partial(time_case, device=device, threads=threads)
    warm_up(device)
    files.echo(tables.time_heading())
    timings = []
    with progress(len(asked), files.echo) as (step, tell):
        for case in asked:
            timings.append(timed(case))
            step()
            tell(tables.time_line(timings[-1]))
    document = {"device": device, "threads": threads}
    slower = False
    if stored:
        timings = stored.confirmed(timings, timed)
        compared, worse = stored.compare(timings), stored.slower(timings)
        slower, document["baseline"] = bool(worse), compared
        for line in tables.comparison_lines(compared, worse):
            files.echo(line)
    rows = [tables.time_record(timing) for timing in timings]
    files.write_json({**document, "rows": rows})
    return 1 if slower else 0

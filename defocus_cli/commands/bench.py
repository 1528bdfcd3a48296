"""``defocus bench``: error and time on scenes with known truth, or time on synthetic scenes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from defocus_cli.options.shared import FilePath, GroupedCommand, json_option, option
from defocus_cli.words import console
from defocus_core.allowed_values import QUALITIES
from defocus_core.bench import error
from defocus_core.bench.launches import counted, line, names, with_table
from defocus_core.bench.timing import RADII, SIZES, Size, cases, time_case, warm_up
from defocus_core.bench.truth_set import find_shots, read, sample_set
from defocus_core.errors import UsageProblem
from defocus_core.io.safe_files import written_whole
from defocus_core.request.job import DEVICES
from defocus_core.request.job_options import MAX_THREADS
from defocus_core.request.quantities import one_of, pixel_count, several
from defocus_core.system.process import cores

_time_option = partial(option, heading="Time")

_QUALITIES = ("standard", "high")
# Options by the name of the parameter, and which mean nothing to each way to measure.
_NAMES = {
    **{"timing": "--time", "qualities": "--quality", "threads": "--threads", "device": "--device"},
    **{"truth": "--truth", "sizes": "--sizes", "radii": "--radii"},
}
_IDLE = {"": ("sizes", "radii"), "--time": ("truth",), "--launches": tuple(_NAMES)}
_LONGEST = 1 << 15  # px on a side


def _size(word: str) -> Size:
    width, height = map(int, word.lower().replace("×", "x").split("x"))
    if not (1 <= width <= _LONGEST and 1 <= height <= _LONGEST):
        raise ValueError(word)
    return width, height


@click.command("bench", cls=GroupedCommand)
@option(
    "--truth DIR",
    "Set of scenes, <scene>/camera.json.  [default: sample_scenes of the repository]",
    FilePath(),
)
@option(
    "--quality QUALITY,…",
    f"What to measure, of {', '.join(QUALITIES)}.  "
    f"[default: {','.join(_QUALITIES)}; standard with --time]",
    several(one_of(QUALITIES), "standard,high"),
    into="qualities",
    default=(),
)
@option(
    "--threads N",
    "Threads to compute with.  [default: one for each core; 1 with --time]",
    click.IntRange(1, MAX_THREADS),
)
@option("--device", "", DEVICES, default="auto", show_default=True)
@json_option
@_time_option("--time", "Time synthetic scenes instead.", into="timing")
@_time_option(
    "--launches FILE",
    "Count what a GPU would be asked for instead, without one, and write the table into FILE, "
    "in the place of the one it holds.",
    FilePath(),
)
@_time_option(
    "--sizes WxH,…",
    "Sizes in px.  [default: 480x270,960x540]",
    several(_size, "480x270,1920x1080"),
    default=SIZES,
)
@_time_option(
    "--radii R,…",
    "Largest blur radii in px.  [default: 8,32]",
    several(pixel_count, "8,32"),
    default=RADII,
)
@click.pass_context
def command(
    ctx: click.Context,
    truth: Path | None,
    qualities: tuple[str, ...],
    threads: int | None,
    device: str,
    as_json: bool,
    timing: bool,
    launches: Path | None,
    sizes: tuple[Size, ...],
    radii: tuple[float, ...],
) -> None:
    """Render scenes with known truth and say how far off each shot is and how long it took.

    Beside the qualities stand the sharp input, the plain sum of slices, and over / alpha.

    PSNR (dB) and SSIM are of sRGB-encoded pictures, relRMSE and p999 (99.9th percentile of the
    error) of linear light. A border as wide as the largest blur is left out. 'edges' is PSNR
    within the largest blur radius of a depth edge, 'other' that of the rest. FFTs is the time in
    transforms of the frame there and back, measured alongside. MB is the peak of the process.

    '!' marks shots on which standard is worse than a baseline by more than 0.1 dB, 0.001 SSIM or
    1 % relative RMSE; they are listed at the end.

    With --time, synthetic scenes of several kinds are timed on one thread, as one thread makes the
    transforms: at two sizes and radii in half a minute, or at those given. With --json the table
    is on stderr.

    With --launches, what a GPU is asked for is counted on a pretended one of 8 GB.

    \b
    Examples:
      defocus bench
      defocus bench --truth ../truth --quality standard
      defocus bench --time --json > times.json
      defocus bench --time --sizes 1920x1080 --radii 2,8,32,128
      defocus bench --launches defocus_cli/help/quality.md
    """  # noqa: D301  click reads the backspace
    _refuse_others(ctx, "--launches" if launches is not None else "--time" if timing else "")
    echo = console.stderr if as_json else console.stdout
    if launches is not None:
        document = _launches(launches, echo)
    elif timing:
        document = _times(sizes, radii, qualities or ("standard",), device, threads or 1, echo)
    else:
        truth, threads = truth or sample_set(), threads or cores()
        document = _errors(truth, qualities or _QUALITIES, device, threads, echo)
    if as_json:
        console.print_json(**document)


def _refuse_others(ctx: click.Context, mode: str) -> None:
    """Refuse options that would mean nothing."""
    problem, remedy = f"has no effect with {mode}", "leave one of them out"
    if not mode:
        problem, remedy = "has no effect without --time", "add --time"
    for name in _IDLE[mode]:
        if ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            raise UsageProblem("contradiction", problem, remedy, path=_NAMES[name])


def _launches(path: Path, echo: Callable[[str], None]) -> dict[str, Any]:
    """Count what a device is asked for, and write the table: the document."""
    text = path.read_bytes().decode(errors="replace") if path.exists() else None
    with_table(text, [], path)  # what holds no table is refused first
    warm_up("cpu")
    cases = []
    for name in names():
        cases.append(counted(name))
        echo(line(cases[-1]))
    with written_whole(path) as file:
        file.write(with_table(text, cases, path).encode())
    return {
        "rows": [
            {"case": name, "alone": alone._asdict(), "left_right": pair._asdict()}
            for name, alone, pair in cases
        ]
    }


def _errors(
    truth: Path,
    qualities: Sequence[str],
    device: str,
    threads: int,
    echo: Callable[[str], None],
) -> dict[str, Any]:
    """Measure all shots of a set, by each baseline and each quality: the document."""
    shots, methods = find_shots(truth), (*error.BASELINES, *qualities)
    device = warm_up(device)
    echo(error.heading(error.ERRORS))
    rows: list[error.Row] = []
    for shot in shots:
        for row in error.measure_shot(shot, read(shot), methods, device=device, threads=threads):
            rows.append(row)
            mark = " !" if error.losses(row, rows) else ""
            echo(error.line(error.record(row), error.ERRORS) + mark)
    for words in error.summary_lines(rows):
        echo(words)
    settings = {"truth": str(truth), "device": device, "threads": threads}
    return {**settings, **error.error_document(rows)}


def _times(
    sizes: Sequence[Size],
    radii: Sequence[float],
    qualities: Sequence[str],
    device: str,
    threads: int,
    echo: Callable[[str], None],
) -> dict[str, Any]:
    """Time all cases: the document."""
    device = warm_up(device)
    echo(error.heading(error.TIMES))
    rows = []
    for case in cases(sizes, radii, qualities):
        cost = time_case(case, device=device, threads=threads)
        rows.append(error.time_record(case, cost))
        width, height = case.size
        shown = {"size": f"{width}x{height}", "radius": f"{case.radius:g}"}
        echo(error.line(rows[-1] | shown, error.TIMES))
    return {"device": device, "threads": threads, "rows": rows}

"""Options of ``defocus bench``, and which of them belong to errors or to times alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from defocus_cli.bench_time import KINDS, OUTPUTS, Case, Size, cases
from defocus_cli.errors import UsageProblem
from defocus_cli.grouped import GroupedOption
from defocus_cli.option_types import FilePath, Listed, Names

Command = Callable[..., Any]

# By the name of the parameter; what is in neither goes with both.
ERRORS_ALONE = {"truth": "--truth", "only": "--only", "plot_file": "--plot"}
ERRORS_ALONE |= {"baselines": "--baselines and --no-baselines"}
TIMES_ALONE = {"kinds": "--kinds", "sizes": "--sizes", "radii": "--radii", "outputs": "--outputs"}
TIMES_ALONE |= {
    "predict": "--predict",
    "full": "--full",
    "baseline": "--baseline",
    "tolerance": "--tolerance",
}
# What is told of errors, and at which sizes and radii times are taken, unless asked for otherwise.
QUALITIES = ("draft", "standard", "high")
_QUICK: dict[str, tuple[Any, ...]] = {
    "sizes": ((480, 270), (960, 540)),
    "radii": (8.0, 32.0),
    "qualities": ("standard",),
    "outputs": ("centre",),
}
_FULL: dict[str, tuple[Any, ...]] = {
    "sizes": ((480, 270), (960, 540), (1920, 1080), (3840, 2160)),
    "radii": (2.0, 8.0, 32.0, 128.0),
    "qualities": QUALITIES,
    "outputs": tuple(OUTPUTS),
}
_LONGEST = 1 << 15  # px on a side


@dataclass(frozen=True)
class Times:
    """What ``--time`` was asked for; None or empty is what is usual."""

    kinds: tuple[str, ...]
    sizes: tuple[Size, ...]
    radii: tuple[float, ...]
    outputs: tuple[str, ...]
    full: bool
    baseline: Path | None
    tolerance: float
    predict: bool

    def cases(self, qualities: tuple[str, ...]) -> list[Case]:
        """What is to be timed."""
        usual = _FULL if self.full else _QUICK
        return cases(
            self.kinds or tuple(KINDS),
            self.sizes or usual["sizes"],
            self.radii or usual["radii"],
            qualities or usual["qualities"],
            self.outputs or usual["outputs"],
        )


def refuse_others(ctx: click.Context, *, timing: bool) -> None:
    """Refuse options that would mean nothing.

    Raises:
        UsageProblem: one was given.
    """
    for name, option in (ERRORS_ALONE if timing else TIMES_ALONE).items():
        if ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
            if timing:
                raise UsageProblem(option, "means nothing with --time", "leave one of them out")
            raise UsageProblem(option, "means nothing without --time", "add --time")


def time_options(command: Command) -> Command:
    """Hand a command ``timing``, and what else ``--time`` goes by."""
    for option in reversed(_TIME_OPTIONS):
        command = option(command)
    return command


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


def _option(*names: str, **settings: Any) -> Callable[[Command], Command]:
    return click.option(*names, cls=GroupedOption, heading="Time", **settings)


_TIME_OPTIONS = (
    _option("--time", "timing", is_flag=True, help="Time made scenes instead."),
    _option(
        "--kinds",
        type=Names(tuple(KINDS)),
        default=(),
        metavar="KIND,…",
        help=f"Scenes to time, of {', '.join(KINDS)}.  [default: all]",
    ),
    _option(
        "--sizes",
        type=Listed(_size, "size", "480x270,1920x1080"),
        default=(),
        metavar="WxH,…",
        help="Sizes in px.  [default: 480x270,960x540]",
    ),
    _option(
        "--radii",
        type=Listed(_radius, "radius", "8,32"),
        default=(),
        metavar="R,…",
        help="Largest blur radii in px.  [default: 8,32]",
    ),
    _option(
        "--outputs",
        type=Names(tuple(OUTPUTS)),
        default=(),
        metavar="WHAT,…",
        help="centre, pair (left and right), or all kinds of output.  [default: centre]",
    ),
    _option(
        "--full",
        is_flag=True,
        help="All sizes to 3840x2160, radii to 128, qualities and outputs, where not given: hours.",
    ),
    _option(
        "--baseline",
        type=FilePath(),
        default=None,
        metavar="FILE",
        help="A stored run (--json) to compare with; exit 1 if anything got slower.",
    ),
    _option(
        "--tolerance",
        type=click.FloatRange(min=0, min_open=True),
        default=0.25,
        show_default=True,
        metavar="SHARE",
        help="How much slower, in FFTs, counts as slower.",
    ),
    _option("--predict", is_flag=True, help="Say besides what a dry run would have said."),
)

"""Options of comparisons: rules, what is compared, and reports.

``@comparison_options()`` adds ``--fail``, … and hands the command ``asked: Asked``.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from defocus_cli.options import shared
from defocus_cli.options.types import (
    Decorator,
    FilePath,
    Quantity,
    ReportPath,
    bundle,
    grouped_option,
    position_of,
)
from defocus_cli.words.endings import Failures
from defocus_core.compare.record import CompareSettings, Comparison
from defocus_core.compare.run import CAUSES, FIRST, Task
from defocus_core.compare.selection import region
from defocus_core.compare.thresholds import (
    OVER,
    PRESETS,
    Rule,
    Rules,
    Thresholds,
    difference,
    read_thresholds,
    rule,
)
from defocus_core.errors import DefocusError
from defocus_core.reports.comparison_words import write_junit
from defocus_core.reports.html import comparisons

_NO_RULES = Rules()
_DIFF = "Write differences here: signed in NAME.diff.exr, amplified in NAME.diff.png."
_HTML = "Write a report to look at in a browser: one file, with the pictures in it."


@dataclass(frozen=True)
class ComparisonOptions:
    """A comparison as it is asked for.

    Attributes:
        rules: the thresholds, of options over those of the file.
        file: the file of thresholds.
        settings: what is compared.
        diff: directory for difference images.
        junit: file for JUnit XML.
        html: file for the report that people look at.
        causes: of which failing pairs the cause is sought, a key of `CAUSES`.
    """

    rules: Thresholds
    file: Path | None
    settings: CompareSettings
    diff: Path | None = None
    junit: Path | None = None
    html: Path | None = None
    causes: str = "first"

    @property
    def task(self) -> Task:
        """What is to be done with each pair."""
        return Task(self.rules, self.settings, self.diff, self.causes)

    @property
    def reports(self) -> dict[str, Path | None]:
        """The files that are asked for, by option."""
        return {"--diff": self.diff, "--junit": self.junit, "--html": self.html}

    def write_reports(
        self,
        records: Sequence[Comparison],
        header: comparisons.ReportHeader,
        seconds: float,
        processes: int,
    ) -> Failures:
        """Write the reports that are asked for; what could not be written."""
        failures = Failures()
        try:
            if self.junit is not None:
                write_junit(self.junit, records, seconds)
        except DefocusError as error:
            failures.add(error)
        try:
            if self.html is not None:
                comparisons.write(self.html, header, records, self.settings, processes)
        except DefocusError as error:
            failures.add(error)
        return failures


def comparison_options(default: Rules = _NO_RULES, *, whole: bool = True) -> Decorator:
    """Hand a command ``asked``: rules; if ``whole``, also what is compared, and reports.

    Args:
        default: rules that hold where neither options nor a file say anything.
        whole: whether parts of pictures may be chosen, and reports be written.
    """

    def make(
        *,
        fail: tuple[Rule, ...],
        warn: tuple[Rule, ...],
        over: float | None,
        thresholds: Path | None,
        like: str | None = None,
        diff: Path | None = None,
        junit: Path | None = None,
        html: Path | None = None,
        causes: str = "first",
        **settings: Any,
    ) -> ComparisonOptions:
        rules = read_thresholds(
            thresholds, fail, warn, over, default if like is None else PRESETS[like]
        )
        chosen = CompareSettings(**settings)
        return ComparisonOptions(rules, thresholds, chosen, diff, junit, html, causes)

    options = [*_rules(), *([*_selection(), *_reports()] if whole else [])]
    return bundle("asked", make, options)


class _Difference(click.ParamType[float]):
    """A difference of 0 or more."""

    name = "difference"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number."""
        try:
            return difference(float(value), position_of(param))
        except ValueError:
            return difference(value, position_of(param))


class _Names(click.ParamType[tuple[str, ...]]):
    """Names, separated by commas."""

    name = "names"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """The names."""
        if isinstance(value, tuple):
            return value
        return tuple(name.strip() for name in value.split(",") if name.strip())


def _rules() -> list[Decorator]:
    option = functools.partial(grouped_option, "Rules")
    return [
        option(
            "--fail",
            type=Quantity(rule, "RULE"),
            multiple=True,
            metavar="RULE",
            help="A picture fails if it meets the rule, like 'hdr-p99.9>0.01' or 'found:clipped'; "
            "may be repeated. Values that differ fail no more, unless a rule says so.",
        ),
        option(
            "--warn",
            type=Quantity(rule, "RULE"),
            multiple=True,
            metavar="RULE",
            help="A picture that passes gets a warning if it meets the rule.",
        ),
        option(
            "--over",
            type=_Difference(),
            metavar="DIFFERENCE",
            help=f"Difference of a channel that 'share' counts pixels beyond.  [default: {OVER}]",
        ),
        option(
            "--like",
            type=click.Choice(list(PRESETS)),
            help="Rules for what B is to be like, where no others are given: the same program on "
            "another machine (render), a lossy codec (encoder), the same machine (golden).",
        ),
        option(
            "--thresholds",
            type=FilePath(),
            metavar="FILE",
            help="TOML file with fail, warn and over, for all pictures and for patterns of names; "
            "options above win.",
        ),
        option("--metadata", is_flag=True, help="Metadata that differs fails, too."),
        option(
            "--ignore-metadata",
            type=_Names(),
            metavar="NAME,…",
            default=(),
            help="Attributes that may differ, besides times and the program that wrote the file; "
            "* stands for any characters.",
        ),
    ]


def _selection() -> list[Decorator]:
    option = functools.partial(grouped_option, "What is compared")
    return [
        option(
            "--region",
            type=Quantity(region, "X,Y,W,H"),
            metavar="X,Y,W,H",
            help="Only these pixels, counted from the top left of the picture.",
        ),
        option(
            "--mask",
            type=FilePath(),
            metavar="FILE",
            help="Only pixels where this picture is not 0.",
        ),
        option(
            "--ignore-region",
            type=Quantity(region, "X,Y,W,H"),
            multiple=True,
            metavar="X,Y,W,H",
            help="All pixels but these; may be repeated.",
        ),
        option(
            "--ignore-mask",
            type=FilePath(),
            metavar="FILE",
            help="All pixels but those where this picture is not 0.",
        ),
        option(
            "--tolerate-edges",
            is_flag=True,
            help="Pixels at lines and edges may differ as far as their neighbours do, as by "
            "another anti-aliasing.",
        ),
        option(
            "--coc",
            type=FilePath(),
            metavar="DIR",
            help="CoC maps of the pictures, by the same names, to measure near depth edges and "
            "elsewhere.",
        ),
        option("--flip", is_flag=True, help="Measure FLIP, too: what a person would see."),
    ]


def _reports() -> list[Decorator]:
    option = functools.partial(grouped_option, "Output")
    return [
        option(
            "--causes",
            type=click.Choice(list(CAUSES)),
            default="first",
            help=f"Of which failing pairs the cause is sought: the first {FIRST}, all or none; "
            "a rule like 'found:noise' seeks it in all.  [default: first]",
        ),
        option("--diff", type=FilePath(), metavar="DIR", help=_DIFF),
        option(
            "--junit",
            type=ReportPath("junit"),
            metavar="FILE",
            help="Write JUnit XML, a case for each pair.",
        ),
        shared.html_option(_HTML),
    ]

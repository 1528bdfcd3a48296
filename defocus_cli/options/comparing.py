"""Options of comparisons: rules, what is compared, and reports."""

from __future__ import annotations

import functools
from typing import Any

import click

from defocus_cli.compare.selection import region
from defocus_cli.compare.thresholds import OVER, difference, rule
from defocus_cli.options.shared import cores, machine_option
from defocus_cli.options.types import (
    Command,
    Decorator,
    FilePath,
    Quantity,
    grouped_option,
    option_name,
)


class _Difference(click.ParamType[float]):
    """A difference of 0 or more."""

    name = "difference"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """The number."""
        try:
            return difference(float(value), option_name(param))
        except ValueError:
            return difference(value, option_name(param))


def rule_options(command: Command) -> Command:
    """Hand a command ``fail``, ``warn``, ``over``, ``thresholds`` and ``metadata``."""
    option = functools.partial(grouped_option, "Rules")
    options = [
        option(
            "--fail",
            type=Quantity(rule, "RULE"),
            multiple=True,
            metavar="RULE",
            help="A picture fails if it meets the rule, like 'psnr<45'; may be repeated. Values "
            "that differ fail no more, unless a rule says so.",
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
            "--thresholds",
            type=FilePath(),
            metavar="FILE",
            help="TOML file with fail, warn and over, for all pictures and for patterns of names; "
            "options above win.",
        ),
        option("--metadata", is_flag=True, help="Metadata that differs fails, too."),
    ]
    return _with(command, options)


def selection_options(command: Command) -> Command:
    """Hand a command ``region``, ``mask``, ``coc`` and ``flip``."""
    option = functools.partial(grouped_option, "What is compared")
    options = [
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
            "--coc",
            type=FilePath(),
            metavar="DIR",
            help="CoC maps of the pictures, by the same names, to measure near depth edges and "
            "elsewhere.",
        ),
        option("--flip", is_flag=True, help="Measure FLIP, too: what a person would see."),
    ]
    return _with(command, options)


def report_options(command: Command) -> Command:
    """Hand a command ``diff``, ``junit``, ``html`` and ``processes``."""
    option = functools.partial(grouped_option, "Output")
    options = [
        option(
            "--diff",
            type=FilePath(),
            metavar="DIR",
            help="Write differences here: signed in NAME.diff.exr, amplified in NAME.diff.png.",
        ),
        option(
            "--junit",
            type=FilePath(),
            metavar="FILE",
            help="Write JUnit XML, a case for each pair.",
        ),
        html_option("Write a report to look at in a browser: one file, with the pictures in it."),
        machine_option(
            "--processes",
            type=click.IntRange(min=1),
            default=cores,
            metavar="N",
            help="Processes to compare directories with.  [default: one for each core]",
        ),
    ]
    return _with(command, options)


def html_option(text: str) -> Decorator:
    """``--html``: where to write the report that people look at."""
    return grouped_option("Output", "--html", type=FilePath(), metavar="FILE.html", help=text)


def _with(command: Command, options: list[Any]) -> Command:
    for option in reversed(options):
        command = option(command)
    return command

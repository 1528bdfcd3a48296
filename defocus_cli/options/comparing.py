"""Options of comparisons: rules, what is compared, reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from defocus_cli.options.shared import Decorator, FilePath, ReportPath, bundle, option
from defocus_cli.words.console import Failures
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
from defocus_core.errors import CALLER, UsageProblem
from defocus_core.reports.comparison_words import write_junit
from defocus_core.reports.html import comparisons
from defocus_core.reports.markdown import write_markdown
from defocus_core.request.quantities import QuantityError, several

_REPORTS = ("diff", "junit", "html", "markdown", "causes")  # attributes of ComparisonOptions
_rule_option = partial(option, heading="Rules")
_selecting_option = partial(option, heading="What is compared")
_report_option = partial(option, heading="Reports")
_DIFF = (
    "For each picture that differs, write two to this directory: the signed difference B - A, "
    "NAME.diff.exr, and a visible one, NAME.diff.png."
)
_HTML = "Write a report for a browser: one file that holds the pictures, too."


@dataclass(frozen=True)
class ComparisonOptions:
    """The options of a comparison."""

    rules: Thresholds  # rules of options, above those of the file
    file: Path | None  # of thresholds
    settings: CompareSettings
    diff: Path | None = None  # the folder of difference images
    junit: Path | None = None
    html: Path | None = None
    markdown: Path | None = None
    causes: str = "first"  # the failing pairs whose cause is sought, a key of `CAUSES`

    @property
    def task(self) -> Task:
        """The task to carry out for each pair."""
        return Task(self.rules, self.settings, self.diff, self.causes)

    def write_reports(
        self,
        records: Sequence[Comparison],
        header: comparisons.ReportHeader,
        *,
        pairs: int,
        seconds: float,
        processes: int,
    ) -> Failures:
        """Write the requested reports; return the errors of those that cannot be written."""
        failures = Failures()
        with failures.kept():
            if self.junit is not None:
                write_junit(self.junit, records, seconds)
        with failures.kept():
            if self.html is not None:
                comparisons.write(self.html, header, records, processes)
        with failures.kept():
            if self.markdown is not None:
                write_markdown(self.markdown, header.title, records, pairs)
        return failures


def comparison_options() -> Decorator:
    """Add the options of comparisons to a command, which gets them as ``asked``."""

    def make(
        fail: tuple[Rule, ...],
        warn: tuple[Rule, ...],
        over: float | None,
        thresholds: Path | None,
        like: str | None,
        ignore_channels: tuple[str, ...],
        **others: Any,
    ) -> ComparisonOptions:
        default = Rules() if like is None else PRESETS[like]
        rules = read_thresholds(thresholds, fail, warn, over, default, ignore_channels)
        asked = {name: others.pop(name) for name in _REPORTS}
        return ComparisonOptions(rules, thresholds, CompareSettings(**others), **asked)

    return bundle("asked", make, [*_rules(), *_selection(), *_reports()])


def _difference(text: str) -> float:
    try:
        return difference(float(text), CALLER)
    except (ValueError, UsageProblem):
        problem, remedy = f"'{text}' is not a difference of 0 or more", f"write {OVER}"
        raise QuantityError(problem, remedy) from None


def _rules() -> list[Decorator]:
    return [
        _rule_option(
            "--fail RULE",
            "Rule by which a picture fails, like 'hdr-p99.9>0.01' for a metric or 'found:clipped' "
            "for a cause; may be repeated. Pictures that meet no rule pass, even if values differ. "
            "[default: any difference of values fails]",
            rule,
            multiple=True,
        ),
        _rule_option(
            "--warn RULE",
            "Rule by which a picture that passes gets a warning; may be repeated.",
            rule,
            multiple=True,
        ),
        _rule_option(
            "--over DIFFERENCE",
            "Difference above which the metrics 'share' and 'pixels' count a pixel; white is 1.  "
            f"[default: {OVER}]",
            _difference,
        ),
        _rule_option(
            "--like",
            "Ready-made rules, by where B comes from: golden, the same program and machine; "
            "render, the same program on another machine; encoder, a lossy codec. --fail replaces "
            "them.",
            list(PRESETS),
        ),
        _rule_option(
            "--thresholds FILE",
            "TOML file of rules: fail, warn, over and ignore-channels, for all pictures or for "
            "those whose names match a pattern. Options on the command line win over it.",
            FilePath(),
        ),
        _rule_option("--metadata", "Pictures fail if their metadata differs, too."),
        _rule_option(
            "--ignore-metadata NAME,…",
            "Metadata that may differ, like 'capDate,exif:*'; * stands for any characters. Times "
            "and the program that wrote the file may always differ.",
            several(str),
            default=(),
        ),
    ]


def _selection() -> list[Decorator]:
    return [
        _selecting_option(
            "--ignore-channels NAME,…",
            "Leave out these channels, like 'rand.*'; '[!RGB]*' leaves out all but R, G and B.",
            several(str),
            default=(),
        ),
        _selecting_option(
            "--region X,Y,W,H",
            "Compare only this rectangle: column and row of its top left pixel, counted from 0, "
            "width and height in px, like 0,0,64,64.  [default: the whole picture]",
            region,
        ),
        _selecting_option(
            "--mask FILE", "Compare only pixels where this picture is not 0.", FilePath()
        ),
        _selecting_option(
            "--ignore-region X,Y,W,H",
            "Leave out this rectangle, as for --region; may be repeated.",
            region,
            multiple=True,
        ),
        _selecting_option(
            "--ignore-mask FILE", "Leave out pixels where this picture is not 0.", FilePath()
        ),
        _selecting_option(
            "--tolerate-edges",
            "Leave out pixels that are anti-aliased in A or B: those beside a flat colour that lie "
            "between a darker and a brighter neighbour.",
        ),
        _selecting_option(
            "--flip",
            "Also measure FLIP, the difference that a person would see; needs "
            "pip install 'defocus[flip]'.",
        ),
    ]


def _reports() -> list[Decorator]:
    return [
        _report_option(
            "--causes",
            f"In which pictures that fail to look for the cause: the first {FIRST}, all, or none. "
            "A rule like 'found:noise' looks for its cause in all pictures.  [default: first]",
            list(CAUSES),
            default="first",
        ),
        _report_option("--diff DIR", _DIFF, FilePath()),
        _report_option(
            "--junit FILE",
            "Write a JUnit XML file, with a test case for each picture.",
            ReportPath("junit"),
        ),
        _report_option("--html FILE.html", _HTML, ReportPath("html")),
        _report_option(
            "--markdown FILE.md",
            "Write a summary for a pull request: pictures that fail, the worst five, causes.",
            ReportPath("markdown"),
        ),
    ]

"""Rules like ``psnr<45`` and ``found:clipped``, by which pictures fail or get a warning.

A rule is a condition that bad pictures meet. A rule that better pictures meet, like ``psnr>45``, is
an error.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from defocus_core import gone
from defocus_core.compare.findings.table import FINDINGS
from defocus_core.compare.metrics import METRICS
from defocus_core.errors import Place, UsageProblem, did_you_mean
from defocus_core.request.quantities import QuantityError, read_at
from defocus_core.request.toml_file import Table, read_toml, refuse_unknown

OVER = 0.01  # default difference above which ``share`` counts a pixel
_RULE = re.compile(r"\s*([\w.-]+?)\s*(<=|>=|<|>)\s*([+-]?[\d.]+(?:e[+-]?\d+)?)\s*(%|dB)?\s*", re.I)
_COMPARISONS = {"low": (">", ">="), "high": ("<", "<=")}
_KEYS = ("fail", "warn", "over", "ignore-channels")


@dataclass(frozen=True)
class Rule:
    """A condition that a bad picture meets."""

    metric: str  # a name of `METRICS`; empty for a rule on findings
    sign: str  # <, <=, > or >=
    bound: float  # the number on the right
    text: str  # the text of the rule
    found: str = ""  # the name, or the first words of the name, of a finding; ``*`` for any

    def is_met(self, metrics: Mapping[str, float], findings: Collection[str]) -> bool | None:
        """Whether a picture is bad by its metrics and findings; None if it has no such metric."""
        if self.found:
            return any(self.found == "*" or f"{n} ".startswith(f"{self.found} ") for n in findings)
        if self.metric not in metrics:
            return None
        value = metrics[self.metric]
        if math.isnan(value):
            return True
        if value == self.bound:
            return len(self.sign) == 2
        return value < self.bound if self.sign[0] == "<" else value > self.bound


def rule(text: str) -> Rule:
    """The rule that a text describes."""
    word, colon, finding = text.strip().partition(":")
    if colon and word.lower() == "found":
        return _found(" ".join(finding.split()))
    match = _RULE.fullmatch(text)
    if match is None:
        remedy = "write like psnr<45, max>0.02 or found:clipped"
        raise QuantityError(f"'{text}' is not a rule", remedy)
    name, sign, number, unit = match.groups()
    name = name.lower()
    if name not in METRICS:
        remedy = did_you_mean(name, list(METRICS), f"metrics are {', '.join(METRICS)}")
        raise QuantityError(f"'{name}' is not a metric", gone.remedy("rule", name, "", remedy))
    try:
        bound = float(number) / (100 if unit == "%" else 1)
    except ValueError:
        raise QuantityError(f"'{number}' is not a number", "write like psnr<45") from None
    if math.isinf(bound):
        raise QuantityError(f"'{text:.40}' has a bound beyond all numbers", "write like psnr<45")
    signs = _COMPARISONS[METRICS[name].better]
    if sign not in signs:
        better = "higher" if signs[0] == "<" else "lower"
        problem = f"'{text}' is met by the better pictures: {better} {name} is better"
        raise QuantityError(problem, f"write {name}{signs[0]}{number}{unit or ''}")
    return Rule(name, sign, bound, f"{name}{sign}{number}{unit or ''}")


def _found(name: str) -> Rule:
    exact = {known.lower(): known for known in FINDINGS}.get(name.lower(), name)
    instead = gone.remedy("rule", f"found:{name.lower()}")
    if instead or not any(f"{exact} ".startswith(f"{known} ") for known in (*FINDINGS, "*")):
        remedy = did_you_mean(name, [*FINDINGS], f"findings are *, {', '.join(FINDINGS)}")
        raise QuantityError(f"'{name}' is not a finding", instead or remedy)
    return Rule("", "", 0.0, f"found:{exact}", exact)


@dataclass(frozen=True)
class Rules:
    """The rules for one picture."""

    fail: tuple[Rule, ...] = ()  # a picture that meets one of them is different
    warn: tuple[Rule, ...] = ()  # a picture that meets one of them is the same, with a warning
    over: float = OVER  # the difference above which the metric ``share`` counts a pixel
    visible_only: bool = False  # whether colours where A is 0 on both sides may differ
    to_a_step: bool = False  # whether values may differ by a step of their number type
    ignore_channels: tuple[str, ...] = ()  # patterns of channels that are not compared

    def compares(self, channel: str) -> bool:
        """Whether a channel is compared."""
        return not any(fnmatchcase(channel, pattern) for pattern in self.ignore_channels)

    @property
    def asked(self) -> set[str]:
        """The metrics that the rules use."""
        return {each.metric for each in (*self.fail, *self.warn) if each.metric}


# Default tolerance of goldens, as processors round differently.
ROUNDING = rule("max>1e-4")


def _rules(fail: Sequence[str], warn: Sequence[str], **flags: Any) -> Rules:
    return Rules(tuple(map(rule, fail)), tuple(map(rule, warn)), **flags)


# Presets of rules by the origin of B; passing differences are noted.
PRESETS = {
    "render": _rules(
        ["hdr-p99.9>0.015", "hdr-max>0.25", "found:clipped"],
        ["hdr-max>0.002", "rel-rmse>1e-3"],
        visible_only=True,
    ),
    "encoder": _rules(
        ["hdr-psnr<34", "hdr-p99.9>0.15", "block>0.002", "found:clipped"],
        ["hdr-psnr<45"],
        visible_only=True,
    ),
    "golden": _rules(["hdr-max>0.003", "found:clipped"], ["max>1e-3"], to_a_step=True),
}


def rules_like(like: str | None, bounds: Mapping[str, float]) -> Rules:
    """The rules of ``golden.check``: those of a preset, and the given bounds of metrics.

    Raises:
        ValueError: there is no such preset, or a bound is not a number.
        TypeError: there is no such metric.
    """
    if like is not None and like not in PRESETS:
        raise ValueError(f"like must be one of {', '.join(PRESETS)}, got {like}")
    rules = []
    for name, bound in bounds.items():
        metric = name.replace("p999", "p99.9").replace("_", "-")
        if metric not in METRICS:
            instead = gone.remedy("python", name, "golden.check", f"bounds: {', '.join(METRICS)}")
            raise TypeError(f"golden.check() takes no {name}; {instead}")
        if not math.isfinite(bound):
            raise ValueError(f"{name} must be a finite number, got {bound}")
        rules.append(rule(f"{metric}{_COMPARISONS[METRICS[metric].better][0]}{bound}"))
    if like is not None:
        return replace(PRESETS[like], fail=(*PRESETS[like].fail, *rules))
    return Rules(tuple(rules) or (ROUNDING,), to_a_step=not rules)


@dataclass(frozen=True)
class Thresholds:
    """The rules for all pictures, and for pictures whose names match a pattern."""

    general: Rules = Rules()  # the rules for all
    # patterns of names, with changes to the general rules; the last match wins
    overrides: Sequence[tuple[str, Mapping[str, Any]]] = ()
    # changes by the command line, which win over all
    flags: Mapping[str, Any] = field(default_factory=dict)

    def rules_of(self, name: str) -> Rules:
        """The rules for a picture."""
        rules = self.general
        for pattern, changes in self.overrides:
            if matches(name, pattern):
                rules = replace(rules, **changes)
        return replace(rules, **self.flags)

    def idle(self, names: Sequence[str]) -> list[str]:
        """The patterns that match no picture."""
        patterns = dict.fromkeys(pattern for pattern, _ in self.overrides)
        return [p for p in patterns if not any(matches(name, p) for name in names)]


def matches(name: str, pattern: str) -> bool:
    """Whether a pattern matches the relative path of a picture.

    A pattern without a slash may match the name alone. ``*`` stands for any characters, slashes
    included, and ``./`` at the beginning for the compared folder.
    """
    return fnmatchcase(name, pattern.removeprefix("./")) or (
        "/" not in pattern and fnmatchcase(Path(name).name, pattern)
    )


def read_thresholds(
    file: Path | None,  # a file like compare.toml, or None
    fail: Sequence[Rule] = (),
    warn: Sequence[Rule] = (),
    over: float | None = None,
    default: Rules = Rules(),
    ignore_channels: Sequence[str] = (),
) -> Thresholds:
    """The thresholds of a file and of the command line; `default` holds for what neither gives."""
    given: dict[str, Any] = {"fail": tuple(fail), "warn": tuple(warn), "over": over}
    given["ignore_channels"] = tuple(ignore_channels)
    flags = {key: value for key, value in given.items() if value not in ((), None)}
    if file is None:
        return Thresholds(default, flags=flags)
    remedy = "name a file with rules, like compare.toml"
    tables = read_toml(file, what="file of thresholds", remedy=remedy)
    refuse_unknown(tables, (*_KEYS, "override"), file, "a file of thresholds")
    overrides = tables.pop("override", [])
    if not isinstance(overrides, list) or not all(isinstance(each, dict) for each in overrides):
        problem, remedy = "is not a list of tables", "write [[override]] above files, fail and warn"
        raise UsageProblem("malformed", problem, remedy, path=file, field="override")
    read = []
    for number, values in enumerate(overrides, 1):
        table = Table(file, f"override {number}", values)
        table.refuse_unknown(("files", *_KEYS))
        if (pattern := table.text("files")) is None:
            place, remedy = table.place("files"), "write files = 'left/*'"
            raise UsageProblem("missing-option", "is missing", remedy, path=place)
        read.append((pattern, _changes(table)))
    return Thresholds(replace(default, **_changes(Table(file, "thresholds", tables))), read, flags)


def _changes(table: Table) -> dict[str, Any]:
    changes: dict[str, Any] = {}
    for key in ("fail", "warn"):
        if key in table.values:
            texts = _texts(table, key, "rules", "psnr<45")
            changes[key] = tuple(read_at(table.place(key), rule, text) for text in texts)
    if (key := "ignore-channels") in table.values:
        changes["ignore_channels"] = _texts(table, key, "names", "rand.*")
    if "over" in table.values:
        changes["over"] = difference(table.values["over"], table.place("over"))
    return changes


def _texts(table: Table, key: str, what: str, example: str) -> tuple[str, ...]:
    """The texts of a key, a list or a single one; `what` and `example` are words for errors."""
    texts = table.values[key]
    texts = [texts] if isinstance(texts, str) else texts
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        problem, remedy = f"{texts!r} is not a list of {what}", f"write {key} = ['{example}']"
        raise UsageProblem("malformed", problem, remedy, path=table.place(key))
    return tuple(texts)


def difference(value: object, where: Place) -> float:
    """A difference above which the metric ``share`` counts a pixel."""
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < math.inf:
        return float(value)
    raise UsageProblem(
        "malformed", f"{value!r} is not a difference of 0 or more", f"write {OVER}", path=where
    )

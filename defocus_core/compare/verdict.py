"""The verdict of a pair, by rules on its metrics and findings.

Without rules, B is the same if all values are equal over the display window; −0 equals 0, and NaN
equals NaN. With rules to fail, the rules decide about values. Another size, another set of
channels, and NaN or infinity on one side only are never the same.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from defocus_core.compare.findings.tone import may_be_cut_below
from defocus_core.compare.metrics import METRICS
from defocus_core.compare.pixels import Pixels
from defocus_core.compare.record import DIFFERENT, SAME, WARNING, Comparison
from defocus_core.compare.thresholds import ROUNDING, Rule, Rules

# Findings that are a warning if no rule fails.
_NEVER_SILENT = ("clipped", "deep samples", "other primaries declared")
_SMALL = 0.1  # scale of values, below which rounding is relative to it
_SEEN = 0.5 / 255  # half a step of 8 bits, on the hdr scale


def judge(record: Comparison, rules: Rules, *, differs: bool, strict: bool) -> Comparison:
    """The record with its verdict.

    `differs`: whether values differ; `strict`: whether B is different regardless of rules.
    """
    metrics, found = record.metrics, [finding.name for finding in record.findings]
    failed, warned = (_met(each, metrics, found) for each in (rules.fail, rules.warn))
    if not failed and not warned:
        warned = tuple(f"found:{name}" for name in found if name.startswith(_NEVER_SILENT))
    status = WARNING if warned else SAME
    if strict or failed or (differs and not _decide(rules, metrics)):
        status = DIFFERENT
    unmeasured = tuple(r.text for r in rules.fail if r.metric and r.metric not in metrics)
    return replace(record, status=status, failed=failed, warned=warned, unmeasured=unmeasured)


def _met(
    rules: Sequence[Rule], metrics: Mapping[str, float], found: Collection[str]
) -> tuple[str, ...]:
    return tuple(each.text for each in rules if each.is_met(metrics, found))


def _decide(rules: Rules, metrics: Mapping[str, float]) -> bool:
    """Whether rules to fail decide about values, since the pair has the metric of one of them."""
    return any(each.found or each.metric in metrics for each in rules.fail)


def overlooked(rules: Rules, pixels: Pixels) -> list[str]:
    """Channels other than colour, like A, that differ although all rules measure colour alone."""
    metrics = [METRICS[each.metric] for each in rules.fail if each.metric]
    if not metrics or not all(metric.color for metric in metrics):
        return []
    seen = {name for layer in pixels.color for name in layer}
    scales = {name: max(1.0, *map(abs, ends)) for name, ends in pixels.ranges[0].items()}
    largest = pixels.differences.largest
    return [n for n in pixels.names if n not in seen and largest[n] > ROUNDING.bound * scales[n]]


def asks_for_cause(rules: Rules, found: Collection[str], pixels: Pixels) -> bool:
    """Whether a rule on a finding needs a search for causes.

    `found`: names of the findings that are known without it.
    """
    return any(
        # Clipped light is always found.
        (each.found != "clipped" or may_be_cut_below(pixels)) and not each.is_met({}, found)
        for each in (*rules.fail, *rules.warn)
        if each.found
    )


def is_suspect(rules: Rules, metrics: Mapping[str, float], found: Collection[str]) -> bool:
    """Whether differing values make the pair fail, or give a warning and are visible in 8 bits."""
    if not _decide(rules, metrics) or _met(rules.fail, metrics, found):
        return True
    seen = not metrics.get("hdr-max", math.inf) < _SEEN
    return seen and bool(_met(rules.warn, metrics, found))


def of_small_values(rules: Rules, pixels: Pixels) -> Rules:
    """The rules, with the bound for rounding scaled to the values of A if all are small."""
    if ROUNDING not in rules.fail:
        return rules
    finite = (np.abs(plane[np.isfinite(plane)]) for plane in pixels.a)
    scales = [np.percentile(values, 99.9) for values in finite if values.size]
    scale = max(map(float, scales), default=0.0)
    if not 0 < scale < _SMALL:
        return rules
    bound = ROUNDING.bound * scale
    small = replace(ROUNDING, bound=bound, text=f"{ROUNDING.metric}>{bound:.2g}")
    return replace(rules, fail=tuple(small if each == ROUNDING else each for each in rules.fail))


def proposal(rules: Rules, metrics: Mapping[str, float]) -> str:
    """The tightest rule, with two digits, that lets a pair pass.

    It is empty if a black B would pass it, or if rules are given.
    """
    greatest, relative = metrics.get("max"), metrics.get("rel-rmse")
    given = any(each != ROUNDING for each in rules.fail)
    if given or not greatest or not relative or not math.isfinite(greatest):
        return ""
    digit = 10.0 ** (math.floor(math.log10(greatest)) - 1)
    bound = math.ceil(greatest / digit) * digit
    level = metrics["rmse"] / relative  # the mean of A
    return f"max>{bound:.3g}" if bound < level else ""

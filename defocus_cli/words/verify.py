"""The report of ``defocus verify``: a table for people, a record for scripts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from defocus_core.evaluation.law_checks import Check

_WORDS = {True: "ok", False: "FAILED"}


def lines(checks: Sequence[Check]) -> Iterator[str]:
    """A heading, a line for each check, and how many failed."""
    law, measured = (
        max(len(text) for text in column)
        for column in zip(("law", "measured"), *((c.law, c.measured) for c in checks), strict=True)
    )
    yield f"{'law':{law}}  {'measured':{measured}}  {'worst':>8}  {'bound':>8}  unit"
    for check in checks:
        worst, verdict = "-", "skipped: no GPU in use"
        if check.value is not None:
            worst, verdict = f"{check.value:.2g}", _WORDS[check.ok]
        numbers = f"{worst:>8}  {check.bound:>8.2g}  {check.unit:5}"
        yield f"{check.law:{law}}  {check.measured:{measured}}  {numbers}  {verdict}"


def summary(checks: Sequence[Check], seconds: float) -> str:
    """Number of checks that failed, in words."""
    measured = [check for check in checks if check.value is not None]
    failed = [check for check in measured if not check.ok]
    verdict = f"{len(failed)} of {len(measured)} FAILED" if failed else f"all {len(measured)} hold"
    return f"{verdict}, {seconds:.1f} s"


def record(check: Check) -> dict[str, Any]:
    """One check; a value that is no finite number is null, as is one that was not measured."""
    finite = check.value is not None and math.isfinite(check.value)
    return {
        "law": check.law,
        "measured": check.measured,
        "unit": check.unit,
        "value": check.value if finite else None,
        "bound": check.bound,
        "ok": check.ok,
        "skipped": check.value is None,
    }

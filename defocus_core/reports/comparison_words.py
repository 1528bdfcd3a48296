"""Reports of ``defocus compare``: lines, a summary, JSON, and JUnit XML for CI servers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from defocus_core.compare.metrics import METRICS
from defocus_core.compare.record import (
    DIFFERENT,
    EXTRA,
    MISSING,
    STATUSES,
    UNREADABLE,
    WARNING,
    Comparison,
    Worst,
)
from defocus_core.errors import printable
from defocus_core.io.write_files import require_replaceable, written_whole
from defocus_core.system.text import counted

_DIGITS = {"psnr": 4, "ssim": 5, "pixels": 9}
_SHOWN = ("max", "rmse", "psnr", "hdr-psnr", "ssim", "flip")
_COUNTED = (*STATUSES, "not compared")
_LISTS = ("failed", "warned", "unmeasured", "notes", "metadata")  # attributes of a record
_METADATA = 3  # attributes that a line shows at most
_LOCAL = 0.25  # share of a picture below which a difference is local
_TITLES = {"psnr": "PSNR", "hdr": "HDR", "ssim": "SSIM", "rmse": "RMSE", "flip": "FLIP"}


def line(record: Comparison) -> str:
    """The result of a pair, in one line."""
    word = record.status if record.passes else record.status.upper()
    if record.status in (MISSING, EXTRA, UNREADABLE):
        lacking = "B" if record.status == MISSING else "A"
        return f"{record.name}: {word}: {record.error or f'{lacking} has no such file'}"
    parts = [finding.text for finding in record.findings]
    if record.differing:
        parts += [place_words(record)] if _is_local(record) else []
        parts += [_numbers(record)] if record.metrics else []
        parts += [f"worst at {worst_words(record.worst)}"] if record.worst is not None else []
    if record.failed:
        parts.append(f"fails {', '.join(record.failed)}")
    if record.warned:
        parts.append(f"warned of by {', '.join(record.warned)}")
    if record.status == DIFFERENT and record.unmeasured:
        parts.append(f"has no {', '.join(record.unmeasured)}")
    if record.metadata:
        shown, more = record.metadata[:_METADATA], len(record.metadata) - _METADATA
        and_more = f"; and {more} more" if more > 0 else ""
        parts.append(f"metadata: {'; '.join(shown)}{and_more}")
    if record.notes:
        parts.append(f"noted: {'; '.join(record.notes)}")
    if record.proposal:
        parts.append(f"‹fail› '{record.proposal}' lets it pass")
    return f"{record.name}: {': '.join([word, ', '.join(parts)] if parts else [word])}"


def of_golden(golden: Path, name: str, records: Sequence[Comparison], *, proposes: bool) -> str:
    """How a picture differs from its golden, and how to accept it, in lines.

    `records`: those of the picture with each of its goldens, or none. `proposes`: whether to
    propose a bound by which it would pass.
    """
    if not records:
        return f"{golden}: there is no such golden; make it with pytest --golden-update"
    told = line(replace(records[0], name=name, proposal=""))
    if records[0].proposal and proposes:
        told += f"\n{records[0].proposal.replace('>', '=')} lets it pass"
    return f"{told}\n--golden-update makes it the golden {golden}"


def summary(records: Sequence[Comparison], pairs: int | None = None) -> str:
    """Counts of the pairs by status, and the number of pairs not compared."""
    counts = Counter(record.status for record in records)
    left = (pairs or len(records)) - len(records)
    counts["not compared"] = left
    said = ", ".join(f"{n} {status}" for status in _COUNTED if (n := counts[status]))
    return f"{counted(len(records) + left, 'pair')}: {said}"


def exit_code(records: Sequence[Comparison]) -> int:
    """The exit code: 0 if all pairs are the same, 3 if a file cannot be read, else 1."""
    if any(record.status == UNREADABLE for record in records):
        return 3
    return 0 if all(record.passes for record in records) else 1


def document(records: Sequence[Comparison], pairs: int | None = None) -> dict[str, Any]:
    """The JSON document of all pairs.

    `pairs`: number of all pairs, if some were not compared; `same` is false then.
    """
    numbers = Counter(record.status for record in records)
    left = (pairs or len(records)) - len(records)
    return {
        "same": not left and all(record.passes for record in records),
        "counts": {status: numbers[status] for status in STATUSES},
        "not_compared": left,
        "pairs": [pair_record(record) for record in records],
    }


def pair_record(record: Comparison) -> dict[str, Any]:
    """The JSON object of a pair; numbers that are not finite become the texts NaN, Inf and -Inf."""
    nonfinite = record.nonfinite
    return {
        "name": record.name,
        "a": None if record.a is None else str(record.a),
        "b": None if record.b is None else str(record.b),
        "status": record.status,
        "size": record.size and list(record.size),
        "encoding": record.encoding or None,
        "findings": [
            {name: getattr(finding, name) for name in ("name", "code", "text", "explained")}
            | _plain(finding.values)
            for finding in record.findings
        ],
        "metrics": _plain(record.metrics),
        "channels": _plain(record.channels),
        "differing_pixels": record.differing,
        "differing_window": record.window and list(record.window),
        "worst": record.worst
        and {
            **{"x": record.worst.x, "y": record.worst.y},
            **{side: _plain(getattr(record.worst, side)) for side in "ab"},
        },
        "nonfinite": nonfinite and {k: dict(v) for k, v in nonfinite.counts.items()},
        **{name: list(getattr(record, name)) for name in _LISTS},
        "proposal": record.proposal or None,
        "error": record.error or None,
        "images": [str(path) for path in record.images],
        "line": line(record),
    }


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    lacking = {"nan": "NaN", "inf": "Inf", "-inf": "-Inf"}  # in JSON
    return {k: lacking.get(str(v), v) if isinstance(v, float) else v for k, v in values.items()}


def _numbers(record: Comparison) -> str:
    """The metrics of a pair, for its line; of the finite pixels if some are not finite."""
    metrics = record.metrics
    words = ", ".join(number_words(name, metrics[name]) for name in _SHOWN if name in metrics)
    if record.nonfinite is None or not record.nonfinite.findings:
        return words
    return f"elsewhere {words}" if metrics["max"] else "elsewhere equal"


def number_words(name: str, value: float) -> str:
    """A metric in words, like ``PSNR 31.2 dB``."""
    digits = _DIGITS.get(name.rpartition("-")[2], 3)
    return f"{metric_title(name)} {value:.{digits}g} {METRICS[name].unit}".rstrip()


def metric_title(name: str) -> str:
    """The name of a metric for people, like ``HDR-PSNR``."""
    return "-".join(_TITLES.get(part, part) for part in name.split("-"))


def _is_local(record: Comparison) -> bool:
    """Whether the pixels that differ lie in a small part of the picture."""
    said = any(finding.name == "in one region" for finding in record.findings)
    if record.window is None or record.size is None or said:
        return False
    _, _, width, height = record.window
    return width * height < _LOCAL * record.size[0] * record.size[1]


def place_words(record: Comparison) -> str:
    """The number of the pixels that differ, and their rectangle; empty if unknown."""
    if record.window is None:
        return ""
    x, y, width, height = record.window
    return f"{counted(record.differing, 'pixel')} within {width}x{height} at {x},{y}"


def worst_words(worst: Worst) -> str:
    """The worst pixel: its place, and the values of its channels if they are few."""
    names = list(worst.a)
    old, new = (" ".join(f"{side[n]:.4g}" for n in names) for side in (worst.a, worst.b))
    return f"{worst.x},{worst.y} ({' '.join(names)}: {old} -> {new})"


def write_junit(path: Path, records: Sequence[Comparison], seconds: float) -> None:
    """Write JUnit XML: a failure for each pair that differs, an error for each unreadable one."""
    counts = Counter(record.status for record in records)
    failures = sum(not record.passes for record in records) - counts[UNREADABLE]
    numbers = {"tests": len(records), "failures": failures, "errors": counts[UNREADABLE]}
    totals = {**{key: str(value) for key, value in numbers.items()}, "time": f"{seconds:.3f}"}
    root = ElementTree.Element("testsuites", totals)
    suite = ElementTree.SubElement(root, "testsuite", {"name": "defocus compare", **totals})
    for record in records:
        name = Path(record.name)
        group = ".".join(("compare", *name.parts[:-1]))
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": printable(group), "name": printable(name.name)}
        )
        text = printable(line(record))
        if not record.passes:
            kind = "error" if record.status == UNREADABLE else "failure"
            attributes = {"type": record.status, "message": text}
            ElementTree.SubElement(case, kind, attributes).text = text
        elif record.status == WARNING:
            ElementTree.SubElement(case, "system-out").text = text
    ElementTree.indent(root)
    require_replaceable(path, "junit")
    with written_whole(path) as file:
        ElementTree.ElementTree(root).write(file, "utf-8", xml_declaration=True)

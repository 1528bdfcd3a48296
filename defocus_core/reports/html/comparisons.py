"""The HTML report of comparisons: an item for each pair, the worst failure first."""

from __future__ import annotations

import math
import os
import pickle
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from glob import escape
from itertools import count
from pathlib import Path
from typing import Any

from defocus_core.compare.accepting import accept_picture
from defocus_core.compare.metrics import METRICS
from defocus_core.compare.record import (
    DIFFERENT,
    EXTRA,
    STATUSES,
    UNREADABLE,
    WARNING,
    CompareSettings,
    Comparison,
)
from defocus_core.reports.comparison_words import (
    line,
    metric_title,
    number_words,
    place_words,
    worst_words,
)
from defocus_core.reports.html.item import Item, Layer
from defocus_core.reports.html.layers import WHOLE, draw_pair
from defocus_core.reports.html.page import ROOM, THUMBNAILS, write_report
from defocus_core.system.process import spread
from defocus_core.system.text import command_line, counted

Commands = Callable[[Comparison], Sequence[tuple[str, str]]]
Ticked = Callable[[Comparison], str]
_COLUMNS = ("psnr", "ssim", "max", "flip")
_VALUES = 3  # characters of a pixel: those of integers, which compress better than halves
_numbers = count()


@dataclass(frozen=True)
class ReportHeader:
    """The heading of a report, and the commands that it shows."""

    title: str  # heading of the report
    words: Sequence[str]  # lines on what was compared
    commands: Commands = lambda _: ()  # the command lines of a pair, each with a title
    b: str = ""  # name of B, if its files are temporary; else empty
    accept: str = ""  # beginning of the command that accepts the ticked pairs
    ticked: Ticked = lambda record: command_line(["--only", f"./{escape(record.name)}"])


def write(path: Path, header: ReportHeader, records: Sequence[Comparison], processes: int) -> None:
    """Write the HTML report of comparisons, the worst failure first."""
    ranked = sorted(records, key=rank)
    drawings = spread(_drawn, list(_wanted(ranked)), processes, "the report")
    items = [_item(one, *drawing, header) for one, drawing in zip(ranked, drawings, strict=True)]
    there = {name for item in items for name in item.metrics}
    columns = [
        {"name": name, "title": metric_title(name), "metric": METRICS[name]}
        for name in _COLUMNS
        if name in there
    ]
    title, words, accept = header.title, header.words, header.accept
    write_report(path, items, columns, title=title, words=words, accept=accept)


def rank(record: Comparison) -> tuple[int, int, float]:
    """The key to sort pairs: failures first, of these NaN and Inf first, then by error."""
    order = {status: -place for place, status in enumerate(STATUSES)} | {DIFFERENT: -len(STATUSES)}
    apart = record.nonfinite is not None and record.nonfinite.apart is not None
    error = record.metrics.get("rel-rmse", record.metrics.get("max", 0.0))
    return order[record.status], -int(apart), -error if math.isfinite(error) else -math.inf


def _wanted(ranked: Sequence[Comparison]) -> Iterable[tuple[Comparison, bool]]:
    """Each pair, and whether the report holds its pixel values: if it fails, and there is room."""
    room = ROOM - min(ROOM // 2, len(ranked) * THUMBNAILS)
    for record in ranked:
        is_valued = room > 0 and (not record.passes or record.status == WARNING)
        room -= is_valued * min(math.prod(record.size or (0, 0)), WHOLE) * _VALUES
        yield record, is_valued


def _drawn(wanted: tuple[Comparison, bool]) -> tuple[Sequence[Layer], float]:
    record, values = wanted
    return draw_pair(record, values=values)


def _item(record: Comparison, layers: Sequence[Layer], full: float, header: ReportHeader) -> Item:
    finding_words = ", ".join(finding.text for finding in record.findings)
    return Item(
        name=record.name,
        status=record.status,
        passes=record.passes,
        words=finding_words or line(record).removeprefix(f"{record.name}: ").partition(": ")[2],
        facts=list(_facts(record, header.b)),
        metrics=record.metrics,
        commands=header.commands(record),
        ticked=header.ticked(record) if header.accept and record.acceptable else "",
        layers=layers,
        full=full,
        place=None if record.worst is None else (record.worst.x, record.worst.y),
    )


def _facts(record: Comparison, b: str) -> Iterable[tuple[str, str]]:
    """The facts on a pair, as terms and texts; facts without a text are left out.

    `b`: the text for B; empty for its path.
    """
    metrics = ", ".join(number_words(name, value) for name, value in record.metrics.items())
    rows = [
        ("What happened", "; ".join(finding.text for finding in record.findings)),
        ("Cannot be read" if record.status == UNREADABLE else "No pair", record.error),
        ("Worst pixel", "" if record.worst is None else worst_words(record.worst)),
        ("Where", place_words(record)),
        ("Fails", ", ".join(record.failed)),
        ("Warned of by", ", ".join(record.warned)),
        ("Has no", ", ".join(record.unmeasured) if not record.passes else ""),
        ("Would pass with", f"--fail '{record.proposal}'" if record.proposal else ""),
        ("Metrics", metrics),
        ("Metadata", "; ".join(record.metadata)),
        ("Noted", "; ".join(record.notes)),
        ("A", str(record.a or "no such file")),
        ("B", b or str(record.b or "no such file")),
    ]
    return ((term, text) for term, text in rows if text)


def setting_lines(settings: CompareSettings) -> list[str]:
    """Lines that tell which parts of the pictures were compared; empty if all were."""
    chosen = {
        "region": settings.region,
        "where this is not 0": settings.mask,
        "all but": " and ".join(map(str, settings.ignore_region)) or None,
        "where this is 0": settings.ignore_mask,
        "tolerant of": "anti-aliased edges" if settings.tolerate_edges else None,
    }
    return [f"Compared: {words} {value}" for words, value in chosen.items() if value is not None]


def keep_check(
    folder: Path, records: Sequence[Comparison], golden: Path, test: str, picture: Any
) -> None:
    """Store a failed picture in a folder for `write_checks`.

    `records`: its comparisons with its goldens; empty without a golden.
    """
    record = records[0] if records else Comparison("", None, None, EXTRA)
    stem = folder / f"{os.getpid()}-{next(_numbers)}"
    suffix = Path(picture).suffix if isinstance(picture, str | Path) else ".exr"
    kept = replace(record, name=os.path.relpath(golden), b=stem.with_suffix(suffix))
    accept_picture(folder, stem.with_suffix(suffix), picture)
    stem.with_suffix(".pickle").write_bytes(pickle.dumps((kept, test)))


def write_checks(folder: Path, path: Path) -> None:
    """Write the HTML report of the failed pictures that `keep_check` has stored in a folder."""
    kept = [pickle.loads(file.read_bytes()) for file in sorted(folder.glob("*.pickle"))]
    tests: dict[str, str] = {record.name: test for record, test in kept}

    def ticked(record: Comparison) -> str:
        return command_line([tests[record.name]])

    def commands(record: Comparison) -> list[tuple[str, str]]:
        again = ["pytest", tests[record.name]]
        accept = ("Accept as the golden", command_line([*again, "--golden-update"]))
        return [("Test again", command_line(again)), accept]

    title, b = "Goldens of a run of pytest", "the picture of the test"
    words = [f"{counted(len(kept), 'golden')} failed"]
    header = ReportHeader(title, words, commands, b, "pytest --golden-update", ticked)
    write(path, header, [record for record, _ in kept], processes=1)

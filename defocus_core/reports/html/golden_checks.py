"""Checks of goldens in a run of pytest, kept in a folder until the run ends and its report is due.

The processes of pytest-xdist share the folder.
"""

from __future__ import annotations

import os
import pickle
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

from defocus_core.compare.record import CompareSettings, Comparison
from defocus_core.io.exr.writing import write_exr
from defocus_core.reports.html import comparisons
from defocus_core.reports.html.comparisons import ReportHeader
from defocus_core.system.text import command_line, counted

_numbers = count()


@dataclass(frozen=True)
class Kept:
    """A check: its record, and the name that pytest has for its test."""

    record: Comparison
    test: str


def keep(folder: Path, record: Comparison, test: str, picture: Path | Mapping[str, Any]) -> None:
    """Keep a check, with the picture of the test if it fails."""
    stem = folder / f"{os.getpid()}-{next(_numbers)}"
    if record.passes:
        record = replace(record, b=record.a)
    elif isinstance(picture, Path):
        record = replace(record, b=stem.with_suffix(picture.suffix))
        shutil.copyfile(picture, stem.with_suffix(picture.suffix))
    else:
        record = replace(record, b=stem.with_suffix(".exr"))
        write_exr(stem.with_suffix(".exr"), picture, {})
    stem.with_suffix(".pickle").write_bytes(pickle.dumps(Kept(record, test)))


def write(folder: Path, path: Path) -> int:
    """Write the report of the checks in a folder, if there are any; their number."""
    kept: Sequence[Kept] = [
        pickle.loads(file.read_bytes()) for file in sorted(folder.glob("*.pickle"))
    ]
    if not kept:
        return 0
    tests = {id(each.record): each.test for each in kept}

    def commands(record: Comparison) -> list[tuple[str, str]]:
        words = ["pytest", tests[id(record)]]
        again = [("Test again", command_line(words))]
        if record.passes:
            return again
        return [*again, ("Accept as the golden", command_line([*words, "--golden-update"]))]

    failed = [each.record for each in kept if not each.record.passes]
    words = [f"{counted(len(kept), 'check')} of goldens, {len(failed)} failed"]
    header = ReportHeader(
        "Goldens of a run of pytest", words, commands, b="the picture of the test"
    )
    comparisons.write(path, header, [each.record for each in kept], CompareSettings(), processes=1)
    return len(kept)

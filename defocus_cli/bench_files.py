"""The files a benchmark writes: asked about before the work, written whole after it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_cli import bench_plot
from defocus_cli.bench_table import csv_text, means, record, regressions
from defocus_cli.errors import InputError
from defocus_cli.files import written_whole
from defocus_cli.report import version

if TYPE_CHECKING:
    from defocus_cli.bench_run import Row


@dataclass(frozen=True)
class Files:
    """Where to write which kind; None for what is not wanted."""

    json: Path | None = None
    csv: Path | None = None
    plot: Path | None = None

    def refuse_unwritable(self) -> None:
        """Refuse what could not be written after all the work.

        Raises:
            InputError: a path is a directory, or lies where nothing can be written.
            UsageProblem: there can be no plot.
        """
        if self.plot is not None:
            bench_plot.refuse_unplottable(self.plot)
        for path in filter(None, (self.json, self.csv, self.plot)):
            if path.is_dir():
                raise InputError(path, "is a directory where a file is to be written", "name one")
            folder = next(parent for parent in path.absolute().parents if parent.exists())
            if not (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)):
                raise InputError(path, "cannot be written", "name a file elsewhere")

    def write(self, rows: Sequence[Row], settings: dict[str, Any]) -> None:
        """Write what is wanted of errors and times.

        Raises:
            InputError: a file cannot be written.
        """
        document = {**settings, "rows": [record(row) for row in rows]}
        document |= {"means": means(rows), "regressions": regressions(rows)}
        self.write_tables(document, lambda: csv_text(rows))
        if self.plot is not None:
            bench_plot.draw(self.plot, rows)

    def write_tables(self, document: dict[str, Any], csv: Callable[[], str]) -> None:
        """Write the document as JSON, and rows as CSV, where they are wanted.

        Raises:
            InputError: a file cannot be written.
        """
        if self.json is not None:
            text = json.dumps({"defocus": version(), **document}, indent=1, allow_nan=False)
            _write(self.json, text + "\n")
        if self.csv is not None:
            _write(self.csv, csv())


def _write(path: Path, text: str) -> None:
    with written_whole(path) as file:
        file.write(text.encode())

"""The files a benchmark writes: asked about before the work, written whole after it.

What is for people goes to stdout, or to stderr if the JSON document is there.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

from defocus_cli import bench_plot
from defocus_cli.bench_table import csv_text, means, record, regressions
from defocus_cli.errors import InputError, reason
from defocus_cli.files import written_whole
from defocus_cli.report import print_json, say, tell, version

if TYPE_CHECKING:
    from defocus_cli.bench_run import Row

STDOUT = Path("-")


@dataclass(frozen=True)
class Files:
    """Where to write which kind; None for what is not wanted. JSON may go to `STDOUT`."""

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
            if path != STDOUT:
                _try_folder(path)

    def echo(self, line: str) -> None:
        """Say a line to people."""
        (say if self.json == STDOUT else tell)(line)

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
        if self.json == STDOUT:
            print_json(**document)
        elif self.json is not None:
            text = json.dumps({"defocus": version(), **document}, indent=1, allow_nan=False)
            _write(self.json, text + "\n")
        if self.csv is not None:
            _write(self.csv, csv())


def _try_folder(path: Path) -> None:
    """Refuse a file in whose folder, or where that is to be made, no file can be made."""
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    try:
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        problem = f"cannot be written: {folder}: {reason(error)}"
        raise InputError(path, problem, "name a file elsewhere") from None


def _write(path: Path, text: str) -> None:
    with written_whole(path) as file:
        file.write(text.encode())

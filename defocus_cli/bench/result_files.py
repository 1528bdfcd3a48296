"""Files that a benchmark writes: checked before the work, written whole after it.

What is for people goes to stdout, or to stderr if the JSON document is there.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from defocus_cli.bench import error_plot
from defocus_cli.system.console import print_json, say, tell, version
from defocus_cli.system.errors import InputError, reason
from defocus_cli.system.safe_files import written_whole

STDOUT = Path("-")


@dataclass(frozen=True)
class Files:
    """Where to write which kind; None for what is not wanted. JSON may go to `STDOUT`."""

    json: Path | None = None
    plot: Path | None = None

    def refuse_unwritable(self) -> None:
        """Refuse what could not be written after all the work.

        Raises:
            InputError: a path is a directory, or lies where nothing can be written.
            UsageProblem: there can be no plot.
        """
        if self.plot is not None:
            error_plot.refuse_unplottable(self.plot)
        for path in filter(None, (self.json, self.plot)):
            if path.is_dir():
                raise InputError(path, "is a directory where a file is to be written", "name one")
            if path != STDOUT:
                _try_folder(path)

    def echo(self, line: str) -> None:
        """Say a line to people."""
        (say if self.json == STDOUT else tell)(line)

    def write_json(self, document: dict[str, Any]) -> None:
        """Write the document if it is wanted.

        Raises:
            InputError: a file cannot be written.
        """
        if self.json == STDOUT:
            print_json(**document)
        elif self.json is not None:
            text = json.dumps({"defocus": version(), **document}, indent=1, allow_nan=False)
            with written_whole(self.json) as file:
                file.write(f"{text}\n".encode())


def _try_folder(path: Path) -> None:
    """Refuse a file in whose folder, or where that is to be made, no file can be made."""
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    try:
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        problem = f"cannot be written: {folder}: {reason(error)}"
        raise InputError(path, problem, "name a file elsewhere") from None


@contextmanager
def progress(
    total: int, echo: Callable[[str], object]
) -> Iterator[tuple[Callable[[], object], Callable[[str], object]]]:
    """What to call after each rendering, and what says a line above the bar, if a terminal sees."""
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda: None, echo
        return
    from tqdm import tqdm

    with tqdm(total=total, unit="rendering", file=sys.stderr, leave=False) as bar:

        def tell(line: str) -> None:
            with tqdm.external_write_mode(file=sys.stdout):
                echo(line)

        yield bar.update, tell

"""Files of earlier pictures that a job replaces only in part, and that are removed with them.

A preview goes with the picture that it shows. A map or picture of another kind stays, as somebody
may have asked for it by itself; if it was made otherwise than what is beside it now, people are
told. A file is removed only if the journal has it and it is as it was written.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from defocus_cli.dataset.sample_index import taken_alike
from defocus_cli.formats.kinds import PREVIEW
from defocus_cli.journal import identity
from defocus_cli.journal.journal import Record
from defocus_cli.system.console import counted


class Remains:
    """What remains in OUT beside what a run writes."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.removed = 0
        self.others = 0
        self.first: Path | None = None

    def beside(self, record: Record, earlier: Iterable[Record]) -> None:
        """Remove previews of what a job has replaced, and count what else is of earlier settings.

        Args:
            record: of the job, which is done.
            earlier: records of what was made whose files it has replaced in part.
        """
        written = {told["path"] for told in record["outputs"].values()}
        for before in earlier:
            remain = {
                name: self.out / told["path"]
                for name, told in before["outputs"].items()
                if told["path"] not in written and identity.unchanged(self.out / told["path"], told)
            }
            for name, path in remain.items():
                if name.endswith(PREVIEW):
                    self._drop(path, name.removesuffix(PREVIEW), before["outputs"], record)
                elif not taken_alike(before, record):
                    self.others += 1
                    self.first = self.first or path

    def lines(self) -> Iterator[str]:
        """The same in words."""
        if self.removed:
            yield f"removed {counted(self.removed, 'preview')} of pictures that were replaced"
        if self.others:
            more = f" and {self.others - 1} more" if self.others > 1 else ""
            problem = "not replaced, of other settings, inputs or version than what is beside it"
            yield f"{self.first}{more}: warning: {problem}"

    def _drop(self, path: Path, kind: str, shown: Mapping[str, Any], record: Record) -> None:
        """Remove a preview if the picture that it shows is another by now."""
        before, now = shown.get(kind), record["outputs"].get(kind)
        if before is None or now is None or before["path"] != now["path"]:
            return
        if before.get("blake2b") != now.get("blake2b"):
            path.unlink(missing_ok=True)
            self.removed += 1

"""Files of B that differ, made the new files of A."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from defocus_core.compare.picture import read_picture
from defocus_core.compare.record import DIFFERENT, EXTRA, Comparison
from defocus_core.errors import InputError, reason
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import left_in, written_together, written_whole


def accept_files(a: Path, b: Path, records: Sequence[Comparison]) -> list[Path]:
    """Copy the files of B that differ from A, or that A has not, to A; their new paths.

    All appear together, or none. What B lacks stays, and what cannot be read is not accepted.
    """
    pairs = []
    for record in records:
        if record.status in (DIFFERENT, EXTRA) and record.b is not None:
            if record.status == EXTRA:  # a link may lead to anything
                read_picture(record.b)
            target = record.a or a / record.b.relative_to(b)
            # A batch may have it in another format: A gets the file of B, under the name of B.
            pairs.append((record.b, target.with_suffix(record.b.suffix)))
    with written_together(a if a.is_dir() else None):
        for source, target in pairs:
            try:
                with source.open("rb") as old, written_whole(target) as new:
                    shutil.copyfileobj(old, new)
            except OSError as error:
                problem = f"cannot be read: {reason(error)}"
                raise InputError(
                    "unreadable", problem, "check its permissions", path=source
                ) from None
    for folder in {target.parent for _, target in pairs}:
        for name in left_in(folder):
            Folder(folder).remove(name)
    return [target for _, target in pairs]

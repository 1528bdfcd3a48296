"""The copy of a journal beside it, by which it is mended when a power loss has cut it.

At the end of a run ``OUT/.journal.copy`` is as long as the journal; a journal that is the beginning
of its copy gets the rest back before the next run. Whether files are as their records say, `ledger`
looks, as always. A run that did not get to its end knows its files by its plan, see `run_file`.
"""

from __future__ import annotations

import os
from pathlib import Path

from defocus_core.batch.journal.journal import Shard, journal_path, read
from defocus_core.errors import InputError
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import unwritable, written_whole
from defocus_core.system.text import counted, note


def copy_path(out: Path, shard: Shard | None = None) -> Path:
    """The copy of the journal of OUT, or of a shard."""
    return out / f".{journal_path(out, shard).stem}.copy"


def mend(out: Path, shard: Shard | None = None) -> None:
    """Put back the records that a journal lost at its end; a line says it.

    The lock of the journal must be held.
    """
    path = journal_path(out, shard)
    if not path.exists():  # removed by someone who wants to begin anew
        return
    data, copied = (_read(each) for each in (path, copy_path(out, shard)))
    whole = data[: data.rfind(b"\n") + 1]
    if whole == copied or not copied.startswith(whole):
        return
    try:
        read(copy_path(out, shard))
    except InputError:  # the copy is damaged, too
        return
    with written_whole(path) as file:
        file.write(copied)
    lost = copied.count(b"\n") - whole.count(b"\n")
    note(f"{path}: had lost {counted(lost, 'record')}, put back from its copy")


def follow(out: Path, shard: Shard | None = None) -> None:
    """Make the copy of a journal as long as the journal."""
    path = copy_path(out, shard)
    data, copied = _read(journal_path(out, shard)), _read(path)
    if data == copied:
        return
    if not copied or not data.startswith(copied):  # a link is replaced, not followed
        with written_whole(path, out) as file:
            file.write(data)
        return
    try:
        number = Folder(out).append(path.name)
        try:
            os.write(number, data[len(copied) :])
            os.fdatasync(number)
        finally:
            os.close(number)
    except OSError as error:
        raise unwritable(path, error) from error


def _read(path: Path) -> bytes:
    """The bytes of a file; none if it is missing, or if none may be read."""
    try:
        return Folder(path.parent).read(path.name)
    except OSError:
        return b""

"""The plan of a run in progress, ``OUT/.journal.run``, kept until the run is done.

Its first line says how many jobs there are; each further line names files that a job is about to
write. A process that is killed between writing them and saying so in the journal leaves them here:
they are ours, though no journal knows them.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from glob import escape
from pathlib import Path
from typing import Any

from defocus_cli.formats.kinds import KINDS
from defocus_cli.journal.journal import Shard, journal_path, read
from defocus_cli.system.safe_files import leftover, unwritable, written_whole

_LEFTOVER = re.compile(r"\..+\.\d+(\.\d+\.tmp|\.before)")


def run_path(out: Path, shard: Shard | None = None) -> Path:
    """The file of a run on OUT, or on a shard."""
    return out / (f".journal-{shard.number}of{shard.of}.run" if shard else ".journal.run")


def plans(out: Path) -> list[dict[str, Any]]:
    """What the runs on OUT set out to do that are at it or did not get to their end."""
    return [plan for path in sorted(out.glob(".journal*.run")) for plan in _lines(path)[:1]]


def plan_of(out: Path, shard: Shard | None) -> dict[str, Any] | None:
    """What the run on OUT, or on a shard, set out to do; None if it got to its end."""
    return next(iter(_lines(run_path(out, shard))), None)


def begun(out: Path, shard: Shard | None = None) -> set[str]:
    """Files that a run was about to write, relative to OUT, and that no journal may know.

    Args:
        out: the directory.
        shard: only what runs on this shard were about to write.
    """
    paths = out.glob(".journal*.run") if shard is None else [run_path(out, shard)]
    return {name for path in paths for line in _lines(path)[1:] for name in line.get("files", ())}


class Undertaking:
    """The run of this process.

    Args:
        path: of the file.
        plan: what it sets out to do.
        before: files that earlier runs left and that no journal knows.
        others: jobs of an earlier run among those left, which this one leaves to another.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(
        self, path: Path, plan: Mapping[str, Any], before: Iterable[str], *, others: int = 0
    ) -> None:
        self.path, self.plan, self.before, self.others = path, plan, set(before), others
        self._write()
        try:
            self._number = os.open(path, os.O_WRONLY | os.O_APPEND)
        except OSError as error:
            raise unwritable(path, error) from error

    def begin(self, files: Iterable[str]) -> None:
        """Say that these files are about to be written.

        Raises:
            InputError: it cannot be said, so they must not be.
        """
        try:
            os.write(self._number, _line({"files": list(files)}))
            os.fdatasync(self._number)
        except OSError as error:
            raise unwritable(self.path, error) from error

    def known(self, files: Iterable[str]) -> None:
        """The journal knows these files from now on."""
        self.before.difference_update(files)

    def end(self, *, done: bool, settled: bool = False) -> None:
        """Forget what there is no need to remember.

        Args:
            done: nothing is left to do.
            settled: the journal knows of all that was begun.
        """
        with suppress(OSError):
            os.close(self._number)
            if done and not self.before and not self.others:
                self.path.unlink()
            elif done or settled:
                if done and not self.others:
                    self.plan = {**self.plan, "left": 0}
                self._write()

    def _write(self) -> None:
        with written_whole(self.path) as file:
            file.write(_line(self.plan))
            if self.before:
                file.write(_line({"files": sorted(self.before)}))


def take_over(out: Path) -> None:
    """Forget the runs on shards, now that one on all of OUT has noted what they left."""
    for path in out.glob(".journal-*.run"):
        path.unlink(missing_ok=True)


def left(out: Path, shard: Shard | None = None) -> int:
    """How many jobs are left of a run that did not get to its end; 0 if it did.

    Raises:
        InputError: the journal cannot be read.
    """
    plan = plan_of(out, shard)
    if plan is None:
        return 0
    records = read(journal_path(out, shard))
    done = [record for record in records if record["finished"] >= plan["begun"]]
    return max(int(plan["left"]) - len(done), 0)


def count_down(out: Path, shard: Shard, left: int) -> None:
    """Say how many jobs are left of a run on a shard, whose records are elsewhere from now on.

    Raises:
        InputError: the file cannot be written.
    """
    path = run_path(out, shard)
    plan, *begun = _lines(path)
    with written_whole(path) as file:
        for line in ({**plan, "left": left}, *begun):
            file.write(_line(line))


def sweep_up(out: Path) -> None:
    """Remove what processes left half-written that were killed. Nobody else may write to OUT."""
    for folder in (out, *(out / kind for kind in KINDS)):
        with suppress(OSError):
            for entry in os.scandir(folder):
                if _LEFTOVER.fullmatch(entry.name):
                    Path(entry.path).unlink(missing_ok=True)


def sweep_up_after(process: int, files: Iterable[Path]) -> None:
    """Remove what a process that is dead left half-written of these files."""
    for path in files:
        for left in path.parent.glob(f"{escape(leftover(path, process))}*"):
            if _LEFTOVER.fullmatch(left.name):
                left.unlink(missing_ok=True)


def _line(value: Mapping[str, Any]) -> bytes:
    return json.dumps(value).encode() + b"\n"


def _lines(path: Path) -> list[dict[str, Any]]:
    """The lines of a file, less one that is torn."""
    found = []
    with suppress(OSError):
        for line in path.read_bytes().split(b"\n"):
            with suppress(ValueError):
                found.append(json.loads(line))
    return found

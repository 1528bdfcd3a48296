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
from defocus_cli.journal.record_check import Types, is_moment, wrong_type
from defocus_cli.system.errors import InputError
from defocus_cli.system.safe_files import leftover, unwritable, written_whole

_PLAN: Types = {"begun": (str,), "left": (int,), "again": (int,)}
_LEFTOVER = re.compile(r"\..+\.(\d+)\.\d+\.tmp")
SHARDS_FOLDER = "shards"  # of tars


def run_path(out: Path, shard: Shard | None = None) -> Path:
    """The file of a run on OUT, or on a shard."""
    return out / (f".journal-{shard.number}of{shard.of}.run" if shard else ".journal.run")


def plan_of(out: Path, shard: Shard | None) -> dict[str, Any] | None:
    """The plan of the run on OUT, or on a shard; None if it got to its end."""
    return next(iter(_lines(run_path(out, shard))), None)


def begun(out: Path, shard: Shard | None = None) -> set[str]:
    """Files that a run was about to write, relative to OUT, and that no journal may know.

    Args:
        out: the directory.
        shard: only what runs on this shard were about to write.
    """
    paths = out.glob(".journal*.run") if shard is None else [run_path(out, shard)]
    return {name for path in paths for line in _lines(path)[1:] for name in line["files"]}


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
        """Remove the file, or write it anew without what the journal has by now.

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
    """Remove the half-written files of processes that were killed; the lock of OUT must be held.

    The index and shards are written without the lock: those of a process that runs are left alone.
    """
    for folder in (out, out / SHARDS_FOLDER, *(out / kind for kind in KINDS)):
        with suppress(OSError):
            for entry in os.scandir(folder):
                name = _LEFTOVER.fullmatch(entry.name)
                if name and (folder.name in KINDS or not _runs(int(name[1]))):
                    Path(entry.path).unlink(missing_ok=True)


def _runs(process: int) -> bool:
    """Whether another process of this number runs on this machine."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # it is another user's
        return True
    return process not in (0, os.getpid())


def sweep_up_after(process: int, files: Iterable[Path]) -> None:
    """Remove the half-written siblings of files that a dead process left."""
    for path in files:
        for left in path.parent.glob(f"{escape(leftover(path, process))}*"):
            if _LEFTOVER.fullmatch(left.name):
                left.unlink(missing_ok=True)


def _line(value: Mapping[str, Any]) -> bytes:
    return json.dumps(value).encode() + b"\n"


def _lines(path: Path) -> list[dict[str, Any]]:
    """The lines of a file: the plan, then the files begun. A torn last line is left out.

    Raises:
        InputError: a line is something else.
    """
    try:
        lines = path.read_bytes().split(b"\n")
    except OSError:
        return []
    while lines and not lines[-1]:
        lines.pop()
    values: list[dict[str, Any]] = []
    for number, line in enumerate(lines, 1):
        try:
            value = json.loads(line)
        except (ValueError, RecursionError):
            if number == len(lines):
                break
            value = None
        fault = _fault_of(value, is_plan=number == 1)
        if fault:
            remedy = "remove the file, and what the run left half-written; the next run plans anew"
            raise InputError(path, f"line {number} {fault}", remedy)
        values.append(value)
    return values


def _fault_of(value: object, *, is_plan: bool) -> str | None:
    """What is wrong with a line, as ``has no left``; None if nothing is."""
    if not isinstance(value, dict):
        return "is broken"
    if is_plan:
        fault = wrong_type({"again": 0, **value}, _PLAN)
        if fault is None and not is_moment(value["begun"]):
            return f"begun at {value['begun']!r}, which is no time with a zone"
        return fault
    fault = wrong_type(value, {"files": (list,)})
    if fault is None and not all(isinstance(name, str) for name in value["files"]):
        return "has files that are no text"
    return fault

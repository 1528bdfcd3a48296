"""The plan of a run in progress, ``OUT/.journal.run``, and the end of runs on shards: the merge.

A plan is kept until its run is done, and names all its jobs, so that others know what is left.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

from defocus_core.batch.journal.journal import (
    Record,
    Shard,
    journal_path,
    merged,
    read_all,
    require_journal,
    shards,
)
from defocus_core.batch.journal.lock import locked
from defocus_core.batch.journal.records import is_moment
from defocus_core.batch.journal.resume import Ledger
from defocus_core.errors import InputError, cannot_read
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import LEFTOVER, left_in, sync_folder, written_whole
from defocus_core.request.output_kinds import KINDS
from defocus_core.system.text import note

SHARDS_FOLDER = "shards"  # of tars


@dataclass(frozen=True)
class RunPlan:
    """The jobs of a run."""

    begun: str  # when it began, UTC
    jobs: Sequence[str]  # the names of their samples

    def left(self, records: Iterable[Record]) -> list[str]:
        """The jobs that did not end since the run began, by the records of the journals."""
        ended = {each["sample_id"] for each in records if each["finished"] >= self.begun}
        return [name for name in self.jobs if name not in ended]

    def write(self, path: Path) -> None:
        """Write the file of the run."""
        with written_whole(path) as file:
            file.write(json.dumps(asdict(self)).encode() + b"\n")


def run_path(out: Path, shard: Shard | None = None) -> Path:
    """The file of a run on OUT, or on a shard."""
    return out / (f".journal-{shard.number}of{shard.of}.run" if shard else ".journal.run")


def plan_of(out: Path, shard: Shard | None = None) -> RunPlan | None:
    """The plan of the run on OUT, or on a shard; None if it got to its end."""
    return _read(run_path(out, shard))


def forget_shards(out: Path) -> None:
    """Forget the runs on shards, now that one on all of OUT has noted what they left."""
    for path in out.glob(".journal-*.run"):
        path.unlink(missing_ok=True)


def sweep_up(out: Path) -> None:
    """Remove the half-written files of processes that were killed; the lock of OUT must be held.

    The index and shards are written without the lock: those of a process that runs are left alone.
    """
    below = Folder(out)
    for folder in ("", SHARDS_FOLDER):
        for name in left_in(out / folder):
            with suppress(OSError):
                below.remove(f"{folder}/{name}" if folder else name)
    for folder in KINDS:
        with suppress(OSError):
            for name in below.names(folder):
                if LEFTOVER.fullmatch(name):
                    below.remove(f"{folder}/{name}")


def _read(path: Path) -> RunPlan | None:
    try:
        text = Folder(path.parent).read(path.name)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise cannot_read(path, error, "remove it") from None
    try:
        stored = json.loads(text)
        plan = RunPlan(stored["begun"], stored["jobs"])
        is_plan = is_moment(plan.begun) and all(isinstance(name, str) for name in plan.jobs)
    except (ValueError, TypeError, KeyError, RecursionError):
        is_plan = False
    if not is_plan:
        remedy = "remove the file, and what the run left half-written; the next run plans anew"
        raise InputError("malformed", "is no plan of a run", remedy, path=path)
    return plan


class Merged(NamedTuple):
    """A merge: its live jobs, its journals of shards, and the shards without one, like 2/8."""

    jobs: int
    journals: int
    missing: list[str]


def merge(out: Path) -> Merged:
    """Put the records of all shards into the journal of OUT, and remove theirs."""
    require_journal(out)
    with locked(out):
        parts = gather(out)
        for shard in parts:
            if run_path(out, shard).exists():
                problem = f"shard {shard.number}/{shard.of} did not get to its end"
                note(f"{out}: warning: {problem}")
        sweep_up(out)
    return Merged(len(Ledger(out, read_all(out)).live), len(parts), _missing(parts))


def refuse_other_division(out: Path, own: Shard) -> None:
    """Refuse a shard beside records of another division, of which none comes last."""
    for shard in shards(out):
        if shard.of != own.of and journal_path(out, shard).exists():
            problem = f"is of another division than {own.number}/{own.of}"
            remedy = f"run 'defocus merge {out}' first"
            raise InputError("contradiction", problem, remedy, path=journal_path(out, shard))


def gather(out: Path) -> list[Shard]:
    """Put the records of all shards into the journal of OUT, whose lock must be held."""
    parts = [shard for shard in shards(out) if journal_path(out, shard).exists()]
    if parts:
        with written_whole(journal_path(out)) as file:
            file.write(merged(read_all(out)))
        sync_folder(out)  # before the journals of the shards are removed
    for shard in parts:
        journal_path(out, shard).unlink()
    return parts


def _missing(shards: list[Shard]) -> list[str]:
    division = max((shard.of for shard in shards), default=0)
    present = {shard.number for shard in shards if shard.of == division}
    return [f"{number}/{division}" for number in range(1, division + 1) if number not in present]

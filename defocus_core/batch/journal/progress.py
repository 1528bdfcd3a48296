"""How far a batch is: jobs by how they ended, open runs, and shards, made one by `merge`.

A run notes the names of its jobs in ``OUT/.journal.run``, until all are done.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from hashlib import blake2b
from pathlib import Path
from typing import NamedTuple

from defocus_core.batch.journal.journal import (
    JournalFile,
    Ledger,
    Shard,
    journal_path,
    require_journal,
    shards,
)
from defocus_core.batch.journal.lock import holder, lock_path, locked
from defocus_core.batch.journal.record import Record, is_moment, now
from defocus_core.errors import InputError, cannot_read
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import LEFTOVER, left_in, sync_folder, written_whole
from defocus_core.request.output_kinds import KINDS
from defocus_core.system.text import note

SHARDS_FOLDER = "shards"  # of tars


@dataclass
class OpenRun:
    """A run that did not come to its end, and what it did."""

    begun: str  # when, UTC
    left: set[str]  # samples of its jobs that did not end since
    again: set[str] = field(default_factory=set)  # those of them that ended before
    ended: int = 0
    last: str = ""  # when the last of them ended


def run_path(out: Path, shard: Shard | None = None) -> Path:
    """The file that notes a run on OUT, or on a shard."""
    return out / (f".journal-{shard.number}of{shard.of}.run" if shard else ".journal.run")


def note_run(out: Path, shard: Shard | None, samples: Iterable[str]) -> Path:
    """Note a run by its samples; one on all of OUT has those that runs on shards left."""
    path = run_path(out, shard)
    with written_whole(path) as file:
        file.write(json.dumps({"begun": now(), "jobs": [*samples]}).encode() + b"\n")
    for other in out.glob(".journal-*.run") if shard is None else ():
        other.unlink(missing_ok=True)
    return path


def open_run(out: Path, shard: Shard | None = None) -> OpenRun | None:
    """The run on OUT, or on a shard, that is noted; None if it came to its end."""
    path = run_path(out, shard)
    try:
        text = Folder(path.parent).read(path.name)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise cannot_read(path, error, "remove it") from None
    with suppress(ValueError, TypeError, KeyError, RecursionError):
        stored = json.loads(text)
        run = OpenRun(stored["begun"], {*stored["jobs"]})
        if is_moment(run.begun) and all(isinstance(name, str) for name in run.left):
            return run
    remedy = "remove the file, and what the run left half-written; the next run begins anew"
    raise InputError("malformed", "is not the note of a run", remedy, path=path)


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


@dataclass
class Progress:
    """Progress of a batch: jobs that ended, and jobs that are left."""

    statuses: Counter[str]  # number of jobs by status
    reasons: Counter[str]  # number of jobs without outputs, by reason
    left: int = 0  # jobs that runs set out to do and did not do yet
    # How many of these count among ``statuses``, too: inputs or settings changed, or they
    # failed
    again: int = 0
    running: list[str] = field(default_factory=list)  # the processes that hold a lock, in words
    # Jobs a second, of the runs that go on or were stopped; None if there are none
    rate: float | None = None
    seconds: float | None = None  # mean rendering time of a finished job
    # Numbers of the parts that have begun, and of how many; None if not in parts
    shards: tuple[list[int], int] | None = None
    # The records that failed or were rejected, the last ones, oldest first
    failures: list[Record] = field(default_factory=list)

    @property
    def jobs(self) -> int:
        """The number of jobs."""
        return sum(self.statuses.values()) + self.left - self.again

    @property
    def eta_seconds(self) -> float | None:
        """Seconds until all is done at the present rate; None if nothing runs."""
        if not (self.running and self.rate):
            return None
        return self.left / self.rate


def progress(out: Path, failures: int) -> Progress:
    """Read the journals of OUT as a stream, without a lock; it keeps so many failures."""
    require_journal(out, "*journal*.[jr]*")
    divided = shards(out)
    parts = (None, *divided)
    runs = {part: run for part in parts if (run := open_run(out, part)) is not None}

    def seen(of: Shard | None, sample: str, finished: str) -> None:
        for part, run in runs.items():
            is_new = finished >= run.begun
            if is_new:
                run.left.discard(sample)
            elif sample in run.left:
                run.again.add(sample)
            if is_new and part == of:
                run.ended, run.last = run.ended + 1, finished

    ledger = Ledger(out, seen if runs else None)
    state = Progress(Counter(), Counter())
    seconds, without = 0.0, list[int]()
    for number in ledger.live():
        outcome = ledger.outcomes[number]
        state.statuses[outcome.status] += 1
        if outcome.status == "ok":
            seconds += ledger.seconds[number]
        else:
            state.reasons[str(outcome.reason)] += 1
            without.append(number)
    if state.statuses["ok"]:
        state.seconds = seconds / state.statuses["ok"]
    state.failures = [ledger.record(number) for number in without[-failures:] if failures]
    if divided:
        division = max(part.of for part in divided)
        state.shards = sorted(part.number for part in divided if part.of == division), division
    for part in parts:
        _add_run(state, holder(lock_path(out, part)), runs.get(part))
    return state


def _add_run(state: Progress, who: str | None, run: OpenRun | None) -> None:
    """Add the process, the jobs left and the rate of a run."""
    if who:
        state.running.append(who)
    if run is None:
        return
    state.left += len(run.left)
    state.again += len(run.again & run.left)
    if run.ended:
        until = datetime.now(UTC) if who else datetime.fromisoformat(run.last)
        since = (until - datetime.fromisoformat(run.begun)).total_seconds()
        state.rate = (state.rate or 0.0) + run.ended / max(since, 1e-3)


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
    of = max((part.of for part in parts), default=0)
    missing = [f"{n}/{of}" for n in range(1, of + 1) if Shard(n, of) not in parts]
    return Merged(sum(1 for _ in Ledger(out).live()), len(parts), missing)


def refuse_other_division(out: Path, own: Shard) -> None:
    """Refuse a shard beside records of another division, of which none comes last."""
    for shard in shards(out):
        if shard.of != own.of and journal_path(out, shard).exists():
            problem = f"belongs to another number of shards than {own.number}/{own.of}"
            remedy = f"run 'defocus merge {out}' first"
            raise InputError("contradiction", problem, remedy, path=journal_path(out, shard))


def gather(out: Path) -> list[Shard]:
    """Put the records of all shards into the journal of OUT, whose lock must be held."""
    parts = [shard for shard in shards(out) if journal_path(out, shard).exists()]
    if parts:
        with written_whole(journal_path(out)) as file:
            file.writelines(_joined([None, *parts], out))
        sync_folder(out)  # before the journals of the shards are removed
    for shard in parts:
        journal_path(out, shard).unlink()
    return parts


def _joined(parts: Sequence[Shard | None], out: Path) -> Iterator[bytes]:
    """The lines of journals, each of them once."""
    known = set[bytes]()
    for part in parts:
        for line in JournalFile(journal_path(out, part)).lines():
            digest = blake2b(line.text.rstrip(b"\n"), digest_size=16).digest()
            if digest not in known:
                known.add(digest)
                yield line.text.rstrip(b"\n") + b"\n"

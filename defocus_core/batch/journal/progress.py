"""How far a batch is: jobs by how they ended, open runs, and shards, made one by `merge`."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from defocus_core.batch.journal.journal import (
    Ledger,
    Shard,
    require_journal,
    shards,
)
from defocus_core.batch.journal.record import Record
from defocus_core.batch.journal.runs import (
    OpenRun,
    gather,
    holder,
    lock_path,
    locked,
    open_run,
    run_path,
    sweep_up,
)
from defocus_core.system.text import note


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
    # The records that failed, the last ones, oldest first
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

    def seen(of: Shard | None, sample: str, finished: datetime) -> None:
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
    if who:
        state.running.append(who)
    if run is None:
        return
    state.left += len(run.left)
    state.again += len(run.again & run.left)
    if run.last is not None:
        until = datetime.now(UTC) if who else run.last
        since = (until - run.begun).total_seconds()
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

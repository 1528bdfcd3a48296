"""The progress of a batch: jobs by outcome, open runs, and shards, which `merge` joins."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
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
    left: int = 0  # jobs of open runs that are not done
    # How many of these are in ``statuses``, too: inputs or settings changed, or they
    # failed
    again: int = 0
    running: list[str] = field(default_factory=list)  # the processes that hold a lock, in words
    # Numbers of the begun shards, and the number of all; None without shards
    shards: tuple[list[int], int] | None = None
    # The last records that failed, oldest first
    failures: list[Record] = field(default_factory=list)

    @property
    def jobs(self) -> int:
        """The number of jobs."""
        return sum(self.statuses.values()) + self.left - self.again


def progress(out: Path, failures: int) -> Progress:
    """Read the journals of OUT as a stream, without a lock, and keep the last failures."""
    require_journal(out, "*journal*.[jr]*")
    divided = shards(out)
    parts = (None, *divided)
    runs = [run for part in parts if (run := open_run(out, part)) is not None]

    ledger = Ledger(out)
    state = Progress(Counter(), Counter())
    without = list[int]()
    for number in ledger.live():
        outcome = ledger.outcomes[number]
        state.statuses[outcome.status] += 1
        if outcome.status != "ok":
            state.reasons[str(outcome.reason)] += 1
            without.append(number)
    state.failures = [ledger.record(number) for number in without[-failures:] if failures]
    if divided:
        division = max(part.of for part in divided)
        state.shards = sorted(part.number for part in divided if part.of == division), division
    state.running = [who for part in parts if (who := holder(lock_path(out, part)))]
    left = [count for run in runs for count in run.left(ledger.counts()).values()]
    state.left, state.again = len(left), sum(map(bool, left))
    return state


class Merged(NamedTuple):
    """A merge: its live jobs, its journals of shards, and the shards without one, like 2/8."""

    jobs: int
    journals: int
    missing: list[str]


def merge(out: Path) -> Merged:
    """Merge the journals of all shards into that of OUT, and remove them."""
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

"""Progress of the batch in OUT, from its journals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from defocus_core.batch.journal.journal import (
    Record,
    Shard,
    journal_path,
    read,
    shards,
)
from defocus_core.batch.journal.lock import holder, lock_path
from defocus_core.batch.journal.resume import Ledger
from defocus_core.batch.journal.run_file import plan_of, run_path
from defocus_core.errors import InputError


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
    # The records that failed or were rejected, oldest first
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


def progress(out: Path) -> Progress:
    """Read the journals of OUT, without a lock."""
    parts = shards(out)
    runs = (None, *parts)
    if not any(path(out, run).exists() for run in runs for path in (journal_path, run_path)):
        raise InputError(
            "empty", "has no journal", "name the directory that a batch writes to", path=out
        )
    records = {run: read(journal_path(out, run)) for run in runs}
    every = [record for of_run in records.values() for record in of_run]
    live = Ledger(out, every).live
    state = Progress(
        statuses=Counter(record["status"] for record in live),
        reasons=Counter(record["reason"] for record in live if record["reason"]),
        failures=[record for record in live if record["status"] != "ok"],
    )
    rendered = [record["seconds"]["render"] for record in live if record["status"] == "ok"]
    if rendered:
        state.seconds = sum(rendered) / len(rendered)
    if parts:
        division = max(part.of for part in parts)
        state.shards = sorted(part.number for part in parts if part.of == division), division
    for run in runs:
        _add_run(state, out, run, records[run], every)
    return state


def _add_run(
    state: Progress,
    out: Path,
    run: Shard | None,
    records: Sequence[Record],
    every: Sequence[Record],
) -> None:
    """Add the jobs left, the rate and the process of a run that did not get to its end."""
    who, plan = holder(lock_path(out, run)), plan_of(out, run)
    if who:
        state.running.append(who)
    if plan is None:
        return
    left = plan.left(every)
    state.left += len(left)
    state.again += len({record["sample_id"] for record in every}.intersection(left))
    own = [record for record in records if record["finished"] >= plan.begun]
    if own:
        until = datetime.now(UTC) if who else datetime.fromisoformat(own[-1]["finished"])
        since = (until - datetime.fromisoformat(plan.begun)).total_seconds()
        state.rate = (state.rate or 0.0) + len(own) / max(since, 1e-3)

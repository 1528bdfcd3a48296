"""The progress of a batch: finished jobs, unfinished runs and shards; and merging of shards."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from defocus_core.batch.journal.journal import Ledger, Shard, require_journal, shards
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
    """The progress of a batch, with the fields of ``defocus status --json``."""

    jobs: int
    left: int  # jobs of open runs that are not done
    again: int  # how many of `left` ended before: failed, or with changed inputs or settings
    ok: int
    failed: int
    reasons: dict[str, int]  # number of failed jobs by reason
    running: list[str]  # the processes that hold a lock, in words
    shards: dict[str, Any] | None  # numbers of the begun ones, and of how many; None without any
    failures: list[dict[str, Any]]  # sample_id, status, reason, message, oldest first


def progress(out: Path, failures: int) -> Progress:
    """Read the progress of the batch in `out`, with its last `failures` failures; needs no lock."""
    require_journal(out, "*journal*.[jr]*")
    divided = shards(out)
    parts = (None, *divided)
    runs = [open_run(out, part) for part in parts]
    ledger = Ledger(out)
    live = [*ledger.live()]
    without = [number for number in live if not ledger.is_ok(number)]
    ended = [ledger.record(number) for number in without[-failures:] if failures]
    records = ledger.counts()
    left = [n for run in runs for name, n in run.items() if records[name] <= n]
    again = sum(map(bool, left))
    of = max((part.of for part in divided), default=0)
    begun = sorted(part.number for part in divided if part.of == of)
    return Progress(
        jobs=len(live) + len(left) - again,
        left=len(left),
        again=again,
        ok=len(live) - len(without),
        failed=len(without),
        reasons=dict(Counter(str(ledger.outcomes[number].reason) for number in without)),
        running=[who for part in parts if (who := holder(lock_path(out, part)))],
        shards={"begun": begun, "of": of} if divided else None,
        failures=[
            {"sample_id": record.sample_id}
            | {key: getattr(record.end, key) for key in ("status", "reason", "message")}
            for record in ended
        ],
    )


def merge(out: Path) -> tuple[int, int, list[str]]:
    """Merge the journals of all shards into one.

    Returns the numbers of jobs and of merged journals, and shards without journal, like "3/8".
    """
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
    return sum(1 for _ in Ledger(out).live()), len(parts), missing

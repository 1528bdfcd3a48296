"""The journals of the shards of a batch, merged to one."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from defocus_core.batch.journal import journal, journal_copy, run_file
from defocus_core.batch.journal.ledger import Ledger
from defocus_core.batch.journal.lock import locked
from defocus_core.io.safe_files import sync_folder, written_whole
from defocus_core.system.text import note


class Merged(NamedTuple):
    """A merge: its live jobs, its journals of shards, and the shards without one, like 2/8."""

    jobs: int
    journals: int
    missing: list[str]


def merge(out: Path) -> Merged:
    """Put the records of all shards into the journal of OUT, and remove theirs."""
    journal.require_journal(out)
    with locked(out, say=note) as require_lock:
        shards = [s for s in journal.shards(out) if journal.journal_path(out, s).exists()]
        for shard in (None, *shards):
            journal_copy.mend(out, shard)
        records = journal.read_all(out)
        require_lock()
        if shards:
            with written_whole(journal.journal_path(out)) as file:
                file.write(journal.merged(records))
            sync_folder(out)  # before the journals of the shards are removed
            journal_copy.follow(out)
        for shard in shards:
            journal_copy.copy_path(out, shard).unlink(missing_ok=True)
            journal.journal_path(out, shard).unlink()
            if run_file.run_path(out, shard).exists():
                problem = f"shard {shard.number}/{shard.of} did not get to its end"
                note(f"{out}: warning: {problem}")
        run_file.sweep_up(out)
    return Merged(len(Ledger(out, records).live), len(shards), _missing(shards))


def _missing(shards: list[journal.Shard]) -> list[str]:
    division = max((shard.of for shard in shards), default=0)
    present = {shard.number for shard in shards if shard.of == division}
    return [f"{number}/{division}" for number in range(1, division + 1) if number not in present]

"""Outputs whose records a journal lost, as one does that a power loss cut.

They are ours if the index of OUT names them with the hash of their bytes, or if their header names
the picture that they are made of. Their jobs are done again: nothing tells how they were done.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from defocus_core.batch.datasets import sample_index
from defocus_core.batch.jobs.job import Job
from defocus_core.batch.journal import identity
from defocus_core.io.below import Folder
from defocus_core.system.log import note
from defocus_core.system.text import counted

_HEAD = 2**16  # bytes of a file that its header is looked for in
_STAMP = b"defocus:color"


def outputs_without_record(jobs: Sequence[Job], out: Path, known: Collection[str]) -> set[str]:
    """The files of jobs, relative to OUT, that a batch wrote and no journal knows; a line says it.

    Args:
        jobs: what is to be done.
        out: the directory, in which a journal stands.
        known: files that the journals know.
    """
    if not any(out.glob("journal*.jsonl")):
        return set()
    hashes = sample_index.hashes(out)
    own: set[str] = set()
    for job in jobs:
        there = [n for n in job.names.values() if n not in known and os.path.lexists(out / n)]
        if any(_is_own(out, name, hashes, job) for name in there):
            own.update(there)
    if own:
        note(f"{out}: the journal no longer knows {counted(len(own), 'output')}, done again")
    return own


def _is_own(out: Path, name: str, hashes: Mapping[str, str], job: Job) -> bool:
    with suppress(OSError):
        if name in hashes and identity.stamp(out / name, out)["blake2b"] == hashes[name]:
            return True
        with Folder(out).open(name) as file:
            head = file.read(_HEAD)
        return _STAMP in head and os.fsencode(job.picture.color.name) in head
    return False

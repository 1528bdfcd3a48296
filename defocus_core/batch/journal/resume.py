"""Why a job is done again: its settings, its inputs, its outputs or the renderer changed.

A job is done once. It is done again if what was asked for changed, if an input has other bytes, if
an output is not as it was written, if it failed, or if the renderer makes other pictures by now;
`AGAIN` has the words. A ``max-coc`` counts if another lens is drawn by it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from defocus_core.batch.journal import identity
from defocus_core.batch.journal.journal import Ledger, input_path
from defocus_core.batch.journal.record import Record, Stamp, Stamps
from defocus_core.errors import InputError
from defocus_core.renderer_version import RENDERER_VERSION
from defocus_core.request.job import Job
from defocus_core.request.lens import lens_record_words

# Words of the reasons, in the order in which they are looked for.
AGAIN = {
    "failed": "failed before",
    "settings": "settings",
    "inputs": "inputs",
    "outputs": "outputs gone or changed",
    "renderer": "renderer {old} → {new}",
}


class Decision(NamedTuple):
    """Whether a job is done."""

    is_done: bool
    again: str = ""  # why it is done again, in words; empty if it is done, or new
    moved: Stamps | None = None  # what its record is to say: inputs that lie elsewhere by now


def decided(job: Job, ledger: Ledger, recipe: str, *, read_inputs: bool) -> Decision:
    """Whether a job is done: an ``ok`` or a rejection that would be the same again.

    If the sample is of another split, its record is to say so, too.

    `read_inputs`: compare the bytes of the inputs, not only size and time.
    """
    names = job.names
    number = ledger.number_of(names.values())
    if number is None:
        is_known = any(map(ledger.is_known, names.values()))
        return Decision(False, AGAIN["settings"] if is_known else "")
    record = ledger.record(number)
    if why := _changed(job, record, recipe):
        return Decision(False, AGAIN[why])
    moved = _moved(job, record, ledger.out, read_inputs=read_inputs)
    if moved is None:
        return Decision(False, AGAIN["inputs"])
    if record.taken is not None:
        stamps = record.outputs.values()
        there = all(identity.unchanged(f"{ledger.out}/{stamp.path}", stamp) for stamp in stamps)
        if not there or record.outputs.keys() != names.keys():
            return Decision(False, AGAIN["outputs"])
    if record.renderer != RENDERER_VERSION:
        words = AGAIN["renderer"].format(old=record.renderer, new=RENDERER_VERSION)
        return Decision(False, words)
    return Decision(True, moved=moved if moved or record.split != job.split.name else None)


def moved_record(job: Job, ledger: Ledger, moved: Stamps) -> Record:
    """The record of a job that is done, as it is now: where its inputs lie, and its split."""
    record = ledger.record_of(job.names.values())
    record = record.with_files(inputs={**record.inputs, **moved})
    return replace(record, split=job.split.name)


def _changed(job: Job, record: Record, recipe: str) -> str:
    """Why a job is done again whatever its files hold: a key of `AGAIN`; empty if it is not."""
    if record.status == "failed":
        return "failed"
    if record.recipe != recipe:
        changes = identity.changed_settings(record.settings, identity.settings(job))
        if any(name != "lens.max_coc" for name, _, _ in changes):
            return "settings"
        names = {role: path.name for role, path in job.files.items()}
        if names != {r: Path(s.path).name for r, s in record.inputs.items()}:
            return "inputs"
    return "" if _draws_alike(record, job.lens.max_coc) else "settings"


def _draws_alike(record: Record, max_coc: float | None) -> bool:
    """Whether another ``max-coc`` leaves a job its lens, or its rejection."""
    lens = record.settings.get("lens", {})
    before = _number(lens.get("max_coc"))
    now = math.inf if max_coc is None else max_coc
    if now == before:
        return True
    if record.taken is None:
        return now <= before
    draw = record.taken.lens.get("draw", {})
    if max(map(abs, record.taken.coc_px)) > now:
        return False
    return not draw.get("attempt") or now <= before or now < _number(draw.get("refused_px", 0))


def _number(value: float | None) -> float:
    return math.inf if value is None else value


def _moved(job: Job, record: Record, out: Path, *, read_inputs: bool) -> dict[str, Stamp] | None:
    """The inputs of a record that lie elsewhere by now; None if one is another."""
    moved = {}
    for role, path in job.files.items():
        stamp = record.inputs.get(role, Stamp())
        # Size and time say nothing of a file that was elsewhere: archives give all one time.
        elsewhere = stamp.path != (place := input_path(path, out))
        if not identity.unchanged(path, stamp, read=read_inputs or elsewhere):
            if not path.exists() and record.taken is not None:
                continue  # an input that is gone cannot change the outputs
            return None
        if elsewhere:
            moved[role] = stamp._replace(path=place)
    return moved


def refuse_others(jobs: Iterable[Job], ledger: Ledger, *, keep_lenses: bool) -> None:
    """Refuse to replace outputs of another picture, and, if asked, those of another lens."""

    def taken(settings: Mapping[str, Any]) -> tuple[Any, Any]:
        return settings.get("lens") or {}, (settings.get("reading") or {}).get("view")

    for job in jobs:
        now = taken(identity.settings(job))
        for name in () if job.outputs.overwrite else job.names.values():
            path, number = ledger.out / name, ledger.last.get(name)
            if number is None or not path.exists():
                continue
            record = ledger.record(number)
            before = ledger.out.resolve() / record.inputs["color"].path
            was = taken(record.settings)
            if before.exists() and before.resolve() != job.picture.color.resolve():
                other = f"made of another picture, {before.resolve()}"
            elif keep_lenses and record.taken is not None and was != now:
                view = f", view {was[1]}" if was[1] != now[1] else ""
                other = f"taken otherwise: {lens_record_words(record.taken.lens)}{view}"
            else:
                continue
            remedy = "choose another -o or ‹name›, or add ‹overwrite› to replace it"
            raise InputError("exists", f"exists already, {other}", remedy, path=path)

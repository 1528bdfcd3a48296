"""What resume does again: jobs that the journals of OUT settle, the last record of each file.

A job is done again if its recipe or its inputs have changed, which `identity` says; those that are
done again whatever the journal says, `workers.plan` takes by itself.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from defocus_core.batch.journal import identity
from defocus_core.batch.journal.identity import typed
from defocus_core.batch.journal.journal import Record, files_of, input_path
from defocus_core.errors import InputError, Place
from defocus_core.request.job import (
    FRAME_ROLE,
    OTHERS,
    FrameLens,
    Job,
    Machine,
    Outputs,
    Picture,
    Reading,
    Shot,
    Split,
)
from defocus_core.request.lens import Lens, lens_record_words
from defocus_core.request.output_kinds import PREVIEW
from defocus_core.request.parameters import LENS_FILES
from defocus_core.system.memory import without_collections


class Ledger:
    """The records of the journals of OUT; ``files`` are the outputs in them, relative to OUT.

    A record names all files that its job writes; of records that name the same file the last one
    counts. A record of pictures is superseded when none of them is left but previews; a record
    without outputs, as soon as another one names any of its files.
    """

    def __init__(self, out: Path, records: Iterable[Record]) -> None:
        self.out = out
        self.files: set[str] = set()
        self._last: dict[str, Record] = {}
        with without_collections():
            for record in records:
                for path in files_of(record):
                    self._last.pop(path, None)  # the last comes last
                    self._last[path] = record
                    if record["status"] == "ok":
                        self.files.add(path)

    @property
    def live(self) -> list[Record]:
        """The records that are not superseded, oldest first, with the outputs that are theirs."""
        last = {id(record): record for record in self._last.values()}
        return [own for record in last.values() if (own := self._own(record)) is not None]

    @property
    def previews(self) -> dict[str, identity.Stamp]:
        """The previews of pictures by path, with their stamps."""
        done = (record for record in self._last.values() if record["status"] == "ok")
        outputs = (each for record in done for each in record["outputs"].items())
        return {stamp["path"]: stamp for name, stamp in outputs if name.endswith(PREVIEW)}

    def splits(self) -> dict[str, set[str]]:
        """The splits that pictures were in, by their names."""
        found: dict[str, set[str]] = defaultdict(set)
        for record in self._last.values():
            if split := record.get("split"):
                found[str(record["settings"].get("stem"))].add(split)
        return found

    def settled(self, job: Job, *, recipe: str, read_inputs: bool) -> Record | None:
        """The record by which a job need not be done again; None if it has to be.

        That is an ``ok`` of the same recipe whose inputs and outputs are as they were, or a
        rejection of the same recipe with the same inputs. If the inputs lie elsewhere by now, or
        the sample is of another split, it is a new record that says so.

        `read_inputs`: compare the bytes of the inputs, not only size and time.
        """
        planned = job.names
        record, *others = [self._last.get(path) for path in planned.values()]
        if record is None or any(other is not record for other in others):
            return None
        if record["status"] == "failed" or record["recipe"] != recipe:
            return None
        moved = {}
        for role, path in job.files.items():
            stamp = record["inputs"].get(role, {})
            # Size and time say nothing of a file that was elsewhere: archives give all one time.
            elsewhere = stamp.get("path") != (place := input_path(path, self.out))
            if not identity.unchanged(path, stamp, read=read_inputs or elsewhere):
                if not path.exists() and record["status"] == "ok":
                    continue  # an input that is gone cannot change the outputs
                return None
            if elsewhere:
                moved[role] = {**stamp, "path": place}
        if record["status"] == "ok" and not self._in_place(record, planned):
            return None
        if moved:
            record = {**record, "inputs": {**record["inputs"], **moved}}
        split = job.split.name
        return record if record.get("split", "") == split else {**record, "split": split}

    def has(self, record: Record) -> bool:
        """Whether this very record is one that the journals have, and not superseded."""
        return any(self._last.get(path) is record for path in files_of(record))

    def refuse_others(self, jobs: Iterable[Job], *, keep_lenses: bool) -> None:
        """Refuse to replace outputs of another picture, and, if asked, those of another lens."""

        def taken(settings: Mapping[str, Any]) -> tuple[Any, Any]:
            return settings.get("lens") or {}, (settings.get("reading") or {}).get("view")

        for job in jobs:
            now = taken(identity.settings(job))
            for name in () if job.outputs.overwrite else job.names.values():
                path, record = self.out / name, self._last.get(name)
                if record is None or not path.exists():
                    continue
                before = self.out.resolve() / record["inputs"]["color"]["path"]
                was = taken(record["settings"])
                if before.exists() and before.resolve() != job.picture.color.resolve():
                    other = f"made of another picture, {before.resolve()}"
                elif keep_lenses and record["status"] == "ok" and was != now:
                    view = f", view {was[1]}" if was[1] != now[1] else ""
                    other = f"taken otherwise: {lens_record_words(record['lens'])}{view}"
                else:
                    continue
                remedy = "choose another -o or ‹name›, or add ‹overwrite› to replace it"
                raise InputError("exists", f"exists already, {other}", remedy, path=path)

    def _own(self, record: Record) -> Record | None:
        """A record without the outputs that another has replaced; None if it is superseded."""
        outputs = record["outputs"]
        own = {n: stamp for n, stamp in outputs.items() if self._last[stamp["path"]] is record}
        if len(own) == len(outputs):
            return record
        if record["status"] != "ok" or all(name.endswith(PREVIEW) for name in own):
            return None
        return {**record, "outputs": own}

    def _in_place(self, record: Record, planned: Mapping[str, str]) -> bool:
        outputs = record["outputs"]
        return set(outputs) == set(planned) and all(
            identity.unchanged(f"{self.out}/{stamp['path']}", stamp) for stamp in outputs.values()
        )


def failed_jobs(ledger: Ledger, reasons: Collection[str]) -> list[Job]:
    """The jobs that failed; if reasons are named, all jobs without outputs for one of them."""
    return [
        job_of(record, ledger.out)
        for record in ledger.live
        if (record["reason"] in reasons if reasons else record["status"] == "failed")
    ]


def job_of(record: Record, out: Path) -> Job:
    """The job of a record."""
    asked, inputs = record["settings"], record["inputs"]
    try:
        shot = _shot(asked["shot"], inputs, out) if "shot" in asked else None
        picture = _picture(asked["stem"], inputs, out)
        if shot is not None:
            picture = replace(picture, frame=asked["shot"]["frame"])
        job = Job(
            picture,
            _lens(asked["lens"], inputs, out),
            typed(Reading, asked["reading"]),
            typed(Outputs, {"root": str(out), **asked["outputs"]}),
            Machine(
                quality=asked["quality"],
                tile=asked.get("tile"),
            ),
            asked["suffix"],
            shot,
            Split(record.get("split", "")),
        )
        if set(job.names.values()) != {stamp["path"] for stamp in record["outputs"].values()}:
            raise ValueError("its settings name other files than its outputs")
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        problem = f"has a record of {record['sample_id']} that cannot be read: {error}"
        raise InputError("unreadable", problem, "run 'defocus batch' again", path=out) from None
    return job


def _lens(asked: Mapping[str, Any], inputs: Mapping[str, Any], out: Path) -> Lens:
    """The lens, with its files, which are among the inputs."""
    lens: Lens = typed(Lens, asked)
    recorded = {name: inputs[name]["path"] for name in LENS_FILES if name in inputs}
    files: dict[str, Any] = {name: input_place(path, out) for name, path in recorded.items()}
    return replace(lens, focus_source=Place(out), **files)


def _picture(stem: str, inputs: Mapping[str, Any], out: Path, prefix: str = "") -> Picture:
    """The picture whose files have roles with a prefix."""
    color, depth = (input_place(inputs[prefix + role]["path"], out) for role in ("color", "depth"))
    others: dict[str, Any] = {
        role: _picture(stem, inputs, out, f"{role}_")
        for role in OTHERS
        if not prefix and f"{role}_color" in inputs
    }
    return Picture(stem, color, depth, **others)


def _shot(asked: Mapping[str, Any], inputs: Mapping[str, Any], out: Path) -> Shot:
    """The shot of a job, whose frames are among the inputs."""

    def picture(frame: int) -> Picture:
        of_frame = _picture("", inputs, out, f"{FRAME_ROLE}{frame}_")
        return replace(of_frame, stem=of_frame.color.stem, frame=frame)

    def taken(frames: Sequence[Any]) -> tuple[FrameLens, ...]:
        return tuple(FrameLens(picture(frame), typed(Lens, lens)) for frame, lens in frames)

    window = tuple(picture(frame) for frame in asked["window"])
    return Shot(taken(asked["sample"]), window, taken(asked["focus"]), asked.get("motion"))


def input_place(recorded: str, out: Path) -> Path:
    """A path of the journal, relative to the working directory."""
    if Path(recorded).is_absolute():
        return Path(recorded)
    return Path(os.path.relpath(out.resolve() / recorded))

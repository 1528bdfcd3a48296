"""Jobs rebuilt from their journal records."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from defocus_core.batch.jobs.job import (
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
from defocus_core.batch.journal.journal import Record
from defocus_core.batch.journal.ledger import Ledger
from defocus_core.batch.journal.plain_values import typed
from defocus_core.batch.lenses.lens import Lens
from defocus_core.batch.lenses.parameters import LENS_FILES
from defocus_core.errors import InputError, Place


def failed_jobs(ledger: Ledger, reasons: Collection[str]) -> list[Job]:
    """The jobs that failed; if reasons are named, all jobs without outputs for one of them."""
    return [
        revived(record, ledger.out)
        for record in ledger.live
        if (record["reason"] in reasons if reasons else record["status"] == "failed")
    ]


def revived(record: Record, out: Path) -> Job:
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
            typed(Reading, {**_earlier_repair(asked), **asked["reading"]}),
            typed(Outputs, {"root": str(out), **asked["outputs"]}),
            Machine(
                quality=asked["quality"],
                tolerance=asked.get("tolerance"),
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


def _earlier_repair(asked: Mapping[str, Any]) -> dict[str, Any]:
    """The repair of depth as earlier versions recorded it, beside the reading."""
    return {name: asked[name] for name in ("depth_repair",) if name in asked}


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

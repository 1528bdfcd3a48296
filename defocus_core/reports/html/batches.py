"""The report of a batch: an item for each sample, what failed first, the others by name.

The input and what the lens made of it are the first layers; all other outputs of the sample follow.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from defocus_core.batch.datasets.card import card_of, tables_of
from defocus_core.batch.journal.journal import Ledger, require_journal
from defocus_core.batch.journal.record import Record
from defocus_core.reports.html.item import Column, Item, Layer, Report
from defocus_core.reports.html.layers import drawn_files, valued_layers, wiggle_of
from defocus_core.reports.html.page import ValuesRoom, write_report
from defocus_core.reports.html.render_command import render_command
from defocus_core.request.job import FRAME_ROLE
from defocus_core.request.lens import lens_record_words
from defocus_core.request.output_kinds import KINDS
from defocus_core.system.process import spread

_COLUMNS = (Column("coc", "largest CoC", "px"), Column("seconds", "rendering", "s"))
_DIGITS = re.compile(r"(\d+)")


# A sample that is to be drawn: kind and file of each layer, and whether values are wanted.
Sample = tuple[Sequence[tuple[str, Path]], bool]


def write(out: Path, path: Path, asked: Collection[str] | None, processes: int) -> int:
    """Write the report of the batch in a directory; the number of its items.

    `asked`: names of the samples, None for all.
    """
    require_journal(out)
    records = list(Ledger(out).records(asked))
    tables = list(tables_of(card_of(records)))
    records.sort(key=_place)
    drawings = spread(draw_sample, list(_samples(records, out)), processes, "the report")
    items = [_item(record, layers, out) for record, layers in zip(records, drawings, strict=True)]
    counts = Counter(item.status for item in items)
    words = [f"Directory: {out}", ", ".join(f"{n} {status}" for status, n in counts.items())]
    write_report(path, Report(f"Batch in {out}", words, items, _COLUMNS, tables))
    return len(items)


def _place(record: Record) -> tuple[bool, list[tuple[int, str]]]:
    """Sorts records: those without pictures first, then by name, frame 2 before frame 10."""
    parts = _DIGITS.split(record.sample_id)
    natural = [(int(part), "") if part.isdigit() else (-1, part) for part in parts]
    return record.taken is not None, natural


def _samples(records: Sequence[Record], out: Path) -> Iterator[Sample]:
    """What is to be drawn; values are wanted of the first, while there may be room for them."""
    room = ValuesRoom(len(records))
    for record in records:
        taken = record.taken
        if taken is None:
            yield (), False
            continue
        written = ((kind, taken.outputs[kind]) for kind in KINDS if kind in taken.outputs)
        stamps = [("input", taken.inputs["color"]), *written]
        files = [(kind, out / stamp.path) for kind, stamp in stamps]
        planes = sum(1 if kind in KINDS and not KINDS[kind].image else 3 for kind, _ in files)
        yield files, room.takes(taken.size, planes)


def draw_sample(sample: Sample) -> list[Layer]:
    """The layers of a sample; files that cannot be read any more are left out."""
    files, values = sample
    drawn = list(drawn_files(files, values=values))
    return valued_layers(drawn) if values and drawn else [each.layer for each in drawn]


def _item(record: Record, layers: Sequence[Layer], out: Path) -> Item:
    taken, end = record.taken, record.end
    command = render_command(record, out)
    return Item(
        name=record.sample_id,
        status=end.status if taken is None else "warning" if taken.warnings else "done",
        passes=taken is not None,
        words="; ".join(end.warnings) or end.message,
        facts=list(_facts(record)),
        metrics={}
        if taken is None
        else {"coc": max(map(abs, taken.coc_px)), "seconds": taken.seconds["render"]},
        facets={"reason": str(end.reason)}
        if taken is None
        else {"lens": lens_record_words(taken.lens)},
        commands=[("Render again", command)] if command else [],
        layers=layers,
        wiggle=wiggle_of(layers),
    )


def _facts(record: Record) -> Iterator[tuple[str, str]]:
    """Terms, and what is to be said of each."""
    taken, end = record.taken, record.end
    for warning in end.warnings:
        yield "Warning", warning
    if end.message:
        yield "Error", end.message
    if taken is not None:
        (width, height), (near, far) = taken.size, taken.coc_px
        yield "Size", f"{width}x{height}"
        yield "CoC", f"{near:.2f} to {far:.2f} px"
        yield "Colour read as", taken.color_note
        yield "Depth read as", taken.depth_note
        yield "Quality", f"{record.quality}, {taken.device}"
    for name, stamp in {**record.inputs, **record.outputs}.items():
        if not name.startswith(FRAME_ROLE):  # other frames of a shot
            yield name, stamp.path

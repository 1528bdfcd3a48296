"""Update of a data set: a run removes the index before samples change, and writes it at the end.

If there is an index, it is therefore valid. It lists the jobs of the last jobs file that was run;
samples of pictures or lenses that this file does not have are not listed, though their files stay.
`defocus merge` lists all samples in OUT.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack
from itertools import groupby
from pathlib import Path
from typing import BinaryIO

from defocus_core.batch.datasets import card, sample_index, tar_shards
from defocus_core.batch.journal.journal import Ledger
from defocus_core.batch.journal.record import Record
from defocus_core.errors import InputError
from defocus_core.io.write_files import Folder, written_whole
from defocus_core.request.origin import origin_of
from defocus_core.request.output_kinds import PREVIEW
from defocus_core.system.memory import without_collections
from defocus_core.system.text import counted, note


def refuse_foreign(out: Path, splits: set[str], packed: Sequence[str] | None) -> None:
    """Raise InputError if the index, a list or a shard in `out` was not written by a batch.

    `splits` are names of splits; `packed` those of the samples to pack into shards, or None.
    """
    lists = [sample_index.NAME, *map(sample_index.list_name, sorted(splits - {""}))]
    names = [name for name in lists if not sample_index.is_own(out, name)]
    if packed is not None:
        tar_shards.keys_of(packed, out)
        names += filter(None, [tar_shards.foreign(out)])
    if names:
        problem = "exists already, and was not written by a batch"
        remedy = "move it away, or choose another -o"
        raise InputError("exists", problem, remedy, path=out / names[0])


def withdraw(out: Path) -> set[str] | None:
    """Remove the index before samples change; returns its sample names, None without an index."""
    names = sample_index.listed(out)
    if names is not None:
        for name in (sample_index.NAME, *sample_index.split_lists(out)):
            Folder(out).remove(name)
    return names


@without_collections()
def index(
    out: Path, shards_size: int | None = None, asked: Collection[str] | None = None
) -> list[Path]:
    """Write the index, the lists of splits, the card and, if requested, shards; returns the paths.

    Args:
        out: The output folder of the batch.
        shards_size: Greatest size of a shard in bytes; None to write none.
        asked: Names of the samples to list, if they are finished; None for all in `out`.
    """
    records = Ledger(out).records(asked)
    if asked is None:
        records = _there(out, records)
    written = _written(out, records)
    if shards_size is not None:
        return written + tar_shards.write(out, shards_size)
    if tar_shards.exist(out):
        problem = f"may hold other samples than {sample_index.NAME}"
        note(f"{out / tar_shards.FOLDER}: warning: {problem}; ‹shards-size› packs them again")
    return written


def _written(out: Path, records: Iterable[Record]) -> list[Path]:
    """Write the index, the list of each split, and the card; returns the paths."""
    count, origin = 0, origin_of(out)
    lists, pictures, made_by = dict[str, BinaryIO](), set[str](), set[str]()
    with ExitStack() as stack:
        file = stack.enter_context(written_whole(out / sample_index.NAME, out))
        for record in sample_index.newest(records):
            entry = sample_index.entry_of(record, origin)
            count += 1
            made_by.add(sample_index.made_by(record))
            file.write(sample_index.line(entry))
            for path in filter(sample_index.decoded, entry["outputs"].values()):
                pictures.add(f"{path.partition('/')[0]}/*.{path.rpartition('.')[2]}")
            if split := entry["split"]:
                if split not in lists:
                    path = out / sample_index.list_name(split)
                    lists[split] = stack.enter_context(written_whole(path, out))
                lists[split].write(sample_index.list_line(entry))
    names = {split: sample_index.list_name(split) for split in lists}
    for name in {*sample_index.split_lists(out)} - {*names.values()}:
        Folder(out).remove(name)
    paths = [out / name for name in (sample_index.NAME, *names.values())]
    lists_of = names or {"train": sample_index.NAME}
    return paths + card.write(out, origin, count, lists_of, pictures, made_by)


def _there(out: Path, records: Iterable[Record]) -> Iterator[Record]:
    """The records of samples whose files all exist; a note tells how many samples lack files."""
    gone = list[str]()
    for name, mine in groupby(records, lambda record: record.sample_id):
        every = [*mine]
        files = ((kind, s.path) for r in every if r.completed for kind, s in r.outputs.items())
        if all((out / path).exists() for kind, path in files if not kind.endswith(PREVIEW)):
            yield from every
        else:
            gone.append(name)
    if gone:
        problem = f"lacks files of {counted(len(gone), 'sample')}, like {gone[0]}"
        note(f"{out}: warning: {problem}; they are not listed, and 'defocus batch' does them again")

"""Update of the dataset in OUT when a batch has ended: index, card and shards of its samples.

A batch indexes what it asks for: a picture or lens that was taken out of the jobs file is no sample
any more, though its files stay. Where several jobs files write to one OUT, the last one counts;
`defocus merge` indexes all of them. What
`defocus render` replaces stays in it as it is now. Before a run changes files of listed samples, it
takes them out of the index, which is true at every moment. Shards that are there go with the index:
they are packed again in their size if samples changed, and till then hold what they were packed of.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from hashlib import blake2b
from itertools import groupby
from pathlib import Path
from typing import Any

from defocus_core.batch.datasets import card, sample_index, tar_shards
from defocus_core.batch.journal.journal import Ledger
from defocus_core.batch.journal.record import Record
from defocus_core.errors import InputError
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import written_whole
from defocus_core.request.origin import origin_of
from defocus_core.request.output_kinds import KINDS
from defocus_core.system.memory import without_collections
from defocus_core.system.text import counted, note


@without_collections()
def index(
    out: Path,
    shards_size: int | None,
    asked: Collection[str] | None = None,
    unchanged: Collection[str] | None = None,
) -> list[Path]:
    """Write the index, and tars if asked for.

    `shards_size`: greatest size of a tar in bytes; None to pack only where shards exist; `asked`:
    names of the samples to list, as far as they are done; None for all in OUT; `unchanged`: their
    names if all were done before, of which an index that is true stays.
    """
    if shards_size is None and unchanged is not None and _is_true(out, unchanged):
        return []
    ledger = Ledger(out)
    records = ledger.records(asked)
    if asked is None:
        records = _there(out, records)
    else:
        _tell_of_others(out, ledger.samples() - {*asked})
    written = _written(out, records)
    return written + (_followed(out) if shards_size is None else tar_shards.write(out, shards_size))


def refuse_foreign(out: Path, named: Mapping[str, str], *, packs: bool) -> None:
    """Refuse an OUT in which the index, the card or shards are not of a batch, or cannot be.

    `named`: the split of each sample by its name; `packs`: whether shards are asked for.
    """
    splits = sorted({*named.values()} - {""})
    lists = [sample_index.NAME, *map(sample_index.list_name, splits)]
    names = [name for name in lists if not sample_index.is_own(out, name)]
    names += [] if card.is_own(out) else [card.JSON]
    if packs or tar_shards.listed(out) is not None:
        tar_shards.keys_of(list(named), out)
        names += filter(None, [tar_shards.foreign(out)])
    if names:
        problem = "exists already, and was not written by a batch"
        remedy = "move it away, or choose another -o"
        raise InputError("exists", problem, remedy, path=out / names[0])


def withdraw(out: Path, changing: Collection[str], *, alone: bool) -> set[str]:
    """Take samples that are about to change out of index and card; the names of those taken."""
    taken = sample_index.withdraw(out, changing, alone=alone)
    if taken:
        sample_index.remove_splits(out, card.read(out).get("splits", ()))
        card.remove(out)  # it sums up what is no more
    return taken


def refresh(out: Path, done: Collection[str], withdrawn: Collection[str] = ()) -> None:
    """Write the index of a batch again if it lists some of the samples that were now done."""
    listed = sample_index.listed(out)
    if listed is not None:
        listed |= set(withdrawn)
    if listed is None or listed.isdisjoint(done):
        return
    path, *_ = _written(out, Ledger(out).records(listed))
    note(f"{path}: written again, as it lists samples that were done now")
    _followed(out)


def _there(out: Path, records: Iterable[Record]) -> Iterator[Record]:
    """The records of samples whose files are all in OUT; how many are not is said."""
    folder, gone = Folder(out), list[str]()
    for name, mine in groupby(records, lambda record: record.sample_id):
        every = [*mine]
        files = ((kind, s.path) for r in every if r.taken for kind, s in r.outputs.items())
        if all(folder.status(path) for kind, path in files if kind in KINDS):
            yield from every
        else:
            gone.append(name)
    if gone:
        problem = f"lacks files of {counted(len(gone), 'sample')}, like {gone[0]}"
        note(f"{out}: warning: {problem}; they are not listed, and 'defocus batch' does them again")


def _written(out: Path, records: Iterable[Record]) -> list[Path]:
    """Write the index, the list of each split, and last the card, which tells that all is whole."""
    before, lists = card.read(out).get("splits", {}), sample_index.SplitLists()
    hashed = blake2b(digest_size=sample_index.DIGEST)
    with written_whole(out / sample_index.NAME) as file:

        def see(entry: Mapping[str, Any]) -> None:
            line = sample_index.line(entry)
            file.write(line)
            hashed.update(line)
            lists.look_at(entry)

        summary = card.card_of(records, origin_of(out), see)
    sample_index.remove_splits(out, before.keys() - summary["splits"].keys())
    paths = [out / sample_index.NAME, *lists.write(out)]
    return paths + card.write(out, summary, lists.configs(), hashed.hexdigest())


def _is_true(out: Path, names: Collection[str]) -> bool:
    """Whether the index of OUT is of these samples, and as it was written with its card."""
    told = card.read(out)
    if not told or told.get("origin") != origin_of(out).said:
        return False
    with suppress(OSError), Folder(out).open(sample_index.NAME) as index:
        is_whole = sample_index.digest(index) == told.get("index_blake2b")
        lists = [out / sample_index.list_name(split) for split in told["splits"]]
        return is_whole and all(map(Path.exists, lists)) and sample_index.listed(out) == {*names}
    return False


def _followed(out: Path) -> list[Path]:
    """Pack existing shards again if samples changed, so that they hold what the index lists."""
    if not tar_shards.exist(out):
        return []
    folder, before = out / tar_shards.FOLDER, tar_shards.listed(out)
    if before is None:
        problem = f"may hold other samples than {sample_index.NAME}"
        note(f"{folder}: warning: {problem}; ‹shards-size› packs them again")
        return []
    written = tar_shards.write(out, before.limit)
    if tar_shards.listed(out) != before:
        note(f"{folder}: packed again, as samples changed; remove it if it is not wanted")
    return written


def _tell_of_others(out: Path, others: Collection[str]) -> None:
    if others:
        problem = f"lists none of {counted(len(others), 'sample')} that were not asked for now"
        remedy = f"'defocus merge {out}' lists all"
        note(f"{out / sample_index.NAME}: {problem}, like {min(others)}; {remedy}")

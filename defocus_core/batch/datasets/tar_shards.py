"""WebDataset shards of a finished batch: tar files ``OUT/shards/samples-000000.tar`` and so on.

A split has shards of its own, like ``trainset-000000.tar``. A sample is stored as
``<key>.<kind>.<ext>`` for each output and ``<key>.json`` for its metadata, with hashes of the
outputs. The key is the sample_id with dots replaced by ``_``, as readers of such files split names
at the first dot. Samples are sorted by name, or shuffled if ``[dataset]`` has a seed ``shuffle``.
The bytes of a shard depend on its samples alone. A shard that already holds the right samples is
not written again.
"""

from __future__ import annotations

import io
import json
import re
import tarfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import blake2b
from itertools import accumulate, groupby, islice
from operator import itemgetter
from pathlib import Path

from defocus_core.batch.datasets import sample_index
from defocus_core.batch.journal.runs import SHARDS_FOLDER
from defocus_core.errors import InputError, reason
from defocus_core.io.write_files import Folder, written_whole
from defocus_core.request.origin import origin_of

FOLDER = SHARDS_FOLDER
_LONGEST_LINE = 2**24  # bytes of the index
_END = 2 * tarfile.BLOCKSIZE  # bytes at the end of a tar
_NAME = re.compile(r"(?:samples|\w+set)-\d{6,}\.tar", re.ASCII)


@dataclass(frozen=True)
class ShardSample:
    """A sample to store in a tar: its key, its metadata as JSON, and path and size of each file.

    Files are named by what follows the key in the tar, like ``render.exr``.
    """

    key: str
    split: str  # empty for none
    line: bytes
    files: Mapping[str, tuple[str, int]]

    def pack(self, out: Path, tar: tarfile.TarFile) -> None:
        """Add the files of the sample to a tar, sorted by name, without their times and owners."""
        below = Folder(out)
        for end in sorted([*self.files, "json"]):
            data = self.line
            if end in self.files:
                path, _ = self.files[end]
                with _told(out / path):
                    data = below.read(path)
            tar.addfile(_header(f"{self.key}.{end}", len(data)), io.BytesIO(data))

    @property
    def packed(self) -> int:
        """The bytes that the sample takes in a tar."""
        sizes = {"json": len(self.line)} | {end: size for end, (_, size) in self.files.items()}
        headers = (_header(f"{self.key}.{end}", size) for end, size in sizes.items())
        named = sum(len(header.tobuf(tarfile.PAX_FORMAT)) for header in headers)
        return named + sum(_rounded(size, tarfile.BLOCKSIZE) for size in sizes.values())


def _header(name: str, size: int) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.size, info.mode = size, 0o644
    return info


def write(out: Path, limit: int) -> list[Path]:
    """Write the samples in the index in `out` to tar files; returns their paths.

    A tar has at most ``limit`` bytes, unless a single sample is larger. Older shards are removed.
    """
    below, kept = Folder(out), list[str]()
    for name, samples in _shards(_samples(out), limit):
        if _lines(below, f"{FOLDER}/{name}") != [sample.line for sample in samples]:
            with (
                written_whole(out / FOLDER / name, out) as file,
                tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as tar,
            ):
                for sample in samples:
                    sample.pack(out, tar)
        kept.append(name)
    for name in {*filter(_NAME.fullmatch, below.names(FOLDER))}.difference(kept):
        below.remove(f"{FOLDER}/{name}")
    return [out / FOLDER / name for name in kept]


def _lines(below: Folder, name: str, maximum: int | None = None) -> list[bytes] | None:
    """The JSON of the first `maximum` samples in a tar, or of all.

    None if the file is missing, truncated or not a tar.
    """
    with (
        suppress(OSError, tarfile.TarError),
        below.open(name) as file,
        tarfile.open(fileobj=file, mode="r:") as tar,
    ):
        members = (one for one in tar if one.isreg() and one.name.endswith(".json"))
        told = (tar.extractfile(one) for one in islice(members, maximum))
        return [line.read(_LONGEST_LINE) for line in told if line is not None]
    return None


def exist(out: Path) -> bool:
    """Whether there are shards in `out`."""
    with suppress(OSError):
        return any(map(_NAME.fullmatch, Folder(out).names(FOLDER)))
    return False


def foreign(out: Path) -> str | None:
    """The path of a tar that has the name of a shard but was not written by a batch, or None."""
    for name in filter(_NAME.fullmatch, Folder(out).names(FOLDER)):
        lines = _lines(Folder(out), f"{FOLDER}/{name}", 1)
        if not lines or not sample_index.is_own_line(lines[0]):
            return f"{FOLDER}/{name}"
    return None


def _samples(out: Path) -> Iterator[ShardSample]:
    """The samples in the index, one split after another, each sorted by name or shuffled."""
    shuffle = origin_of(out).shuffle
    with Folder(out).open(sample_index.NAME) as index:
        begins = [0, *accumulate(len(line) for line in index)]
        index.seek(0)
        named = [(entry["split"] or "", entry["sample_id"]) for entry in map(json.loads, index)]
        keys = keys_of([name for _, name in named], out)
        places = [(split, k, at) for (split, _), k, at in zip(named, keys, begins, strict=False)]
        if shuffle is not None:
            places.sort(key=lambda each: blake2b(f"{shuffle} {each[1]}".encode()).digest())
        for split, key, begin in sorted(places, key=itemgetter(0)):
            index.seek(begin)
            entry = json.loads(index.readline())
            outputs = entry["outputs"].items()
            paths = {f"{kind}{Path(path).suffix}": path for kind, path in outputs}
            files = {end: (path, _size(out, path)) for end, path in paths.items()}
            yield ShardSample(key, split, sample_index.tar_line(entry), files)


def keys_of(names: Sequence[str], out: Path) -> list[str]:
    """The key of each sample in tars: its name with ``_`` for dots; refuses equal keys."""
    keys = [name.replace(".", "_") for name in names]
    if len({*keys}) < len(keys):
        key = Counter(keys).most_common(1)[0][0]
        both = " and ".join(name for name in names if name.replace(".", "_") == key)
        problem = f"has samples that tars cannot tell apart: {both}"
        raise InputError("duplicate", problem, "rename the pictures of one", path=out)
    return keys


def _shards(samples: Iterable[ShardSample], limit: int) -> Iterator[tuple[str, list[ShardSample]]]:
    """Divide samples into shards of at most `limit` bytes; yields file name and samples of each."""
    for split, mine in groupby(samples, lambda sample: sample.split):
        # "train" between two separators would tell `datasets` that the folder has only that split.
        prefix = f"{split}set" if split else "samples"
        shard, size, number = list[ShardSample](), _END, 0
        for sample in mine:
            if shard and _rounded(size + sample.packed, tarfile.RECORDSIZE) > limit:
                yield f"{prefix}-{number:06}.tar", shard
                shard, size, number = [], _END, number + 1
            shard.append(sample)
            size += sample.packed
        yield f"{prefix}-{number:06}.tar", shard


def _size(out: Path, name: str) -> int:
    with _told(out / name):
        return Folder(out).path(name).lstat().st_size


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn an OSError, as of a missing file, into an InputError that names the file to pack."""
    try:
        yield
    except OSError as error:
        problem = f"cannot be packed: {reason(error)}"
        remedy = "render the batch again"
        raise InputError("unreadable", problem, remedy, path=path) from None


def _rounded(size: int, block: int) -> int:
    return -(-size // block) * block

"""WebDataset shards of a finished batch: ``OUT/shards/samples-000000.tar``, ….

Of a dataset with splits each has shards of its own, ``trainset-000000.tar``, …. Each sample is
``<key>.<kind>.<ext>`` for each of its outputs, and ``<key>.json``, its line of the index. The key
is the sample_id with _ for each dot, as readers of such tars cut at the first one. The same samples
make the same bytes. ``shards.json`` beside them lists the shards, and the size they were packed
for; a shard that is as listed is not packed again. Samples are sorted by name, or shuffled by the
seed ``shuffle`` of ``[dataset]``.
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
from pathlib import Path
from stat import S_ISREG
from typing import BinaryIO

from defocus_core.batch.datasets import sample_index
from defocus_core.batch.datasets.sample_index import Record
from defocus_core.batch.jobs.origin import origin_of
from defocus_core.batch.journal.run_file import SHARDS_FOLDER
from defocus_core.errors import InputError, reason
from defocus_core.io.below import Folder
from defocus_core.io.safe_files import written_whole

FOLDER = SHARDS_FOLDER
LIST = "shards.json"
_NAME = re.compile(r"(?:samples|\w+set)-\d{6,}\.tar", re.ASCII)


@dataclass(frozen=True)
class Member:
    """A file of a shard: one of OUT's by its name below OUT, or a few bytes."""

    name: str
    size: int
    source: str | bytes

    @property
    def info(self) -> tarfile.TarInfo:
        """Its header: no time, no owner."""
        info = tarfile.TarInfo(self.name)
        info.size = self.size
        info.mode = 0o644
        return info

    @property
    def packed(self) -> int:
        """Bytes that it takes in a tar."""
        header = len(self.info.tobuf(tarfile.PAX_FORMAT))
        return header + _rounded(self.size, tarfile.BLOCKSIZE)


@dataclass(frozen=True)
class ShardSample:
    """The files of a sample, and its split, empty for none."""

    split: str
    members: tuple[Member, ...]


@dataclass(frozen=True)
class Listing:
    """The list of shards: greatest size of a tar, and bytes of each by its name and digest."""

    limit: int
    sizes: Mapping[tuple[str, str], int]


def write(out: Path, records: Iterable[Record], limit: int) -> list[Path]:
    """Pack the samples that are done into tars of at most ``limit`` bytes.

    A sample larger than that gets a tar to itself. Tars of an earlier batch that are no longer
    needed are removed.

    `limit`: bytes.
    """
    folder = out / FOLDER
    before = listed(out)
    sizes = before.sizes if before else {}
    packed = []
    for name, samples in _shards(_samples(out, records), limit):
        path = folder / f"{name}.tar"
        digest = _digest(samples)
        if not _has_size(out, path.name, sizes.get((path.name, digest))):
            _pack(out, path, samples)
        size = _size(out, f"{FOLDER}/{path.name}")
        one = {"file": path.name, "samples": len(samples), "bytes": size, "digest": digest}
        packed.append(one)
    with written_whole(folder / LIST, out) as file:
        listing = {"limit": limit, "shards": packed}
        file.write(json.dumps(listing, indent=1).encode() + b"\n")
    kept = [folder / str(one["file"]) for one in packed]
    below = Folder(out)
    for name in set(below.names(FOLDER)) - {path.name for path in kept}:
        if _NAME.fullmatch(name):
            below.remove(f"{FOLDER}/{name}")
    return kept


def exist(out: Path) -> bool:
    """Whether shards exist in OUT."""
    with suppress(OSError):
        return any(map(_NAME.fullmatch, Folder(out).names(FOLDER)))
    return False


def listed(out: Path) -> Listing | None:
    """The list of shards in OUT; None where it is missing or broken."""
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        listing = json.loads(Folder(out).read(f"{FOLDER}/{LIST}"))
        sizes = {(one["file"], one["digest"]): one["bytes"] for one in listing["shards"]}
        return Listing(int(listing["limit"]), sizes)
    return None


def _samples(out: Path, records: Iterable[Record]) -> Iterator[ShardSample]:
    origin = origin_of(out)
    entries = list(sample_index.entries(records, origin))
    named = list(zip(entries, _keys([entry["sample_id"] for entry in entries], out), strict=True))
    if origin.shuffle is not None:
        named.sort(key=lambda each: blake2b(f"{origin.shuffle} {each[1]}".encode()).digest())
    for entry, key in named:
        members = [
            Member(f"{key}.{kind}{Path(path).suffix}", _size(out, path), path)
            for kind, path in entry["outputs"].items()
        ]
        line = sample_index.line(entry)
        every = sorted([*members, Member(f"{key}.json", len(line), line)], key=_name)
        yield ShardSample(entry["split"] or "", tuple(every))


def _keys(names: Sequence[str], out: Path) -> list[str]:
    """A key without dots for each sample."""
    keys = [name.replace(".", "_") for name in names]
    if len({*keys}) < len(keys):
        key = Counter(keys).most_common(1)[0][0]
        both = " and ".join(name for name in names if name.replace(".", "_") == key)
        problem = f"has samples that tars cannot tell apart: {both}"
        raise InputError("duplicate", problem, "rename the pictures of one", path=out)
    return keys


def _shards(samples: Iterable[ShardSample], limit: int) -> Iterator[tuple[str, list[ShardSample]]]:
    """The name and the samples of each shard: as many of a split as fit."""
    by_split: dict[str, list[ShardSample]] = {}
    for sample in samples:
        by_split.setdefault(sample.split, []).append(sample)
    for split in sorted(by_split):
        # "train" between two signs would tell `datasets` that the folder has that split alone.
        prefix = f"{split}set" if split else "samples"
        for number, shard in enumerate(_filled(by_split[split], limit)):
            yield f"{prefix}-{number:06}", shard


def _filled(samples: Iterable[ShardSample], limit: int) -> Iterator[list[ShardSample]]:
    """As many samples in each as fit."""
    shard: list[ShardSample] = []
    size = 0
    for sample in samples:
        more = sum(member.packed for member in sample.members)
        if shard and _closed(size + more) > limit:
            yield shard
            shard, size = [], 0
        shard.append(sample)
        size += more
    if shard:
        yield shard


def _pack(out: Path, path: Path, samples: Iterable[ShardSample]) -> None:
    with (
        written_whole(path, out) as file,
        tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as tar,
    ):
        for member in (member for sample in samples for member in sample.members):
            with _opened(out, member.source) as content:
                try:
                    tar.addfile(member.info, content)
                except (tarfile.TarError, OSError) as error:
                    if getattr(error, "errno", None) is not None:  # the tar cannot be written
                        raise
                    problem = f"changed while it was packed: {reason(error)}"
                    raise InputError(
                        "changed", problem, "pack it again", path=out / str(member.source)
                    ) from None


@contextmanager
def _opened(out: Path, source: str | bytes) -> Iterator[BinaryIO]:
    if isinstance(source, bytes):
        yield io.BytesIO(source)
        return
    try:
        file = Folder(out).open(source)
    except OSError as error:
        raise _gone(out / source, error) from None
    with file:
        yield file


def _digest(samples: Iterable[ShardSample]) -> str:
    """The hash of a shard: names and sizes, and the JSON, which has the hashes of the files."""
    digest = blake2b(digest_size=16)
    for member in (member for sample in samples for member in sample.members):
        digest.update(f"{member.name}\0{member.size}\0".encode("utf-8", "surrogateescape"))
        if isinstance(member.source, bytes):
            digest.update(member.source)
    return digest.hexdigest()


def _has_size(out: Path, name: str, size: object) -> bool:
    with suppress(OSError):  # who packs it says what is in the way
        status = Folder(out).status(f"{FOLDER}/{name}")
        return status is not None and S_ISREG(status.st_mode) and status.st_size == size
    return False


def _size(out: Path, name: str) -> int:
    path = out / name
    try:
        return Folder(out).path(name).lstat().st_size
    except OSError as error:
        if path.is_symlink():  # which may lead to any file of this machine
            problem, remedy = "is a symbolic link, not an output", "put the file itself there"
            raise InputError("link", problem, remedy, path=path) from None
        raise _gone(path, error) from None


def _gone(path: Path, error: OSError) -> InputError:
    problem = f"cannot be packed: {reason(error)}"
    return InputError("unreadable", problem, "render the batch again", path=path)


def _name(member: Member) -> str:
    return member.name


def _rounded(size: int, block: int) -> int:
    return -(-size // block) * block


def _closed(size: int) -> int:
    """Bytes of a tar whose members take ``size``."""
    return _rounded(size + 2 * tarfile.BLOCKSIZE, tarfile.RECORDSIZE)

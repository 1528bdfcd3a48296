"""A finished batch as a torch dataset, with pictures, maps and lenses as tensors."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from defocus_core.batch.datasets.finished import SampleList
from defocus_core.errors import InputError, UsageProblem, did_you_mean
from defocus_core.io.exr.header import is_exr
from defocus_core.io.exr.reading import read_parts
from defocus_core.io.images.color import read_color
from defocus_core.io.images.raster import read_samples
from defocus_core.io.picture_files import as_file
from defocus_core.io.read_files import read_head
from defocus_core.request.output_kinds import KINDS

Item = dict[str, Any]


class BatchDataset(Dataset[Item]):
    """The samples of a finished batch, for `torch.utils.data.DataLoader` with or without workers.

    An item is a dictionary with these keys:

      <kind>        float32 [C, H, W] for each kind: pictures in scene-linear light, maps in their
                    own units, such as px for coc
      lens          scalar tensors fnum; foclen and sensor_width in mm, the latter of the crop; and
                    focus_dioptres in 1/m, 0 at infinity; NaN if the batch read files of radii
      place         int64 [4]: top row, left column, height and width of the crop in px
      sample_id     name of the sample

    To shuffle, use ``DataLoader(…, shuffle=True, generator=…)``. Crops depend on seed, epoch and
    index, but not on the process.
    """

    def __init__(
        self,
        out: str | os.PathLike[str],
        kinds: Sequence[str] = ("render",),
        *,
        split: str | None = None,
        crop: int | tuple[int, int] | None = None,
        seed: int = 0,
        transform: Callable[[Item], Any] | None = None,
    ) -> None:
        """Read the index of a finished batch.

        Args:
            out: The output folder of the batch.
            kinds: Kinds of output, like render, left, right or coc; also image and depth if the
                batch has ``inputs = "copy"``; and labels (files copied along), whose numbers stay
                as they are.
            split: Name of a split; None for all samples.
            crop: Height and width in px of a random crop, or one number for a square. None for
                whole pictures, which a loader can only batch if all have the same size.
            seed: Seed of the random crops.
            transform: Function that is applied to each item after the crop.

        Raises:
            InputError: There is no index, no sample of the split has all of the kinds, or a sample
                is smaller than the crop.
            UsageProblem: A kind is unknown.
        """
        self.kinds, self.seed, self.transform = tuple(kinds), seed, transform
        self.crop = (crop, crop) if isinstance(crop, int) else crop
        kinds_there, splits = set[str](), set[str]()

        def is_wanted(entry: Mapping[str, Any]) -> bool:
            kinds_there.update(entry["outputs"])
            splits.add(str(entry.get("split")))
            found = entry["outputs"].keys() >= {*self.kinds} and split in (None, entry.get("split"))
            if found and self.crop is not None:
                _require_room(Path(out), entry, self.crop)
            return found

        self.samples = SampleList(Path(out), is_wanted)
        known = kinds_there | KINDS.keys()
        for kind in {*kinds} - known:
            remedy = did_you_mean(kind, tuple(known), f"choose from {', '.join(sorted(known))}")
            raise UsageProblem("unknown-name", f"{kind!r} is not a kind", remedy, field="kinds")
        if not len(self.samples):
            of_split, there = f" in split {split}" if split else "", ", ".join(sorted(kinds_there))
            problem = f"has no sample of {', '.join(kinds)}{of_split}"
            remedy = f"it has {there}, in splits {', '.join(sorted(splits))}"
            raise InputError("empty", problem, remedy, path=Path(out))
        # Counts of accesses of each sample in this epoch, shared by processes of a loader, also
        # persistent ones; then the epoch, -1 if not set.
        self._times_read = torch.zeros(len(self.samples) + 1, dtype=torch.int64)
        self._times_read[-1] = -1
        self._times_read.share_memory_()  # type: ignore[no-untyped-call]
        self._rank = 0

    def set_epoch(self, epoch: int) -> None:
        """Set the epoch, from 0, so that its crops are the same in every process.

        If it is not set, every access of a sample draws a new crop, different in each process of
        distributed training.
        """
        self._times_read[:-1] = 0
        self._times_read[-1] = epoch

    def __getstate__(self) -> dict[str, Any]:
        """The state to pickle, with the distributed rank, which loader processes do not know."""
        return self.__dict__ | {"_rank": self._rank or _rank()}

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: int) -> Any:
        """The item of a sample, cropped and transformed.

        Raises:
            InputError: A file cannot be read, or its size differs from that in the index.
            IndexError: There is no sample of this index.
        """
        sample = self.samples[index]
        width, height = sample.size
        rows, columns = slice(0, height), slice(0, width)
        if self.crop is not None:
            rows, columns = self._drawn(index, (height, width), self.crop)
        item: Item = {}
        for kind in self.kinds:
            path = sample.files[kind]
            planes = _planes(path, kind)
            if (own := planes.shape[1:]) != (height, width):
                problem = f"is {own[1]}x{own[0]} px, in the index {width}x{height}"
                remedy = "let the batch write it again"
                raise InputError("wrong-size", problem, remedy, path=path)
            item[kind] = torch.from_numpy(np.ascontiguousarray(planes[:, rows, columns]))
        place = rows.start, columns.start, rows.stop - rows.start, columns.stop - columns.start
        item |= {"lens": _lens(sample.record["lens"], place[3] / width)}
        item |= {"place": torch.tensor(place), "sample_id": sample.sample_id}
        return item if self.transform is None else self.transform(item)

    def _drawn(
        self, index: int, size: tuple[int, int], crop: tuple[int, int]
    ) -> tuple[slice, slice]:
        """Draw rows and columns of a random crop; `size` and `crop` are (height, width) in px."""
        index = range(len(self))[index]
        epoch, times = int(self._times_read[-1]), int(self._times_read[index])
        self._times_read[index] += 1
        rank = 0 if epoch >= 0 and not times else self._rank or _rank()
        draw = np.random.default_rng((self.seed, max(epoch, 0) + times, index, rank))
        sides = zip(size, crop, strict=True)
        starts = [int(draw.integers(0, room - side + 1)) for room, side in sides]
        rows, columns = (slice(s, s + side) for s, side in zip(starts, crop, strict=True))
        return rows, columns


def _rank() -> int:
    """The rank of this process in distributed training; else 0."""
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        return torch.distributed.get_rank()
    return int(os.environ.get("RANK", 0))


def _require_room(out: Path, entry: Mapping[str, Any], crop: tuple[int, int]) -> None:
    width, height = entry["width"], entry["height"]
    if height < crop[0] or width < crop[1]:
        problem = f"is {width}x{height} px, smaller than the crop {crop[1]}x{crop[0]}"
        path = out / next(iter(entry["outputs"].values()))
        raise InputError("wrong-size", problem, "take smaller crops", path=path, field="crop")


def _planes(path: Path, kind: str) -> Any:
    """Read an output as [C, H, W], float32; labels that are integers as int32."""
    row = KINDS.get(kind)
    if row is not None and row.image:
        views = [read_color(path, view=view).pixels for view in row.views or [None]]
        return np.concatenate(views, axis=2).transpose(2, 0, 1)
    if is_exr(read_head(path)):
        channels = read_parts(path)[0].channels
        names = channels if row is None else [row.channel or kind]
        return np.stack([channels[name] for name in names], dtype=np.float32)
    samples = read_samples(path).transpose(2, 0, 1)
    if row is not None:
        return samples[:1].astype(np.float32)
    return samples.astype(np.int32 if samples.dtype.kind == "u" else np.float32)


# Keys of the lens in an item and in the index; null with a file of radii.
_NUMBERS = {
    "fnum": "fnumber",
    "foclen": "focal_length_mm",
    "sensor_width": "sensor_width_mm",
    "focus_dioptres": "focus_dioptres",
}


def _lens(told: Mapping[str, float | None], fraction: float = 1.0) -> dict[str, Tensor]:
    """The lens as scalar tensors, from an index entry; the sensor width is scaled by `fraction`."""
    values = {name: math.nan if (v := told[key]) is None else v for name, key in _NUMBERS.items()}
    values["sensor_width"] *= fraction
    return {name: torch.tensor(float(value)) for name, value in values.items()}


def decode_sample(sample: Mapping[str, Any]) -> Item:
    """Decode a sample of a shard to an item like those of `BatchDataset`, without a crop.

    Args:
        sample: The bytes of each file by its ending, like ``render.png`` and ``json``, as given by
            `webdataset`, or by `datasets` without decoding of images. Other keys are ignored.

    Raises:
        InputError: A file cannot be read.
    """
    entry = sample["json"]
    entry = json.loads(entry) if isinstance(entry, bytes) else entry
    item: Item = {"lens": _lens(entry["lens"]), "sample_id": entry["sample_id"]}
    for name, data in sample.items():
        kind = name.partition(".")[0]
        if kind in entry["blake2b"]:
            with as_file(data["bytes"] if isinstance(data, Mapping) else data) as path:
                item[kind] = torch.from_numpy(np.ascontiguousarray(_planes(path, kind)))
    return item

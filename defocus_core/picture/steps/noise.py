"""Images with the noise of a sensor, computed a few rows at a time while they are written."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.batch.jobs.job import Job
from defocus_core.batch.jobs.output_kinds import KINDS
from defocus_core.batch.lenses.lens import Lens
from defocus_core.io.arrays import LazyArray
from defocus_core.io.exr.writing import clamped_half

_SEED_BYTES = 5  # of a seed, of which rows of pictures make others


def noisy(
    planes: Sequence[Any], channels: Sequence[str], job: Job, lens: Lens, view: str
) -> tuple[Any, ...]:
    """The planes [H, W] of an image with the lens' noise, if it has any; alpha has none."""
    if lens.noise is None:
        return tuple(planes)
    electrons, read = lens.noise
    if KINDS[view].halves or KINDS[view].turned:
        electrons /= 2
    words = f"{lens.noise_seed} {job.picture.stem}{job.suffix} {view}"
    return tuple(
        plane if name == "A" else _noisy(plane, electrons, read, f"{words} {name}")
        for plane, name in zip(planes, channels, strict=True)
    )


def _noisy(plane: Any, electrons: float, read: float, words: str) -> LazyArray:
    """An array [H, W] with noise."""
    seed = int.from_bytes(blake2b(words.encode(), digest_size=_SEED_BYTES).digest())

    def read_rows(rows: slice) -> NDArray[Any]:
        import torch

        from defocus_core.optics.sensor_noise import with_noise

        values = np.asarray(plane[rows])
        light = torch.from_numpy(values.astype("float32"))[None]
        first = rows.indices(plane.shape[0])[0]
        noise = with_noise(light, electrons=electrons, read=read, seed=seed, first_row=first)
        noisy: NDArray[Any] = noise[0].numpy()
        return clamped_half(noisy)[0] if values.dtype == np.float16 else noisy

    return LazyArray(plane.shape, plane.dtype, read_rows)

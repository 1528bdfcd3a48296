"""Images with the noise of a sensor, computed a few rows at a time while they are written."""

from __future__ import annotations

from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.arrays import LazyArray
from defocus_core.io.exr.writing import clamped_half
from defocus_core.picture.write import Contents
from defocus_core.request.output_kinds import KINDS

_SEED_BYTES = 5  # of a seed, of which rows of pictures make others


def write(contents: Contents) -> Contents:
    """The rendered planes with the lens' noise; alpha has none."""
    lens, job, kind = contents.take.lens, contents.take.job, contents.kind
    assert lens.noise is not None
    electrons, read = lens.noise
    channels = contents.take.inputs.color.channels
    planes = []
    for number, plane in enumerate(contents.planes):
        view, name = kind.rendered_as[number // len(channels)], channels[number % len(channels)]
        light = electrons / 2 if KINDS[view].halves else electrons
        words = f"{lens.noise_seed} {job.picture.stem}{job.suffix} {view} {name}"
        planes.append(plane if name == "A" else _noisy(plane, light, read, words))
    return contents._replace(planes=tuple(planes))


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

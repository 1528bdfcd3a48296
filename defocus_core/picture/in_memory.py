"""Pictures in memory."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.depth_formats.depth import Depth, depth_of, require_valid
from defocus_core.io.depth_formats.reading import DepthNumbers
from defocus_core.io.images.color import Color, require_finite
from defocus_core.io.images.color_space import linear_light, unit
from defocus_core.io.images.raster import PLAIN_CHANNELS
from defocus_core.picture.steps.table import PAIR, apply_steps
from defocus_core.picture.take import Arrays, InputPair, Inputs
from defocus_core.request.job import Job
from defocus_core.system import memory


def of_arrays(job: Job, arrays: Arrays) -> Inputs:
    """The inputs of a picture in memory.

    Integers of colour are sRGB, floats linear light; the reading interprets depth.
    """
    color, depth = _pair(job, arrays.color, arrays.depth)
    hidden = None if arrays.hidden is None else _pair(job, *arrays.hidden)
    if hidden is not None and hidden[0].shape != color.shape:
        raise ValueError(f"hidden must be shaped as the picture {list(arrays.color.shape)}")
    size, matte = depth.metres.shape, arrays.matte
    if matte is not None:
        matte = unit(matte) if matte.dtype.kind == "u" else np.asarray(matte, np.float32)
        if matte.shape != size or not ((matte >= 0) & (matte <= 1)).all():
            raise ValueError(f"matte must be {list(size)} in 0 to 1, got {list(matte.shape)}")
    held = sum(plane.nbytes for plane in (*color.planes, depth.metres)) / memory.MB
    held *= 1 + (hidden is not None) + len(job.outputs.kinds)
    said = (*color.warnings, *depth.warnings)
    return Inputs(held, color, depth, hidden, matte=matte, empty=depth.empty, warnings=said)


def _pair(job: Job, color: NDArray[Any], depth: NDArray[Any]) -> tuple[Color, Depth]:
    """The colour and the depth of arrays."""
    if color.ndim not in (2, 3) or depth.ndim != 2 or not color.size or not depth.size:
        got = f"{list(color.shape)} and {list(depth.shape)}"
        raise ValueError(f"color must be [H, W, C] and depth [H, W], got {got}")
    pixels = color if color.ndim == 3 else color[:, :, None]
    channels = PLAIN_CHANNELS.get(pixels.shape[2])
    if channels is None or pixels.dtype.kind == "i" or pixels.dtype.itemsize > 8:
        problem = f"is of {pixels.shape[2]} channels of {pixels.dtype}"
        remedy = "give 1 to 4 channels of floats, uint8 or uint16"
        raise InputError("wrong-type", problem, remedy, path=job.picture.color)
    alpha = unit(pixels[:, :, -1:]) if channels[-1] == "A" else None
    whole = pixels.dtype.kind == "u"
    if whole:
        light = linear_light(pixels[:, :, : len(channels) - (alpha is not None)], alpha, gamma=None)
        pixels = light if alpha is None else np.concatenate([light, alpha], axis=2)
    planes = tuple(np.ascontiguousarray(np.moveaxis(pixels, 2, 0), np.float32))
    note = f"{color.dtype} in memory, {'sRGB' if whole else 'linear'}"
    kind = "NPY" if depth.dtype.kind == "f" else "integer NPY"
    numbers = DepthNumbers(job.picture.depth, depth, kind, f"{depth.dtype} in memory")
    decoded = (
        Color(planes, tuple(channels), job.picture.color, note=note, within_white=whole),
        depth_of(numbers, job.reading, lens_focal=job.lens_focal),
    )
    pair = apply_steps(PAIR, replace(InputPair.from_job(job), planes=decoded))
    require_valid(pair.depth)
    require_finite(pair.color)
    return pair.color, pair.depth

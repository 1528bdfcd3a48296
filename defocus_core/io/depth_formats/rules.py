"""Depth formats as data: numbers of a file, the fields of a row, and functions that decode by them.

Four kinds of rule are enough for every row. Numbers v of the file become
  scale     depth  scale · v + shift
  inverse   depth  focal · baseline / (scale · v + shift), or 1 / (scale · v + shift)
  log       depth  exp(scale · v + shift)
  bits      numbers v first: float32 in the four bytes of a pixel, float16 in 16 bits, or an integer
            spread over R, G and B; then one of the above
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.arrays import Keeping, bands
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan

# Alpha of an edge whose numbers tell if they were multiplied, and of the whole pixel beside it.
_EDGE, _WHOLE = (0.05, 0.9), 0.995
# Edge pixels that are enough to judge by, and the share of them that must look multiplied.
_ENOUGH, _MAXIMUM = 12, 0.8


class Mark(NamedTuple):
    """Pixels whose depth another channel, array or file says."""

    pixels: NDArray[np.bool_]  # [H, W]
    depth: float  # inf is sky, NaN no depth
    words: str  # for people; empty if they need not know


@dataclass(frozen=True)
class DepthNumbers:
    """The numbers of a depth file."""

    # [H, W], or [H, W, C] of pixels that are bits; of the type they have in the file, an array
    # or something else that rows can be cut from
    values: Any
    type: str  # of the file and its numbers, as the rows of the table have it
    words: str  # type of the file and of its numbers, for people
    channel: str = ""  # name in the file; empty where it has none
    metadata: Mapping[str, Any] = field(default_factory=dict)  # of the file, by key
    marks: tuple[Mark, ...] = ()  # in order: a later one wins
    data_window: str = ""  # its data window in words, if it does not cover the picture
    is_deep: bool = False  # whether they are those of the nearest samples of deep pixels

    @property
    def width(self) -> int:
        """Of the map in px."""
        return int(self.values.shape[1])

    @property
    def top(self) -> float:
        """The greatest number of the type: 255, 65535, …; 1 of floats."""
        dtype = np.dtype(self.values.dtype)
        return 1.0 if dtype.kind == "f" else float(np.iinfo(dtype).max)

    @property
    def is_of_nuke(self) -> bool:
        """Whether the header says that Nuke wrote it."""
        return any(name.startswith("nuke/") for name in self.metadata)

    @property
    def is_integer(self) -> bool:
        """Whether the numbers are integers."""
        return self.values.dtype.kind in "iu"


def divided(path: Path, values: Any, alpha: Any, how: str, keeping: Keeping) -> tuple[Any, str]:
    """The numbers of a depth file without the alpha in them, and what was done, in words.

    `values`: its numbers [H, W]; `alpha`: [H, W] of the colour; None if it has none.
    """
    usable = alpha is not None and tuple(alpha.shape) == tuple(values.shape[:2])
    if how == "on" and not usable:
        problem = "cannot be divided by alpha: the colour has no alpha of its size"
        raise InputError("no-such-channel", problem, "leave ‹unpremultiply-depth› out", path=path)
    if not usable or how == "off" or (how == "auto" and not _is_multiplied(values, alpha)):
        return values, ""
    result = keeping.new(tuple(values.shape), np.float32)
    for rows in bands(values.shape):
        fraction = np.asarray(alpha[rows], np.float32)
        numbers = np.asarray(values[rows], np.float32)
        result[rows] = np.divide(numbers, fraction, out=numbers.copy(), where=fraction > 0)
    return result, "divided by alpha"


def _is_multiplied(values: Any, alpha: Any) -> bool:
    """Whether edges have the depth beside them times alpha, and not the depth itself."""
    multiplied = plain = 0
    for fraction, numbers in _overlapping(alpha, values):
        edge = (fraction > _EDGE[0]) & (fraction < _EDGE[1])
        if not edge.any():
            continue
        whole = (fraction >= _WHOLE) & np.isfinite(numbers) & (numbers > 0)
        for step in (1, 2):
            for axis in (0, 1):
                for away in (-step, step):
                    at = edge & np.roll(whole, away, axis)
                    beside, own = np.roll(numbers, away, axis)[at], numbers[at]
                    times = fraction[at] * beside
                    nearer = np.abs(own - times) < np.abs(own - beside)
                    multiplied += int(np.count_nonzero(nearer & (own > 0)))
                    plain += int(np.count_nonzero(~nearer & (own > 0)))
    return multiplied >= _ENOUGH and multiplied > _MAXIMUM * (multiplied + plain)


def _overlapping(*arrays: Any) -> Iterator[list[NDArray[np.float32]]]:
    """Bands of arrays [H, W], each with two rows of the next."""
    for rows in bands(arrays[0].shape):
        wide = slice(rows.start, rows.stop + 2)
        yield [np.asarray(array[wide], np.float32) for array in arrays]


HALF_MAX = 65504.0  # the largest number that half can hold
SKY = 1e10  # Blender's far clip: numbers from this one on are sky in every format of depth
FLOATS = ("EXR", "PFM", "NPY", "NPZ", "float TIFF")
# R, G and B of it are equal, A is 1; a fault of its writer spoils what follows the dot.
UNREAL_DEPTH = tuple(
    f"FinalImage{writer}WorldDepth{end}"
    for writer in ("MovieRenderQueue_", "PW")
    for end in (".R", "*")
)
ANY = (*FLOATS, "16-bit PNG", "8-bit PNG", "8-bit RGB", "integer EXR", "integer NPY", "HDF5")


@dataclass(frozen=True)
class Mask:
    """An image or array beside the depth file that marks pixels without depth, or sky."""

    # Where it may lie, relative to the depth file's folder; ``{stem}`` is the stem of the depth
    # file, ``{folder}`` the name of its folder, ``{number}`` the last digits of the stem
    places: tuple[str, ...]
    zeros: bool = False  # whether it marks them by 0, or by any other number
    sky: int | None = None  # the number of the class that is sky; None if it marks no sky


@dataclass(frozen=True)
class DepthFormat:
    """A depth convention: a row of the table, which sidecar and user complete for a file."""

    name: str  # as ``depth_format`` has it
    title: str  # which data set, renderer or network writes it
    files: tuple[str, ...]  # types of file it may come in, as `DepthNumbers.type` has them
    # Scale, inverse, log, or radius, whose numbers are signed CoC radii in px; empty where
    # ``depth_kind`` must say whether they are depth or disparity
    rule: str = "scale"
    scale: float = 1.0  # what 1 in the file is: metres of depth, px of disparity
    shift: float = 0.0  # added to numbers that were scaled
    integer_scale: float | None = None  # what 1 is where the numbers are integers; None for `scale`
    per_metre: bool = False  # whether disparity is in 1/m rather than in px
    bits: str = ""  # ``float32`` or ``float16`` where the bits of a pixel are those of a float
    weights: tuple[float, ...] = ()  # of R, G and B, where a pixel is an integer spread over them
    # Names of EXR channels and of arrays in a container, patterns allowed, the first that is
    # there wins; empty for the usual names
    channels: tuple[str, ...] = ()
    holes: str = ""  # name of the array in the same file whose zeros are invalid
    radial_channels: tuple[str, ...] = ()  # which of these hold the distance to the point
    # Which entry of a last axis of several; of EXR channels in the order of the file
    plane: int | None = None
    axes: str = "HW"  # order of axes in the file, N for frames
    stride: int = 1  # every so many rows and columns are taken
    size: tuple[int, int] | None = None  # width and height of a file without a header
    geometry: str = "planar"  # planar, radial, or ask where the user must say it
    # Numbers that mean no depth, beside NaN and what is not in front of the camera
    invalid: tuple[float, ...] = ()
    invalid_infinity: bool = False  # whether +inf means no depth rather than sky
    # Numbers from this one on are sky; of a completed row, towards the far end
    sky: float = SKY
    sky_numbers: tuple[float, ...] = ()  # single numbers that are sky
    # Focal length in px of its pictures, where it is fixed; of a completed row, of this one
    focal_px: float | None = None
    # Width of the pictures that `focal_px` is of; None for any width
    focal_width: int | None = None
    baseline: float | None = None  # metres between its two cameras, where it is fixed
    sidecar: str = ""  # name of what else holds a part of the rule, as `sidecars` has it
    words: str = ""  # what completed the row, and in the end its rule, for people
    mask: Mask | None = None
    alpha: bool = False  # whether nothing is where the alpha of the EXR is 0
    needs: tuple[str, ...] = ()  # options without which it cannot be decoded
    unitless: bool = False  # whether its unit is that of a scene, so that ``depth_unit`` may say it
    note: str = ""  # what else a user should know
    aliases: tuple[str, ...] = field(default=())


def unpacked(samples: NDArray[Any], row: DepthFormat) -> NDArray[Any]:
    """Numbers [H, W] of the samples [H, W] or [H, W, C] of a file whose bits a row explains."""
    if row.weights:
        planes = samples[..., : len(row.weights)].astype(np.float64)
        numbers: NDArray[Any] = planes @ np.array(row.weights)
        return numbers
    if row.bits == "float32":  # OpenCV reads B, G, R, A: these are its bytes, little endian
        return np.ascontiguousarray(samples[..., [2, 1, 0, 3]]).view("<f4")[..., 0]
    if row.bits == "float16":
        return np.ascontiguousarray(samples.astype(np.uint16)).view(np.float16)
    return samples


def decoded(
    numbers: NDArray[Any],
    row: DepthFormat,
    *,
    first_row: int = 0,
    frame: tuple[int, int] | None = None,
    overscan: Overscan = NO_OVERSCAN,
) -> NDArray[np.float32]:
    """Planar metres of numbers [h, W] of a file: +inf is sky; NaN, 0 and less are invalid.

    `row`: completed; `frame`: rows and columns of the frame; None if `numbers` has all of them.
    """
    with np.errstate(over="ignore"):  # as below
        metres = _metres(numbers, row)
    if row.geometry == "radial":
        assert row.focal_px is not None
        rows, columns = overscan.shown(*(frame or numbers.shape[:2]))
        cosine = _cosine(
            metres.shape,
            row.focal_px,
            first=(first_row - rows.start, -columns.start),
            size=(rows.stop - rows.start, columns.stop - columns.start),
        )
        metres = (metres.astype(np.float64) * cosine).astype(np.float32)
    for marked, value in ((is_sky, np.inf), (is_marked_invalid, np.nan)):
        pixels = marked(numbers, row)
        if pixels is not None and pixels.any():
            metres = np.where(pixels, np.float32(value), metres)
    return metres


def is_sky(numbers: NDArray[Any], row: DepthFormat) -> NDArray[np.bool_] | None:
    """Which numbers stand for sky; None if none can."""
    if row.rule == "radius":
        return None
    falls = (row.scale < 0) != (row.rule == "inverse")  # the farther, the less
    with np.errstate(over="ignore"):  # a double beyond float32 is sky
        values, end = numbers.astype(np.float32, copy=False), np.float32(row.sky)
    sky: NDArray[np.bool_] = values <= end if falls else values >= end
    for number in row.sky_numbers:
        sky |= numbers == number
    return sky


def is_marked_invalid(numbers: NDArray[Any], row: DepthFormat) -> NDArray[np.bool_] | None:
    """Which numbers the format marks as invalid; None if none. NaN stays NaN by any rule."""
    marked = [numbers == number for number in row.invalid]
    if row.invalid_infinity:
        marked.append(np.isposinf(numbers))
    return np.logical_or.reduce(marked) if marked else None


def _metres(numbers: NDArray[Any], row: DepthFormat) -> NDArray[np.float32]:
    """Depth, or distance to the point, in metres."""
    plain = row.rule in ("scale", "radius") and (row.scale, row.shift) == (1, 0)
    if plain:
        return numbers.astype(np.float32, copy=False)
    scaled: NDArray[np.float64] = numbers.astype(np.float64) * row.scale
    if row.shift:
        scaled += row.shift
    if row.rule in ("scale", "radius"):
        return scaled.astype(np.float32)
    if row.rule == "log":
        return np.exp(scaled).astype(np.float32)
    # No point in front of both cameras has a negative disparity.
    with np.errstate(divide="ignore"):
        depth = np.where(scaled < 0, np.nan, 1 / np.abs(scaled))
    return depth.astype(np.float32)


def _cosine(
    shape: tuple[int, ...], focal_px: float, *, first: tuple[int, int], size: tuple[int, int]
) -> NDArray[np.float64]:
    """Depth along the axis by distance to the point, f / √(x² + y² + f²), at pixels [h, w].

    x and y are those of pixel centres from the middle of the frame: M. Roberts et al.: Hypersim,
    2021 (issue 9 of its code).

    `focal_px`: focal length in px.
    """
    y, x = (
        np.arange(start, start + count) - (length - 1) / 2
        for start, count, length in zip(first, shape, size, strict=True)
    )
    cosine: NDArray[np.float64] = focal_px / np.sqrt(x**2 + y[:, None] ** 2 + focal_px**2)
    return cosine


def linear(at_zero: float, at_top: float, top: float) -> tuple[float, float]:
    """Scale and shift with which number 0 is one value, and `top` another."""
    return (at_top - at_zero) / top, at_zero

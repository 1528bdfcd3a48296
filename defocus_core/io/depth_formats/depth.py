"""Depth maps decoded to planar metres, with sky at infinity.

The meaning of a file's numbers is given by a format of `table` or by the user.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.arrays import count_of
from defocus_core.io.depth_formats.exr_depth_channel import exr_depth_numbers
from defocus_core.io.depth_formats.reading import (
    AS_IT_IS,
    OF_NUKE,
    DepthNumbers,
    DepthReading,
    own_format,
)
from defocus_core.io.depth_formats.rules import HALF_MAX, decoded, ends_in_hole, is_sky, resolved
from defocus_core.io.depth_formats.table import NAMES, DepthFormat
from defocus_core.io.exr.header import is_exr
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan
from defocus_core.io.read_files import read_head
from defocus_core.system.text import counted


def fill_from_farther(
    metres: Any, valid: NDArray[np.bool_], farther: np.ufunc = np.maximum
) -> None:
    """Fill invalid pixels [H, W] from the farther of the nearest valid pixels of their row.

    A hole is nearly always behind the edge that made it (shadows of stereo, laser and structured
    light). Rows without any depth take the farther of the nearest rows above and below.

    `metres`: [H, W], changed in place; `valid`: [H, W], at least one True; `farther`: returns the
    farther of two numbers, np.maximum or np.minimum.
    """
    metres[...] = _filled_along_rows(metres, valid, farther)
    some = valid.any(axis=1)
    if not some.all():
        columns = np.broadcast_to(some, valid.shape[::-1])
        metres[...] = _filled_along_rows(metres.T, columns, farther).T


def _filled_along_rows(
    rows: NDArray[np.float32], valid: NDArray[np.bool_], farther: np.ufunc
) -> NDArray[np.float32]:
    """The rows [H, W], each invalid pixel set to the farther of its nearest valid neighbours.

    These are the nearest valid pixels to its left and right in the row.
    """
    columns = np.arange(rows.shape[1])
    left = np.maximum.accumulate(np.where(valid, columns, -1), axis=1)
    right = np.where(valid, columns, rows.shape[1])[:, ::-1]
    right = np.minimum.accumulate(right, axis=1)[:, ::-1]
    none = np.float32(-np.inf if farther is np.maximum else np.inf)  # nearer than all
    known = np.where(valid, rows, none)
    padded = np.pad(known, ((0, 0), (0, 1)), constant_values=none)  # the columns −1 and W
    sides = [np.take_along_axis(padded, side, axis=1) for side in (left, right)]
    filled: NDArray[np.float32] = np.where(valid, rows, farther(*sides))
    return filled


# Remedy for invalid pixels of most files, and of deep samples, behind which others may lie.
_FILL = "fill the holes, and write inf for sky; or give ‹invalid› far, or fill"
_OF_SAMPLES = "write inf for sky, and leave samples without depth out"


@dataclass(frozen=True)
class Depth:
    """A decoded depth map, and notes on how the file was read."""

    # float32 [H, W]: planar distance along the axis, +inf is sky; if `is_radius`, signed CoC radius
    # in px
    metres: Any
    path: Path
    channel: str  # its name in the file, empty where channels have none
    note: str  # how the file was understood, for people
    is_radius: bool = False  # whether the file holds radii instead of depth
    replaced: int = 0  # number of invalid pixels that were set to infinity or filled
    hole_remedy: str = _FILL  # the remedy that an error on invalid pixels proposes
    top_hole: str = ""  # the greatest number of the file's type, if it seems to mark holes
    data_window: str = ""  # the data window in words, if it does not cover the picture
    overscan: Overscan = NO_OVERSCAN  # pixels beyond the picture shown
    warnings: tuple[str, ...] = ()  # what was assumed, and what was replaced
    # bool [H, W], pixels where the colour is empty, as around an element; None if there are none.
    # Their depth is inf, a radius 0
    empty: Any = None
    is_relative: bool = False  # whether the numbers are relative disparity; then `is_radius`, too
    inverted: bool = False  # whether black is near; only for relative disparity

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in px without overscan."""
        rows, columns = self.overscan.shown(*self.metres.shape)
        return columns.stop - columns.start, rows.stop - rows.start

    @property
    def ends(self) -> tuple[float, float] | None:
        """(least, greatest) valid depth of pixels that are not empty; None if there are none."""
        known = self.metres[self.valid if self.empty is None else self.valid & ~self.empty]
        return (float(known.min()), float(known.max())) if known.size else None

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Mask [H, W] of the pixels with a positive depth, or with a finite radius."""
        if self.is_radius:
            finite: NDArray[np.bool_] = np.isfinite(self.metres)
            return finite
        positive: NDArray[np.bool_] = self.metres > 0  # False for NaN
        return positive

    @property
    def invalid(self) -> NDArray[np.bool_]:
        """Mask [H, W] of the pixels that are not valid."""
        return ~self.valid


def read_depth(
    path: Path,
    reading: DepthReading = AS_IT_IS,
    *,
    size: tuple[int, int] | None = None,
    lens_focal: float | None = None,
    overscan: Overscan = NO_OVERSCAN,
    alpha: Any = None,
) -> Depth:
    """Decode a depth map; invalid pixels stay NaN, 0 or negative unless the reading replaces them.

    Args:
        path: The depth file.
        reading: Options that say how the file is read.
        size: (width, height) in px of the colour shown; None if the depth has no colour.
        lens_focal: Focal length of the lens in widths of its sensor, for a file of distances to the
            point that says no field of view.
        overscan: Pixels of the colour beyond the picture shown.
        alpha: [H, W], alpha of the colour, by which depth is divided if it was premultiplied.

    Raises:
        InputError: If the file cannot be read by these options.
    """
    own = "" if reading.depth_format or reading.relative else own_format(path)
    if own and (not reading.says_scale or "depth-unit" in NAMES[own].takes):
        reading = replace(reading, depth_format=own)
    row, read = reading.row, exr_depth_numbers
    if not is_exr(read_head(path)):
        from defocus_core.io.depth_formats.file_types import other_numbers as read
    samples = read(path, reading, size, overscan)
    if reading.depth_format is not None and samples.type not in row.files:
        problem = f"is read as {samples.words}, and {row.name} comes as {', '.join(row.files)}"
        raise InputError("wrong-type", problem, "check ‹depth-format›", path=path)
    return depth_of(samples, reading, lens_focal=lens_focal, overscan=overscan, alpha=alpha)


def depth_of(
    samples: DepthNumbers,
    reading: DepthReading = AS_IT_IS,
    *,
    lens_focal: float | None = None,
    overscan: Overscan = NO_OVERSCAN,
    alpha: Any = None,
) -> Depth:
    """The depth decoded from the numbers of a file; further arguments are as in `read_depth`."""
    path, row = samples.path, resolved(reading, samples, lens_focal)
    values, division = divided(samples, alpha)
    told = []
    says_unit = reading.depth_format or reading.depth_unit or reading.depth_range
    if samples.type == "16-bit PNG" and row.rule == "scale" and not says_unit:
        if reading.depth_scale is None:
            from defocus_core.io.depth_formats.file_types import refuse_assumed

            refuse_assumed(path, values)
        told.append(f"16 bits read as {row.words}; give ‹depth-unit› or ‹depth-format›")
    if reading.sky is not None and not is_sky(values, row).any():
        told.append(f"‹sky› {reading.sky:g} marks no pixel")
    if reading.invalid_value is not None and not (values == reading.invalid_value).any():
        told.append(f"‹invalid-value› {reading.invalid_value:.10g} marks no pixel")
    hole = f"{samples.top:.0f}" if ends_in_hole(reading, row, samples) else ""
    if hole:
        row = replace(row, invalid=(*row.invalid, samples.top))
        told.append(
            f"{hole}, the greatest number of its type and far from all others, is taken as no "
            f"depth; give ‹invalid-value› {hole} or ‹sky› {hole}"
        )
    half_sky = samples.is_half and row.sky <= HALF_MAX and bool((values == HALF_MAX).any())
    metres = decoded(values, row, overscan)
    if not (metres.flags.owndata and metres.flags.writeable):  # the caller may use the numbers
        metres = metres.copy()
    words = [samples.words, division, row.words, *_apply_marks(samples, row, metres)]
    depth = Depth(
        metres,
        path,
        samples.channel,
        f"{', '.join(filter(None, words))}{', 65504 taken as sky' * half_sky}",
        is_radius=row.rule == "radius",
        hole_remedy=_hole_remedy(samples, reading, row),
        top_hole=hole,
        data_window=samples.data_window,
        overscan=overscan,
        is_relative=reading.relative,
        inverted=bool(reading.invert),
    )
    is_of_nuke = any(name.startswith(OF_NUKE) for name in samples.metadata)
    if is_of_nuke and not reading.says_scale and (depth.ends or (0.0, 2.0))[1] <= 1:
        problem = f"{depth.channel} lies within 0 and 1, as the 1/z of Nuke's ScanlineRender"
        told.append(f"{problem}; give ‹depth-format› nuke-scanline, or metres")
    depth = replace(depth, warnings=tuple(f"{path.name}: {words}" for words in told))
    return depth if reading.invalid == "error" else _replaced(depth, reading.invalid)


def require_valid(depth: Depth) -> None:
    """Refuse a depth map with invalid pixels by an InputError that counts them."""
    count, first = count_of(depth.invalid)
    if not count:
        return
    what = "NaN or infinite" if depth.is_radius else "NaN or ≤ 0"
    if depth.top_hole:
        what += f", or {depth.top_hole}, the end of its type and far from all others,"
    problem = f"is {what} in {counted(count, 'pixel')}, the first at {first}"
    remedy = depth.hole_remedy
    if remedy != _OF_SAMPLES and _is_behind(depth):
        problem, remedy = _BEHIND
    if depth.data_window:
        problem = f"{problem}; its data window is {depth.data_window} only"
    raise InputError("invalid-depth", problem, remedy, path=depth.path)


def _hole_remedy(samples: DepthNumbers, reading: DepthReading, row: DepthFormat) -> str:
    if samples.is_integer and (reading.depth_format or reading.depth_unit):
        return "give ‹invalid› far if they are sky, or fill if they are holes"
    if samples.is_integer:
        zero = "since 0 is a hole for some and sky for others"
        return f"give ‹depth-format›, {zero}; or ‹invalid› far, or fill"
    if samples.data_window:
        return "render the whole display window, or give the colour alpha; or give ‹invalid› far"
    if samples.is_deep:
        return _OF_SAMPLES
    if reading.relative:
        return "fill the holes; or give ‹invalid› far, or fill"
    return "write a finite radius there" if row.rule == "radius" else _FILL


_BEHIND = (
    "has negative depth everywhere",
    "give ‹depth-scale› the other sign than now, or give ‹depth-format› houdini",
)


def _is_behind(depth: Depth) -> bool:
    """Whether the depth has negative numbers, and no positive finite one."""
    if depth.is_radius:
        return False
    metres = depth.metres
    return bool((metres < 0).any()) and not ((metres > 0) & (metres < np.inf)).any()


def _apply_marks(samples: DepthNumbers, row: DepthFormat, metres: Any) -> Iterator[str]:
    """Set in `metres` the depth of pixels that a channel, an array or a mask file marks.

    Yields a note in words for each source.
    """
    marks = samples.marks
    if row.mask is not None:
        from defocus_core.io.depth_formats.sidecars import mask_beside

        marks += (mask_beside(row.mask, samples.path, metres.shape),)
    for mark in marks:
        metres[mark.pixels] = mark.depth
        yield mark.words


def _replaced(depth: Depth, how: str) -> Depth:
    """The depth with invalid pixels replaced: ``how`` is "far" or "fill".

    "far" sets them to infinity, or for relative disparity to the farthest number of the map; "fill"
    fills them from the farther neighbour.
    """
    count = int(np.count_nonzero(depth.invalid))
    if not count:
        words = f"{depth.path.name}: ‹invalid› {how} finds no invalid pixel"
        return replace(depth, warnings=(*depth.warnings, words))
    if depth.is_radius and not depth.is_relative:
        problem = f"is NaN or infinite in {counted(count, 'pixel')}"
        remedy = "radii have no far: mend them, leave ‹invalid› out"
        raise InputError("invalid-depth", problem, remedy, path=depth.path)
    is_falling = depth.is_relative and not depth.inverted
    farther = np.minimum if is_falling else np.maximum
    if _is_behind(depth):
        raise InputError("invalid-depth", *_BEHIND, path=depth.path)
    if count == depth.metres.size:
        remedy = "give depth" if depth.is_relative else "check ‹depth-format›"
        raise InputError("invalid-depth", "has no pixel with a depth", remedy, path=depth.path)
    close = _fill_too_close(depth)
    if how == "far":
        ends = depth.ends if depth.is_relative else None
        far = np.float32(farther.reduce(ends) if ends else np.inf)
        depth.metres[depth.invalid] = far
        taken = "the farthest number" if depth.is_relative else "infinitely far"
        words = f"{counted(count, 'invalid pixel')} taken as {taken}{close}"
    else:
        fill_from_farther(depth.metres, depth.valid, farther)
        words = f"{counted(count, 'invalid pixel')} filled from the farther neighbour{close}"
    warnings = (*depth.warnings, f"{depth.path.name}: {words}")
    return replace(depth, note=f"{depth.note}, {words}", replaced=count, warnings=warnings)


def _fill_too_close(depth: Depth) -> str:
    """Replace -inf, which means too close for the camera, by the nearer valid neighbour.

    Returns a note in words, empty if there is none.
    """
    close = np.isneginf(depth.metres)
    if depth.is_radius or not close.any():
        return ""
    filled = depth.metres.copy()
    fill_from_farther(filled, depth.valid, np.minimum)
    depth.metres[close] = filled[close]
    return f", of which -inf in {counted(int(close.sum()), 'pixel')}, too close, from the nearer"


# Range of alpha of the edge pixels by which premultiplied depth is recognised, and the least alpha
# of the solid pixels beside them.
_EDGE, _WHOLE = (0.05, 0.9), 0.995
# Least number of edge pixels that look multiplied, and the share of all that they must exceed.
_ENOUGH, _MAXIMUM = 12, 0.8


def divided(samples: DepthNumbers, alpha: Any) -> tuple[Any, str]:
    """The numbers, divided by alpha [H, W] if they were premultiplied by it, and a note.

    The note is in words, empty if they were not divided.
    """
    values = samples.values
    usable = alpha is not None and tuple(alpha.shape) == tuple(values.shape[:2])
    if not usable or not _is_multiplied(values, alpha):
        return values, ""
    fraction, result = np.asarray(alpha, np.float32), np.array(values, np.float32)
    return np.divide(result, fraction, out=result, where=fraction > 0), "divided by alpha"


def _is_multiplied(values: Any, alpha: Any) -> bool:
    """Whether numbers [H, W] were premultiplied by alpha [H, W].

    They were if numbers at edges are mostly closer to alpha times a solid neighbour's number than
    to that number itself.
    """
    multiplied = plain = 0
    fraction, numbers = (np.asarray(each, np.float32) for each in (alpha, values))
    edge = (fraction > _EDGE[0]) & (fraction < _EDGE[1])
    if not edge.any():
        return False
    whole = (fraction >= _WHOLE) & np.isfinite(numbers) & (numbers > 0)
    for away, axis in product((-1, 1, -2, 2), (0, 1)):
        at = edge & np.roll(whole, away, axis)
        beside, own = np.roll(numbers, away, axis)[at], numbers[at]
        times = fraction[at] * beside
        nearer = np.abs(own - times) < np.abs(own - beside)
        multiplied += int(np.count_nonzero(nearer & (own > 0)))
        plain += int(np.count_nonzero(~nearer & (own > 0)))
    return multiplied >= _ENOUGH and multiplied > _MAXIMUM * (multiplied + plain)

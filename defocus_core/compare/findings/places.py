"""The place of a difference that no cause explains.

A place is named if its share of the squared difference is much larger than its share of the pixels,
measured by the relative entropy of the two shares.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import Evidence
from defocus_core.compare.findings.table import Finding
from defocus_core.compare.picture import DecodedPicture, read_picture
from defocus_core.compare.selection import beside_jumps, widened
from defocus_core.errors import InputError

_Places = Iterator[tuple[str, str, NDArray[np.bool_]]]  # name, words after it, and pixels
_Cut = tuple[slice, slice]

_LOOKED_AT = 2**19  # pixels, above which only every n-th row and column are used
_TELLS = 0.35  # least relative entropy of a place, in nats
_FITTED = 0.9  # share of it for the rectangle, which was chosen for the difference
_MOST = 0.75  # least share of the difference
_FEWEST = 12.0  # effective number of pixels that hold the difference
_EDGE_REACH = 2  # px around a silhouette
_BRIGHT, _BRIGHT_ON_SCREEN = 1.0, 0.9  # steps of a screen
_STEEPEST = 0.9  # quantile of the gradient beyond which there is an edge
_JUMP = 0.05  # of the range of inverse depth
_BORDERS = (1, 2, 4, 8, 16)  # px
_TAILS = 0.06  # share of the difference that lies beyond each end of a region
_ONE_SIGN = 0.9  # share of the squared difference that makes it brighter, or darker
_DEPTHS = ("Z", "depth.Z", "depth")  # channels


def place_of(
    evidence: Evidence,
    files: tuple[DecodedPicture, DecodedPicture],
    corner: tuple[int, int],  # column and row of the first compared pixel
) -> Finding | None:
    """The most informative place of the difference; None if none is informative enough."""
    every = max(1, math.ceil(math.sqrt(math.prod(evidence.size) / _LOOKED_AT)))
    cut = (slice(None, None, every), slice(None, None, every))
    a, b = (evidence.scaled(evidence.values_at(side, *cut)) for side in "ab")
    difference = (b - a).astype(np.float64)
    signed = (difference * np.abs(difference)).sum(axis=0)
    signed *= True if evidence.pixels.finite is None else evidence.pixels.finite[cut]
    power = np.abs(signed)
    total = float(power.sum())
    if evidence.is_small or total**2 < _FEWEST * float(np.square(power).sum()):
        return None
    ends, told = zip(corner[::-1], evidence.size, strict=True), []
    within = tuple(slice(at, at + length) for at, length in ends)
    ways = [_by_frame(evidence, power, cut)]
    if not evidence.is_patch:
        ways = [_by_scene(files, within, cut), _by_light(evidence, a), *ways]
    for name, how, mask in chain.from_iterable(ways):
        share, area = float(power[mask].sum()) / total, float(mask.mean())
        shares = ((share, area), (1 - share, 1 - area))
        tells = sum(p * math.log(p / q) for p, q in shares if p > 0)
        tells *= _FITTED if name == "in one region" else 1.0
        if share >= _MOST and 0 < area < 1 and tells >= _TELLS:
            told.append((tells, name, how, share, area, mask))
    if not told:
        return None
    _, name, how, share, area, mask = max(told, key=lambda each: each[0])
    sign = float(signed[mask].sum()) / float(power[mask].sum())
    kind = "brighter" if sign > _ONE_SIGN else "darker" if sign < -_ONE_SIGN else ""
    words = f"{share:.0%} of the difference in {area:.1%} of the pixels"
    text = f"{name}{how}: {words}" + (f", {kind}" if kind else "")
    return Finding(name, text, {"share": round(share, 4), "area": round(area, 4), "kind": kind})


def coc_map(file: DecodedPicture) -> NDArray[Any] | None:
    """Signed radius [H, W] in px, from a channel ``coc`` or a CoC map beside the file; or None."""
    planes, path = file.planes, file.path.parent.parent / "coc" / f"{file.path.stem}.exr"
    if "coc" not in planes and path.is_file() and path != file.path:
        with suppress(InputError):
            planes = read_picture(path).planes
            planes = planes if len(planes) > 1 else {"coc": next(iter(planes.values()))}
    plane = planes.get("coc")
    of_size = plane is not None and plane.shape == (file.height, file.width)
    return np.nan_to_num(np.asarray(plane, "f4"), posinf=0, neginf=0) if of_size else None


def _by_scene(
    files: tuple[DecodedPicture, DecodedPicture], within: tuple[slice, ...], cut: _Cut
) -> _Places:
    """Places at jumps of the radius or the depth."""
    size, reaches = (files[0].height, files[0].width), [_EDGE_REACH]
    radius = next((found[within] for found in map(coc_map, files) if found is not None), None)
    depths = [f.planes[n] for f in files for n in _DEPTHS if n in f.planes]
    depth = next((each[within] for each in depths if each.shape == size), None)
    if radius is not None:
        jumps = beside_jumps(radius)
        reaches.append(math.ceil(float(np.abs(radius).max())))
    elif depth is not None:
        inverse = 1 / np.maximum(np.nan_to_num(depth.astype(np.float32)), 1e-9)
        low, high = np.quantile(inverse[cut], (0.01, 0.99))
        jumps = beside_jumps(inverse, max(_JUMP * float(high - low), 1e-9))
    else:
        return
    for reach in reaches:
        yield "at silhouettes", f", within {reach} px", widened(jumps, reach)[cut]


def _by_light(evidence: Evidence, a: NDArray[Any]) -> _Places:
    """Places at steep edges of A, and at bright pixels."""
    if evidence.pixels.color:
        steep = np.hypot(*np.gradient(a.mean(axis=0)))
        yield "at edges", "", widened(steep > np.quantile(steep, _STEEPEST), 1)
        bright = _BRIGHT if evidence.gamma == 1.0 else _BRIGHT_ON_SCREEN
        yield "in highlights", "", a.max(axis=0) > bright  # new light does not belong to A


def _by_frame(evidence: Evidence, power: NDArray[Any], cut: _Cut) -> _Places:
    """Places at the border, and the rectangle with most of `power`, the squared difference."""
    size, step = evidence.size, cut[0].step
    for wide in _BORDERS:
        outer = np.ones(size, bool)
        outer[wide:-wide, wide:-wide] = False
        yield "at the border", f", within {wide} px", outer[cut]
    top, left, bottom, right = evidence.window
    if 2 * (bottom - top) * (right - left) > math.prod(size) and not evidence.is_patch:
        totals = [power.sum(axis=axis).cumsum() for axis in (1, 0)]
        ends = [np.searchsorted(t, (_TAILS * t[-1], (1 - _TAILS) * t[-1])) for t in totals]
        (top, bottom), (left, right) = ((int(v[0]) * step, int(v[1] + 1) * step) for v in ends)
    within = np.zeros(size, bool)
    within[top:bottom, left:right] = True
    yield "in one region", f" of {right - left}x{bottom - top} at {left},{top}", within[cut]

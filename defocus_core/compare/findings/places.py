"""Where a difference lies that no cause explains.

A place is said if it tells something: much more of the squared difference lies there than of the
pixels, by the relative entropy of both shares.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import Evidence, blocks_in_turn
from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.picture import DecodedPicture
from defocus_core.compare.selection import beside_jumps, read_radius, widened
from defocus_core.errors import InputError

_Mask = NDArray[np.bool_]

_LOOKED_AT = 2**19  # pixels, of which every n-th row and column are kept
_TELLS = 0.35  # least relative entropy of a place, in nats
_MOST, _ONLY = 0.75, 0.9  # least shares of the difference
_FEWEST = 12.0  # pixels that would hold the difference if each held as much
_SHARP = 1.0  # px of the largest radius in focus
_EDGE_REACH = 2  # px around a silhouette
_BRIGHT, _BRIGHT_ON_SCREEN, _DARK = 1.0, 0.9, 0.1  # values as a screen shows them
_STEEPEST = 0.9  # quantile of the gradient beyond which there is an edge
_JUMP = 0.05  # of the range of inverse depth
_BORDERS = (1, 2, 4, 8, 16)  # px
_TAILS = 0.06  # share of the difference that lies beyond each end of a region
_ONE_SIGN = 0.9  # share of the squared difference that makes it brighter, or darker
_DEPTHS = ("Z", "depth.Z", "depth")  # channels


class LocatedPair:
    """A pair where its difference is looked at, and what is known of its scene.

    Attributes:
        evidence: the pair.
        cut: the rows and columns that are looked at.
        sides: A and B [C, h, w] on the scale of differences.
        power: the squared difference [h, w], with the sign of the difference.
        maps: signed ``radius`` [H, W] in px and ``depth`` [H, W], if they are at hand: in a file
            that is named, in a channel, or in a file beside one of both.
    """

    def __init__(
        self,
        evidence: Evidence,
        files: tuple[DecodedPicture, DecodedPicture],
        corner: tuple[int, int],
        coc: Path | None,
    ) -> None:
        (x, y), (height, width) = corner, evidence.size
        step = slice(None, None, max(1, math.ceil(math.sqrt(height * width / _LOOKED_AT))))
        self.evidence, self.cut = evidence, (step, step)
        self.sides = [evidence.scaled(evidence.at(side, *self.cut)) for side in "ab"]
        difference = (self.sides[1] - self.sides[0]).astype(np.float64)
        finite = evidence.pixels.finite
        self.power = (difference * np.abs(difference)).sum(axis=0)
        self.power *= True if finite is None else finite[self.cut]
        full, within = (
            (files[0].height, files[0].width),
            (slice(y, y + height), slice(x, x + width)),
        )
        self.maps: dict[str, Any] = {}
        for name, plane in ((n, p) for file in files for n, p in file.planes.items()):
            kind = "depth" if name in _DEPTHS else "radius" if name == "coc" else ""
            if kind and plane.shape == full:
                self.maps.setdefault(kind, np.nan_to_num(plane[within].astype(np.float32)))
        beside = [
            f.path.parent.parent / "coc" / f"{f.path.stem}.exr" for f in files if f.path.parent
        ]
        for path in beside if coc is None else [coc, *beside]:
            if "radius" not in self.maps and path.is_file():
                with suppress(InputError):
                    self.maps["radius"] = read_radius(path, full)[within]


def _by_scene(shown: LocatedPair) -> Iterator[tuple[str, str, _Mask, float]]:
    """Where the radius or the depth says something of a place."""
    radius, depth, reaches = shown.maps.get("radius"), shown.maps.get("depth"), [_EDGE_REACH]
    if radius is not None:
        sharp = np.abs(radius[shown.cut]) <= _SHARP
        yield "in focus only", "", sharp, _ONLY
        yield "out of focus only", "", ~sharp, _ONLY
        jumps = beside_jumps(radius)
        reaches.append(math.ceil(float(np.abs(radius).max())))
    elif depth is not None:
        inverse = 1 / np.maximum(depth, 1e-9)
        low, high = np.quantile(inverse[shown.cut], (0.01, 0.99))
        jumps = beside_jumps(inverse, max(_JUMP * float(high - low), 1e-9))
    else:
        return
    for reach in reaches:
        yield "at silhouettes", f", within {reach} px", widened(jumps, reach)[shown.cut], _MOST


def _by_light(shown: LocatedPair) -> Iterator[tuple[str, str, _Mask, float]]:
    """Where A is steep, whatever the depth is; where its brightest channel is bright, or dark."""
    if shown.evidence.pixels.color:
        steep = np.hypot(*np.gradient(shown.sides[0].mean(axis=0)))
        yield "at edges", "", widened(steep > np.quantile(steep, _STEEPEST), 1), _MOST
        light = shown.sides[0].max(axis=0)  # what is new in B is no light of A
        bright = _BRIGHT if shown.evidence.gamma == 1.0 else _BRIGHT_ON_SCREEN
        yield "in highlights", "", light > bright, _MOST
        yield "in shadows", "", light < _DARK, _MOST


def _by_frame(shown: LocatedPair) -> Iterator[tuple[str, str, _Mask, float]]:
    """The border, and the rectangle that holds most of the blocks that choose it."""
    size, step = shown.evidence.size, shown.cut[0].step
    for wide in _BORDERS:
        inner = np.zeros(size, bool)
        inner[wide:-wide, wide:-wide] = True
        yield "at the border", f", within {wide} px", ~inner[shown.cut], _MOST
    power = np.abs(shown.power) * blocks_in_turn(size)[shown.cut]
    if not power.any():
        return
    ends = []
    for axis in (0, 1):
        total = np.cumsum(power.sum(axis=1 - axis))
        first, last = np.searchsorted(total, (_TAILS * total[-1], (1 - _TAILS) * total[-1]))
        ends.append((int(first) * step, min((int(last) + 1) * step, size[axis])))
    (top, bottom), (left, right) = ends
    if shown.evidence.is_rectangle:
        top, left, bottom, right = shown.evidence.window
    within = np.zeros(size, bool)
    within[top:bottom, left:right] = True
    how = f" of {right - left}x{bottom - top} at {left},{top}"
    yield "in one region", how, within[shown.cut], _MOST


def place_of(shown: LocatedPair) -> Finding | None:
    """The place that tells most of where the difference lies; None if none tells enough."""
    power = np.abs(shown.power)
    total = float(power.sum())
    if shown.evidence.is_small or total**2 < _FEWEST * float(np.square(power).sum()):
        return None
    measures = ~blocks_in_turn(shown.evidence.size)[shown.cut]
    told = []
    ways = (_by_frame,) if shown.evidence.is_rectangle else (_by_scene, _by_light, _by_frame)
    for name, how, mask, least in chain.from_iterable(way(shown) for way in ways):
        used = measures if name == "in one region" else np.ones(mask.shape, bool)
        every = float(power[used].sum())
        share = float(power[mask & used].sum()) / every if every else 0.0
        area = np.count_nonzero(mask & used) / np.count_nonzero(used)
        if share >= least and 0 < area < 1 and (tells := _relative_entropy(share, area)) >= _TELLS:
            told.append((tells, name, how, share, area, mask))
    if not told:
        return None
    _, name, how, share, area, mask = max(told, key=lambda each: each[0])
    sign = float(shown.power[mask].sum()) / float(power[mask].sum())
    kind = "brighter" if sign > _ONE_SIGN else "darker" if sign < -_ONE_SIGN else ""
    words = f"{share:.0%} of the difference in {area:.1%} of the pixels"
    text = f"{name}{how}: {words}" + (f", {kind}" if kind else "")
    return Finding(name, text, {"share": round(share, 4), "area": round(area, 4), "kind": kind})


def _relative_entropy(share: float, area: float) -> float:
    ends = ((share, area), (1 - share, 1 - area))
    return sum(p * math.log(p / q) for p, q in ends if p > 0)

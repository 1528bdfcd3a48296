"""Causes that are known by where a difference lies or how it looks: few pixels, seams, codecs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import (
    LOSSY_CODECS,
    Evidence,
    Explanation,
    alike,
    blocks_in_turn,
    sums_of_parts,
)
from defocus_core.system.text import counted

_PERIODS = (8, 16, 32, 64, 128, 256, 512, 1024)  # px of tiles
_WIDTHS = (1, 2, 4, 8, 16)  # px of a seam
_FEW, _SPARK = 1e-3, 0.1  # share of the pixels that fireflies are at most; their least difference
# Lines that would hold the difference if each held as much: at least these, and this share of all.
_LONE, _ALIKE = 1.2, 0.35
_FEW_TILES = 0.1  # share of the tiles that hold a difference in one place
_SEGMENT = 16  # px along a line that are taken together, so that noise averages out
_ON_GRID = 0.82  # greatest share left of what blocks in other places leave
_DCT = 8  # px of the blocks of JPEG and of DWAA
_Y = (0.299, 0.587, 0.114)  # of JPEG
_MOST_COVERED, _COVERED = 0.4, 0.5  # of a frame by an overlay; of its difference by one opacity
_OPACITY = 0.25  # relative difference of one opacity
_MOST_LOST = 12 / 255  # greatest RMS that a codec of the header may lose
_WITHOUT_MEAN = 0.3  # greatest mean of noise, by its root mean square
_MIN_CHANGED = 0.02  # share of pixels that differ, below which there is no noise
_SHARED = 0.15  # least power of what the channels of noise share, by that of each
_UNLIKE_NEIGHBOURS = 0.3  # greatest correlation of noise with itself one pixel on
_TIED = 0.35  # least correlation of a difference with the detail of a side that it is of


def _difference(evidence: Evidence) -> NDArray[Any]:
    """B − A on the scale of differences, the mean of the channels, of the whole picture [H, W]."""
    total = np.zeros(evidence.size, np.float32)
    for rows in evidence.pixels.strips():
        for name in evidence.names:
            a, b = (evidence.scaled(evidence.pixels.plane(s, name)[rows]) for s in ("a", "b"))
            total[rows] += (b - a) / np.float32(len(evidence.names))
    total[evidence.pixels.greatest == 0] = 0.0
    return total


def sparks(evidence: Evidence) -> Iterator[Explanation]:
    """A few pixels apart from each other hold the difference."""
    difference = evidence.once(_difference)
    size = np.abs(difference)
    sparks = size > max(_SPARK, 0.1 * float(size.max()))
    number = int(np.count_nonzero(sparks))
    if not 0 < number <= max(1, int(_FEW * size.size)):
        return
    power = np.square(difference, dtype="f8")
    beside = np.zeros_like(sparks)
    beside[1:] |= sparks[:-1]
    beside[:, 1:] |= sparks[:, :-1]
    if np.count_nonzero(sparks & beside) > number // 3:
        return
    left = math.sqrt(max(0.0, 1 - float(power[sparks].sum()) / float(power.sum())))
    bright = np.count_nonzero(difference[sparks] > 0) > number / 2
    how = f": {counted(number, 'pixel')}, {'brighter' if bright else 'darker'}"
    yield Explanation(left, "fireflies or few pixels", how, {"pixels": number})


def overlay(evidence: Evidence) -> Iterator[Explanation]:
    """One colour over parts of A, with one opacity but at their rims: text, or a watermark."""
    frame = [evidence.at(side, *evidence.frame) for side in ("a", "b")]
    changed = evidence.pixels.greatest[evidence.frame] > 0
    if not 24 <= np.count_nonzero(changed) < _MOST_COVERED * changed.size:
        return
    measures = ~blocks_in_turn(changed.shape, 4)[changed]
    top, first, bottom, last = evidence.window
    where = f"within {last - first}x{bottom - top} at {first},{top}"
    for scale in (evidence.light, evidence.scaled):
        a, b = (scale(side).astype("f8")[:, changed] for side in frame)
        change, power = b - a, np.square(b - a)
        for color, opacity, each, chosen in _colors_over(a, change):
            low, high = float(color.min()), float(color.max())
            # A gain would make it black, too; and what is 0 is lost, and written over by none.
            if (high < 0.02 and opacity < 0.5) or (high < 0.002 and opacity > 0.98):
                continue
            covered = float(power[:, chosen].sum() / power.sum()) >= _COVERED
            if not (covered and -0.05 < low <= high < 1.05 and (chosen & measures).any()):
                continue
            own = np.where(chosen, opacity, each.clip(0, opacity))  # rims
            rest = np.square((change - own * (color - a))[:, measures]).sum()
            left = math.sqrt(float(rest / power[:, measures].sum()))
            said = " ".join(f"{v:.2g}" for v in color[:, 0])
            how = f": {opacity:.0%} of one colour ({said}) {where}, like text"
            values = {"opacity": opacity, "color": color[:, 0].tolist()}
            yield Explanation(left, "overlay", how, values)


def _colors_over(a: NDArray[Any], change: NDArray[Any]) -> Iterator[tuple[Any, float, Any, Any]]:
    """A colour [C, 1], its opacity, that of each pixel [N], and the pixels that have it.

    B = (1 - opacity) A + opacity color, the same opacity in all channels. It is sought among the
    pixels that change most, and among those that come as near to the colour that they all near.
    """

    def opacities(color: NDArray[Any]) -> NDArray[Any]:
        toward = color - a
        squares = np.maximum(np.square(toward).sum(axis=0), 1e-9)
        return np.asarray((change * toward).sum(axis=0) / squares)

    power = np.square(change).sum(axis=0)
    strong = power > np.quantile(power, 0.6)
    if np.count_nonzero(strong) < 12:
        return
    # The point that is nearest to all lines through A along the change.
    lines, points, weights = change[:, strong], a[:, strong], power[strong]
    matrix = np.eye(len(a)) * weights.sum() - lines @ lines.T
    aim = (points * weights).sum(axis=1) - lines @ (lines * points).sum(axis=0)
    ridge = 1e-9 * np.trace(matrix) * np.eye(len(a))
    nearing = opacities(np.linalg.lstsq(matrix + ridge, aim, rcond=None)[0][:, None])
    usual = float(np.quantile(nearing[strong], 0.75))
    for chosen in (strong, np.abs(nearing - usual) < _OPACITY * usual):
        for _ in range(4):
            if np.count_nonzero(chosen) < 12:
                break
            x, y = (v[:, chosen] - v[:, chosen].mean(axis=1, keepdims=True) for v in (a, change))
            opacity = -float((x * y).sum() / max(float(np.square(x).sum()), 1e-300))
            if not opacity > 0.01:
                break
            color = (a + change / opacity)[:, chosen].mean(axis=1, keepdims=True)
            each = opacities(color)
            chosen = np.abs(each - opacity) < _OPACITY * opacity
        else:
            yield color, min(opacity, 1.0), each, chosen


def seams(evidence: Evidence) -> Iterator[Explanation]:
    """The difference lies on lines that are the side of a tile apart."""
    yield from _gains_of_tiles(evidence)
    difference = evidence.once(_difference)
    profiles = [_profile(difference), _profile(difference.T)]  # of columns and of rows
    total = sum(float(profile.mean()) for profile in profiles)
    if not total:
        return
    shown = (slice(0, 2048), slice(0, 2048))
    for period in sorted({*_PERIODS, *map(_spacing, profiles)} - {0}):
        if 1.5 * period > max(difference.shape):
            return
        for wide in (w for w in _WIDTHS if 4 * w <= period):
            phases = [_phase(profile, period, wide) for profile in profiles]
            lines = [
                (np.arange(len(p)) - phase) % period < wide
                for p, phase in zip(profiles, phases, strict=True)
            ]
            sides = list(zip(profiles, lines, strict=True))
            outside = sum(float(np.where(line, 0, p).mean()) for p, line in sides) / total
            if max(float((p[line] > 0).mean()) for p, line in sides) < 0.6 or outside > 0.2:
                continue
            if not _is_repeated(*max(sides, key=lambda side: float(side[0].sum()))):
                continue
            near = lines[1][:, None] | lines[0]
            rest = np.where(near, np.float32(0), difference)[shown]
            every, power = (
                float(np.square(v, dtype="f8").sum()) for v in (difference[shown], rest)
            )
            left = math.sqrt(max(outside, power / every if every else 0.0))
            starts = {(phase + wide // 2) % period for phase in phases}
            how = f" at multiples of {period} px"
            if starts != {0}:
                how = f" every {period} px from {', '.join(map(str, sorted(starts)))}"
            yield Explanation(left, "seams", how, {"period": period, "width": wide})


def _profile(difference: NDArray[Any]) -> NDArray[Any]:
    """How far the difference of each column exceeds that of most, less noise."""
    means = np.add.reduceat(difference, np.arange(0, len(difference), _SEGMENT), axis=0) / _SEGMENT
    power = np.square(means).mean(axis=0, dtype="f8")
    return np.asarray(np.maximum(power - 2.5 * np.median(power), 0))


def _is_repeated(profile: NDArray[Any], line: NDArray[np.bool_]) -> bool:
    """Whether the difference lies on several of the lines of a period, and not on a lone one."""
    starts = np.flatnonzero(line & ~np.roll(line, 1))
    sums = np.add.reduceat(np.where(line, profile, 0), starts)
    if len(sums) < 2:
        return False
    count = float(sums.sum()) ** 2 / max(float(np.square(sums).sum()), 1e-300)
    return count >= min(len(sums), max(_LONE, _ALIKE * len(sums)))


def _spacing(profile: NDArray[Any]) -> int:
    """The distance of the lines of a profile, if all that stand out are as far apart; else 0."""
    lines = np.flatnonzero(profile > 0.3 * profile.max())
    starts = lines[np.diff(lines, prepend=-9) > 4]
    gaps = np.diff(starts)
    return int(gaps[0]) if len(gaps) > 1 and np.ptp(gaps) == 0 and gaps[0] > 4 else 0


def _phase(profile: NDArray[Any], period: int, wide: int) -> int:
    """The first column or row, within a period, of the lines where a profile is greatest."""
    folded = np.bincount(np.arange(len(profile)) % period, profile, period)
    sums = np.sum([np.roll(folded, -k) for k in range(wide)], axis=0)
    middle = (period - wide // 2) % period
    best = int(np.argmax(sums))
    return middle if sums[middle] > 0.98 * sums[best] else best


def _gains_of_tiles(evidence: Evidence) -> Iterator[Explanation]:
    """Each tile is a multiple of A of its own: one for all, and a grid aside, explain less."""
    a, b = (side.astype("f8") for side in evidence.framed)
    a, b = evidence.scaled_light(a).astype("f8"), evidence.scaled_light(b).astype("f8")
    turn = blocks_in_turn(a.shape, 4)

    def left(side: int, offset: int) -> float:
        """What gains leave."""
        rows, columns = (
            (np.arange(cut.start, cut.stop) + offset) // side - (cut.start + offset) // side
            for cut in evidence.frame
        )
        tile = rows[:, None] * (columns[-1] + 1) + columns
        sums = [np.bincount(tile[turn], v[turn]) for v in (a * b, a * a)]
        gains = sums[0] / np.maximum(sums[1], 1e-12)
        rest = np.square(gains[tile.clip(0, len(gains) - 1)] * a - b)[~turn].sum()
        return math.sqrt(float(rest / np.square(b - a)[~turn].sum()))

    for side in _PERIODS[2:]:
        if side > min(a.shape):
            return
        parts = sums_of_parts(np.square(b - a), side)
        if parts.sum() ** 2 < _FEW_TILES * parts.size * np.square(parts).sum():
            continue  # they lie in one place
        on_grid = left(side, 0)
        if on_grid < 0.5 * min(left(side, side // 2), left(4 * max(evidence.size), 0)):
            how = f" at multiples of {side} px: each tile has another exposure"
            yield Explanation(on_grid, "seams", how, {"period": side})


def compressed(evidence: Evidence) -> Iterator[Explanation]:
    """In blocks of 8 px, frequencies of B are those of A rounded (ITU-T T.81), or small ones 0."""
    rows, columns = evidence.frame
    sides = [evidence.scaled(evidence.at(side, rows, columns)).astype("f8") for side in "ab"]
    weights = np.array(_Y if len(sides[0]) == 3 else [1 / len(sides[0])] * len(sides[0]))
    luma = [np.tensordot(weights, values, 1) for values in sides]
    change = luma[1] - luma[0]
    # A codec keeps the means of blocks, of colour, too.
    tint = [sums_of_parts(each - change, _DCT) / _DCT for each in sides[1] - sides[0]]
    tinted = float(np.square(tint).sum()) / max(len(tint) * float(np.square(change).sum()), 1e-300)

    def of_all(left: float) -> float:
        """What is left of all channels, where so much is of luma."""
        return math.sqrt((left**2 + tinted) / (1 + tinted))

    def left(offset: int) -> float:
        starts = [(-cut.start + offset) % _DCT for cut in (rows, columns)]
        a, b = (_frequencies(side[starts[0] :, starts[1] :]) for side in luma)
        turn = np.arange(len(a)) % 2 == 0
        steps = np.geomspace(0.25 / 255, 1.5, 60)
        errors = [
            np.square(b[turn] - way(a[turn], step)).sum(axis=0)
            for way in (_rounded, _without_small)
            for step in steps
        ]
        chosen = np.argmin(np.stack(errors), axis=0)
        step, rounds = steps[chosen % len(steps)], chosen < len(steps)
        kept = np.where(rounds, _rounded(a[~turn], step), _without_small(a[~turn], step))
        rest = b[~turn] - kept
        whole = float(np.square(b[~turn] - a[~turn]).sum())
        return math.sqrt(float(np.square(rest).sum()) / whole) if whole else math.inf

    if min(luma[0].shape) < 6 * _DCT:
        return
    loses = [codec in LOSSY_CODECS for codec in evidence.codecs] == [False, True]
    if loses and np.sqrt(np.square(change).mean()) < _MOST_LOST:
        means = sums_of_parts(change, _DCT) / _DCT
        kept = math.sqrt(float(np.square(means).sum() / np.square(change).sum()))
        how = f": {evidence.codecs[1]} instead of {evidence.codecs[0]}, by the headers"
        yield Explanation(of_all(kept), "compressed with losses", how)
    on_grid = left(0)
    if on_grid < _ON_GRID * left(_DCT // 2):
        how = ": in blocks of 8 px, as JPEG and DWAA do"
        yield Explanation(of_all(on_grid), "compressed with losses", how)


def _rounded(values: NDArray[Any], step: Any) -> NDArray[Any]:
    return np.asarray(step * np.rint(values / step))


def _without_small(values: NDArray[Any], least: Any) -> NDArray[Any]:
    return np.asarray(values * (np.abs(values) > least))


def _frequencies(values: NDArray[Any]) -> NDArray[Any]:
    """The discrete cosine transform of each block [n, 8, 8] of values [h, w]."""
    k = np.arange(_DCT)
    basis = np.cos(np.pi / _DCT * np.outer(k, k + 0.5)) * math.sqrt(2 / _DCT)
    basis[0] /= math.sqrt(2)
    down, across = (n // _DCT for n in values.shape)
    cut = values[: down * _DCT, : across * _DCT]
    blocks = cut.reshape(down, _DCT, across, _DCT).transpose(0, 2, 1, 3).reshape(-1, _DCT, _DCT)
    return np.asarray(basis @ blocks @ basis.T)


def noise(evidence: Evidence) -> Iterator[Explanation]:
    """The difference has no mean, and neighbours in it have nothing in common."""
    difference = evidence.once(_difference)[evidence.frame].astype("f8")
    power = float(np.square(difference).mean())
    few = np.count_nonzero(difference) < _MIN_CHANGED * difference.size
    sides = [evidence.scaled(evidence.at(side, *evidence.frame)) for side in "ab"]
    each = float(np.square(sides[1] - sides[0], dtype="f8").mean())
    mean = abs(float(difference.mean()))
    if few or power < _SHARED * each or mean > _WITHOUT_MEAN * math.sqrt(power):
        return
    across = alike(difference[:, 1:], difference[:, :-1])
    shared = max(abs(across), abs(alike(difference[1:], difference[:-1])))
    grey = [side.mean(axis=0) for side in sides]
    details = (side[1:-1, 1:-1] - _means_of_nine(side) for side in grey)
    of_a, of_b = (alike(difference[1:-1, 1:-1], detail) for detail in details)
    if shared > _UNLIKE_NEIGHBOURS or (of_a < -_TIED and of_b < _TIED):
        return  # detail of A that is lost: softer
    how = ", in another pattern" if abs(of_a + of_b) < 0.1 < of_b else ""
    planes = [evidence.pixels.difference(name, *evidence.frame) for name in evidence.names]
    level = math.sqrt(float(np.mean([np.square(p).mean(dtype="f8") for p in planes])))
    yield Explanation(math.sqrt(shared), "noise", f" of about {level:.2g}{how}", {"rms": level})


def _means_of_nine(values: NDArray[Any]) -> NDArray[Any]:
    """Means of pixels and their neighbours, without the border."""
    rows = values[:-2] + values[1:-1] + values[2:]
    return np.asarray((rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 9)

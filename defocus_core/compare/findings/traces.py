"""Causes recognised by the pattern of a difference: few pixels, seams, codecs, noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import Evidence, Explanation, block_sums, blocks_in_turn
from defocus_core.system.text import counted

_LEAST_TILE = 8  # px
_TILES = (32, 64, 128, 256, 512)  # px on a side of tiles
_FEW, _SPARK = 1e-3, 0.1  # greatest share of pixels that are fireflies; their least difference
_EXACT = 0.95  # least share explained by gains of tiles, as those of an object resemble them
_FEW_TILES = 0.1  # share of the tiles with a difference in one place
_SEGMENT = 16  # px along a line that are averaged against noise
_STANDS_OUT = 0.03  # least power of a line, by that of the strongest
_ON_GRID = 0.82  # greatest residual by that of blocks in other places
_DCT = 8  # px on a side of the blocks of JPEG and of DWAA
_Y = (0.299, 0.587, 0.114)  # of JPEG
_MOST_LOST = 12 / 255  # greatest RMS that a codec of the header may lose
_WITHOUT_MEAN = 0.3  # greatest mean of noise, by its RMS
_MIN_CHANGED = 0.02  # share of pixels that differ, below which there is no noise
_SHARED = 0.15  # least power common to the channels of noise, by that of each
_UNLIKE_NEIGHBOURS = 0.06  # greatest correlation of noise at a distance of one pixel
_ADDED, _TAKEN, _MORE = 0.7, 0.3, 1.3  # shares of the power of noise that B has


def sparks(evidence: Evidence) -> Iterator[Explanation]:
    """The difference lies in a few isolated pixels."""
    size = np.abs(evidence.difference)
    sparks = size > max(_SPARK, 0.1 * float(size.max()))
    number = int(np.count_nonzero(sparks))
    beside = sum(int(np.count_nonzero(sparks & np.roll(sparks, 1, k))) for k in (0, 1))
    if 0 < number <= max(1, int(_FEW * size.size)) and beside <= number // 3:
        power = np.square(size, dtype="f8")
        left = math.sqrt(max(0.0, 1 - float(power[sparks].sum() / power.sum())))
        bright = np.count_nonzero(evidence.difference[sparks] > 0) > number / 2
        how = f": {counted(number, 'pixel')}, {'brighter' if bright else 'darker'}"
        yield Explanation(left, "fireflies or few pixels", how, {"pixels": number})


def seams(evidence: Evidence) -> Iterator[Explanation]:
    """The difference lies on equidistant lines, as between tiles, or each tile has its own gain."""
    yield from _gains_of_tiles(evidence)
    difference = evidence.difference
    lines = [_lines(difference), _lines(difference.T)]  # columns and rows
    gaps = [np.diff(np.flatnonzero(line & ~np.roll(line, 1))) for line in lines]
    every = np.concatenate(gaps)
    top, left, bottom, right = evidence.window
    is_local = 2 * min((bottom - top) / len(lines[1]), (right - left) / len(lines[0])) < 1
    if is_local or max(map(len, gaps)) < 2:
        return
    period = int(every.min())
    apart = np.abs(every - period * np.rint(every / period))
    if period >= _LEAST_TILE and apart.max() <= 1:
        power = np.square(difference, dtype="f8")
        rest = float(power[~lines[1]][:, ~lines[0]].sum() / power.sum())
        starts = [int(np.flatnonzero(line)[0] % period) for line in lines if line.any()]
        how = f" every {period} px from {', '.join(map(str, starts))}"
        yield Explanation(math.sqrt(rest), "seams", how, {"period": period})


def _lines(difference: NDArray[Any]) -> NDArray[np.bool_]:
    """Mask [W] of the columns whose difference stands out from that of the other columns."""
    means = np.add.reduceat(difference, np.arange(0, len(difference), _SEGMENT), axis=0) / _SEGMENT
    power = np.square(means).mean(axis=0, dtype="f8")
    power = np.maximum(power - 2.5 * np.median(power), 0)
    return np.asarray(power > _STANDS_OUT * power.max())


def _gains_of_tiles(evidence: Evidence) -> Iterator[Explanation]:
    """Each tile of B is A times its own gain; one gain for all or a shifted grid explains less."""
    a, b = (side.mean(axis=0, dtype="f8") for side in evidence.framed)
    turn, power = blocks_in_turn(a.shape, 4), np.square(b - a)

    def left(side: int, offset: int) -> float:
        """The residual with a gain for each tile, as a share of the difference."""
        rows, columns = ((np.arange(c.start, c.stop) + offset) // side for c in evidence.frame)
        tile = (rows - rows[0])[:, None] * (columns[-1] - columns[0] + 1) + columns - columns[0]
        sums = [np.bincount(tile[turn], v[turn], tile[-1, -1] + 1) for v in (a * b, a * a)]
        gains = sums[0] / np.maximum(sums[1], 1e-12)
        rest = np.square(gains[tile] * a - b)[~turn].sum()
        return math.sqrt(float(rest / power[~turn].sum()))

    for side in (side for side in _TILES if side <= min(a.shape)):
        parts = block_sums(power, side)
        spread = parts.sum() ** 2 >= _FEW_TILES * parts.size * np.square(parts).sum()
        on_grid = left(side, 0) if spread else math.inf
        apart = evidence.explained(on_grid) > _EXACT
        if apart and on_grid < 0.5 * min(left(side, side // 2), left(4 * max(evidence.size), 0)):
            how = f" at multiples of {side} px: each tile has another exposure"
            yield Explanation(on_grid, "seams", how, {"period": side})


def compressed(evidence: Evidence) -> Iterator[Explanation]:
    """The frequencies of blocks of 8 x 8 px of A are rounded in B (ITU-T T.81), or 0 if small."""
    sides = [side.astype("f8") for side in evidence.framed]
    weights = np.array(_Y if len(sides[0]) == 3 else [1 / len(sides[0])] * len(sides[0]))
    luma = [np.tensordot(weights, values, 1) for values in sides]
    change = luma[1] - luma[0]
    if min(change.shape) < 6 * _DCT:
        return
    power = max(float(np.square(change).sum()), 1e-300)
    # A codec keeps the means of blocks, also of colour.
    tint = [block_sums(each - change, _DCT) / _DCT for each in sides[1] - sides[0]]
    tinted = float(np.square(tint).sum()) / (len(tint) * power)
    ways: list[tuple[float, str]] = []
    loses = [codec.startswith(("DWA", "B44")) for codec in evidence.codecs] == [False, True]
    if loses and power < _MOST_LOST**2 * change.size:
        means = float(np.square(block_sums(change, _DCT) / _DCT).sum())
        by = f": {evidence.codecs[1]} instead of {evidence.codecs[0]}, by the headers"
        ways.append((means / power, by))
    on_grid, off_grid = (
        _left_of_rounding(*(side[k:, k:] for side in luma)) for k in (0, _DCT // 2)
    )
    if on_grid < _ON_GRID**2 * off_grid:
        ways.append((on_grid, ": in blocks of 8 px, as JPEG and DWAA do"))
    for left, how in ways:
        share = math.sqrt((left + tinted) / (1 + tinted))
        yield Explanation(share, "compressed with losses", how)


def _left_of_rounding(*sides: NDArray[Any]) -> float:
    """The squared residual if frequencies of blocks of A are quantised, as a share."""
    a, b = map(_frequencies, sides)
    turn = np.arange(len(a)) % 2 == 0
    steps = np.geomspace(0.25 / 255, 1.5, 60)[:, None, None]
    errors = [np.square(b[turn] - step * np.rint(a[turn] / step)).sum(axis=0) for step in steps]
    step = steps.ravel()[np.argmin(errors, axis=0)]
    rest = np.square(b[~turn] - step * np.rint(a[~turn] / step)).sum()
    return float(rest / max(np.square(b[~turn] - a[~turn]).sum(), 1e-300))


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
    """The difference has mean 0, and is uncorrelated between neighbours and with the picture."""
    sides = [side.astype("f8") for side in evidence.framed]
    a, b = (side.mean(axis=0) for side in sides)
    change = b - a
    power, each = float(np.square(change).mean()), float(np.square(sides[1] - sides[0]).mean())
    few = np.count_nonzero(change) < _MIN_CHANGED * change.size or min(change.shape) < 3
    biased = power < _SHARED * each or abs(change.mean()) > _WITHOUT_MEAN * math.sqrt(power)
    if few or biased:
        return
    beside = ((v[1:] * v[:-1]).mean() for v in (change, change.T))
    shared = max(abs(float(v)) for v in beside) / power
    detail, of_b = (side[1:-1, 1:-1] - _means_of_nine(side) for side in (change, b))
    added = float((change[1:-1, 1:-1] * of_b).sum() / (change[1:-1, 1:-1] * detail).sum())
    if shared > _UNLIKE_NEIGHBOURS or added > _MORE:
        return
    planes = [evidence.pixels.difference(name, *evidence.frame) for name in evidence.names]
    level = math.sqrt(float(np.mean([np.square(p).mean(dtype="f8") for p in planes])))
    if added < _TAKEN:
        yield Explanation(math.sqrt(shared), "softer", f": without noise of about {level:.2g}")
        return
    how = f" of about {level:.2g}{', in another pattern' if added < _ADDED else ''}"
    yield Explanation(math.sqrt(shared), "noise", how, {"rms": level})


def _means_of_nine(values: NDArray[Any]) -> NDArray[Any]:
    """Means of each pixel and its eight neighbours, without the border."""
    rows = values[:-2] + values[1:-1] + values[2:]
    return np.asarray((rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / 9)

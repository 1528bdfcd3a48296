"""Causes that move pixels: another file, flips and right angles, crop, shift, scale."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import Evidence, Explanation, steepness
from defocus_core.compare.findings.softness import keys

_Scale = Callable[[NDArray[Any]], NDArray[Any]]
_PEAKS = 3  # peaks of each correlation that are tried
_EXPLAINED = 0.02  # residual below which no further move is searched
_LEAST_PART = 0.02  # px of the largest move
_CHOSEN, _STEPS = 1600, 8  # samples that choose a small move, and steps to it
_AROUND = 1e-3  # px, step of the finite differences of a move


def other_file(evidence: Evidence) -> Iterator[Explanation]:
    """B is another file that lies beside A."""
    rows, columns = evidence.places
    for name, planes in evidence.others.items():
        if all(n in planes and planes[n].shape == evidence.size for n in evidence.names):
            there = np.stack([planes[n][rows, columns] for n in evidence.names])
            left = evidence.left(np.nan_to_num(there.astype(np.float32)))
            yield Explanation(left, name.partition(":")[0], text=name)


def flipped(evidence: Evidence) -> Iterator[Explanation]:
    """B is A mirrored or turned by right angles."""
    y, x = evidence.places
    height, width = evidence.size
    up, back = height - 1 - y, width - 1 - x
    moves = [
        ("flipped", " left to right", y, back),
        ("flipped", " upside down", up, x),
        ("rotated", " by 180°", up, back),
    ]
    if height == width:
        moves += [
            ("rotated", " by 90° to the left", x, up),
            ("rotated", " by 90° to the right", back, y),
            ("flipped", " over its diagonal", x, y),
        ]
    for name, how, rows, columns in moves:
        yield Explanation(evidence.left(evidence.values_at("a", rows, columns)), name, how)


def cropped(evidence: Evidence) -> Iterator[Explanation]:
    """B is 0 outside a window, and equals A within it."""
    kept = np.logical_or.reduce([evidence.pixels.plane("b", n) != 0 for n in evidence.names])
    if kept.all() or not kept.any():
        return
    ends = [np.flatnonzero(kept.any(axis=axis))[[0, -1]].tolist() for axis in (1, 0)]
    (top, bottom), (left, right) = ends
    if kept[top : bottom + 1, left : right + 1].size < kept.size:
        rows, columns = evidence.places
        inside = (rows >= top) & (rows <= bottom) & (columns >= left) & (columns <= right)
        left_over = evidence.left(np.where(inside, evidence.sampled[0], np.float32(0.0)))
        window = [left, top, right - left + 1, bottom - top + 1]
        text = "a crop: 0 outside of {2}x{3} at {0},{1}".format(*window)
        yield Explanation(left_over, "crop", values={"window": window}, text=text)


def _offsets(evidence: Evidence) -> list[tuple[int, int]]:
    """Shifts (dx, dy) with the best match of B and A where most differs, the best first."""
    a, b = (evidence.scaled(evidence.values_at(s, *evidence.frame)).mean(axis=0) for s in "ab")
    tried = dict.fromkeys([(0, 0), *chain.from_iterable(_peaks(a, b))])
    return sorted(tried, key=lambda offset: (_left_by(evidence, *offset), sum(map(abs, offset))))


def _left_by(evidence: Evidence, dx: int, dy: int) -> float:
    """The residual of a shift by whole pixels, where A has pixels."""
    (rows, columns), (height, width) = evidence.places, evidence.size
    y, x = rows - dy, columns - dx
    within = (y >= 0) & (y < height) & (x >= 0) & (x < width)
    return evidence.left(
        evidence.values_at("a", y.clip(0, height - 1), x.clip(0, width - 1)), within
    )


def _peaks(a: NDArray[Any], b: NDArray[Any]) -> Iterator[list[tuple[int, int]]]:
    """The highest peaks (dx, dy) of correlations of frames [h, w], more and less whitened."""
    height, width = a.shape
    window = np.outer(*(np.hanning(n + 2)[1:-1].astype(a.dtype) for n in (height, width)))
    old, new = (np.fft.rfft2((v - v.mean()) * window) for v in (a, b))
    spectrum = np.conj(old) * new
    magnitude = np.abs(spectrum) + 1e-9 * float(np.abs(spectrum).max(initial=0.0)) + 1e-30
    for whitening in (1.0, 0.5):
        peaks = np.fft.irfft2(spectrum / magnitude**whitening, s=(height, width)).ravel()
        dy, dx = np.divmod(np.argsort(peaks)[-_PEAKS:], width)
        dx, dy = dx - width * (dx > width // 2), dy - height * (dy > height // 2)
        yield list(zip(dx.tolist(), dy.tolist(), strict=True))


def moved(evidence: Evidence) -> Iterator[Explanation]:
    """B is A moved by pixels and fractions, and enlarged; new pixels may be anything."""
    dx, dy = _offsets(evidence)[0]
    least = _left_by(evidence, dx, dy)
    if (dx, dy) != (0, 0):
        yield Explanation(least, "shifted", f" by ({dx}, {dy})", {"dx": dx, "dy": dy})
    if least <= _EXPLAINED or min(evidence.size) <= 16:
        return
    move = np.array([dy, dx, 0.0])
    for free in (2, 3):
        move, better = _fitted(evidence, move, free)
        if not better:
            continue
        inside, there = _moved(evidence, slice(None), move, evidence.names)
        left = evidence.left(_interpolated(evidence)[1](there), inside)
        down, right, out = map(float, move)
        values = {"dx": right, "dy": down, "scale": 1 + out / (max(evidence.size) / 2)}
        ways = [f"shifted by ({right:.2f}, {down:.2f})"]
        if free == 3 and abs(out) > _LEAST_PART:
            ways = [f"scaled by {values['scale']:.5g}", *ways]
            ways = ways[: 1 + bool(np.hypot(right, down) > 5 * _LEAST_PART)]
        yield Explanation(left, ways[0].partition(" ")[0], values=values, text=" and ".join(ways))


def _fitted(evidence: Evidence, start: NDArray[Any], free: int) -> tuple[NDArray[Any], bool]:
    """The best move near a start, and whether it explains anything; else the start.

    `free`: the number of free parameters: px down, px right, and px outwards at half of the longer
    side. The method is Gauss-Newton steps (Lucas and Kanade, 1981).
    """
    names = sorted(evidence.names, key=lambda name: name[-1:] not in "GY")[:1]
    few = np.flatnonzero(evidence.fits)
    few = few[:: max(1, len(few) // _CHOSEN)]
    scale, _ = _interpolated(evidence)
    rows, columns = (places[few] for places in evidence.places)
    was, aim = (scale(evidence.values_at(side, rows, columns, names)) for side in "ab")
    # Light has the weight of its slope on a screen.
    slope = steepness(was) if scale == evidence.light else 1.0
    move = start.copy()
    for _ in range(_STEPS):
        inside, there = _moved(evidence, few, move, names)
        beside = [_moved(evidence, few, move + _AROUND * d, names)[1] for d in np.eye(3)[:free]]
        design = np.stack([((v - there) / _AROUND * slope * inside).ravel() for v in beside])
        rest = (aim - there) * slope * inside
        step = np.linalg.lstsq(design @ design.T, design @ rest.ravel(), rcond=None)[0].clip(-2, 2)
        move[:free] += step
        if np.abs(step).max() < 0.002:
            break
    every = np.square((aim - was) * slope * inside).sum()
    better = np.isfinite(move).all() and np.abs(move).max() >= _LEAST_PART
    better = better and np.square(rest).sum() <= 0.5 * every
    return (move, True) if better else (start, False)


def _interpolated(evidence: Evidence) -> tuple[_Scale, _Scale]:
    """The functions to the scale of interpolation and back: light for EXR, else stored values."""
    if evidence.gamma == 1.0 and evidence.pixels.color:
        return evidence.light, evidence.stored
    return evidence.scaled, evidence.unscaled


def _moved(
    evidence: Evidence, few: Any, move: NDArray[Any], names: Sequence[str]
) -> tuple[NDArray[np.bool_], NDArray[Any]]:
    """The samples that lie within A, and the moved A at these."""
    inside, axes = np.bool_(True), []
    for places, length, by in zip(evidence.places, evidence.size, move[:2], strict=True):
        out = (places[few] - (length - 1) / 2) / (max(evidence.size) / 2)
        at = places[few] - by - move[2] * out
        inside = inside & (at > 2) & (at < length - 3)
        taps = np.floor(at).astype(np.intp) + np.arange(-1, 3)[:, None]
        axes.append((taps.clip(0, length - 1), keys(at - taps)))
    (rows, down), (columns, across) = axes
    values = _interpolated(evidence)[0](evidence.values_at("a", rows[:, None], columns, names))
    return np.asarray(inside), np.einsum("kn,jn,ckjn->cn", down, across, values)

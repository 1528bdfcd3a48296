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
_PEAKS = 3  # of each correlation that are tried
_EXPLAINED = 0.02  # left of a difference, below which no further move is looked for
_LEAST_PART = 0.02  # px of a move that is looked at
_CHOSEN, _STEPS = 1600, 8  # samples that choose a small move, and steps to it
_AROUND = 1e-4  # px by which kernels of interpolation are moved for their slope
# Of a move: how far down and how far right, in px, and how far out at half of the longer side.
_SHIFT, _SCALED = np.eye(3)[:2], np.eye(3)


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
        yield Explanation(evidence.left(evidence.at("a", rows, columns)), name, how)


def cropped(evidence: Evidence) -> Iterator[Explanation]:
    """B is 0 outside of a window, and as A within it."""
    planes = [evidence.pixels.plane("b", name) for name in evidence.names]
    if all(plane[0].any() and plane[:, 0].any() and plane[-1].any() for plane in planes):
        return
    kept = np.logical_or.reduce([plane != 0 for plane in planes])
    if not kept.any():
        return
    (top, bottom), (left, right) = (
        np.flatnonzero(kept.any(axis=axis))[[0, -1]].tolist() for axis in (1, 0)
    )
    width, height = right - left + 1, bottom - top + 1
    if (height, width) != evidence.size:
        rows, columns = evidence.places
        inside = (rows >= top) & (rows <= bottom) & (columns >= left) & (columns <= right)
        left_over = evidence.left(np.where(inside, evidence.sampled[0], np.float32(0.0)))
        text = f"a crop: 0 outside of {width}x{height} at {left},{top}"
        values = {"window": [left, top, width, height]}
        yield Explanation(left_over, "crop", values=values, text=text)


def _offsets(evidence: Evidence) -> list[tuple[int, int]]:
    """Shifts (dx, dy) by which B is most like A where most differs, the best first."""
    a, b = (evidence.scaled(evidence.at(s, *evidence.frame)).mean(axis=0) for s in "ab")
    tried = dict.fromkeys([(0, 0), *chain.from_iterable(_peaks(a, b))])
    return sorted(tried, key=lambda offset: (_left_by(evidence, *offset), sum(map(abs, offset))))


def _left_by(evidence: Evidence, dx: int, dy: int) -> float:
    """What a shift by whole pixels leaves where A was within."""
    (rows, columns), (height, width) = evidence.places, evidence.size
    y, x = rows - dy, columns - dx
    within = (y >= 0) & (y < height) & (x >= 0) & (x < width)
    return evidence.left(evidence.at("a", y.clip(0, height - 1), x.clip(0, width - 1)), within)


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
    """B is A moved by pixels and parts of one, and enlarged; what comes in may be anything."""
    dx, dy = _offsets(evidence)[0]
    least = _left_by(evidence, dx, dy)
    if (dx, dy) != (0, 0):
        yield Explanation(least, "shifted", f" by ({dx}, {dy})", {"dx": dx, "dy": dy})
    if least <= _EXPLAINED or min(evidence.size) <= 16:
        return
    first = tuple(sorted(evidence.names, key=lambda name: name[-1:] not in "GY")[:1])
    move = np.array([dy, dx, 0.0])
    for free in (_SHIFT, _SCALED):
        move, better = _fitted(evidence, first, move, free)
        if not better:
            continue
        inside, (there,) = _moved(evidence, *evidence.places, move, evidence.names)
        left = evidence.left(_interpolated(evidence)[1](there), inside)
        down, right, out = map(float, move)
        values = {"dx": right, "dy": down, "scale": 1 + out / _far(evidence)}
        ways = [f"shifted by ({right:.2f}, {down:.2f})"]
        if free is _SCALED and abs(out) > _LEAST_PART:
            ways = [f"scaled by {values['scale']:.5g}", *ways]
            ways = ways[: 1 + bool(np.hypot(right, down) > 5 * _LEAST_PART)]
        yield Explanation(left, ways[0].partition(" ")[0], values=values, text=" and ".join(ways))


def _far(evidence: Evidence) -> float:
    """Distance from the middle, in px, at which growth is measured."""
    return max(evidence.size) / 2


def _fitted(
    evidence: Evidence, names: tuple[str, ...], start: NDArray[Any], free: NDArray[Any]
) -> tuple[NDArray[np.float64], bool]:
    """The move near another that makes B of A, and whether it explains some of it, or the other.

    It is found by least squares on the gradient (Lucas and Kanade, 1981).
    """
    rows, columns = evidence.places
    fits = np.flatnonzero(evidence.fits)
    fits = fits[:: max(1, len(fits) // _CHOSEN)]
    places = rows[fits], columns[fits]
    far, (height, width) = _far(evidence), evidence.size
    y, x = (places[0] - (height - 1) / 2) / far, (places[1] - (width - 1) / 2) / far
    scale, _ = _interpolated(evidence)
    was, aim = (scale(evidence.at(side, *places, names)) for side in "ab")
    # Light counts as much as a screen shows of it.
    slope = steepness(was) if scale == evidence.light else 1.0
    move, rest, inside = start.copy(), aim - was, np.ones(len(fits), bool)
    for _ in range(_STEPS):
        inside, (there, down, right) = _moved(evidence, *places, move, names, sloped=True)
        ways = [-v * slope * inside for v in (down, right, down * y + right * x)]
        rest = (aim - there) * slope * inside
        design = free @ np.stack([way.ravel() for way in ways])
        step = np.linalg.lstsq(design @ design.T, design @ rest.ravel(), rcond=None)[0].clip(-2, 2)
        move += step @ free
        if np.abs(step).max() < 0.002:
            break
    every = np.square((aim - was) * slope * inside).sum()
    better = np.isfinite(move).all() and np.abs(move).max() >= _LEAST_PART
    better = better and np.square(rest).sum() <= 0.5 * every
    return (move, True) if better else (start, False)


def _interpolated(evidence: Evidence) -> tuple[_Scale, _Scale]:
    """The scale that values are interpolated on, and back: light of EXR, and else as stored."""
    if evidence.gamma == 1.0 and evidence.pixels.color:
        return evidence.light, evidence.stored
    return evidence.scaled, evidence.unscaled


def _moved(
    evidence: Evidence,
    rows: NDArray[Any],
    columns: NDArray[Any],
    move: NDArray[Any],
    names: Sequence[str],
    *,
    sloped: bool = False,
) -> tuple[NDArray[np.bool_], list[NDArray[Any]]]:
    """Places of A that were within it, and A there, if asked for with its slopes down and right."""
    far, (height, width) = _far(evidence), evidence.size
    y, x = (rows - (height - 1) / 2) / far, (columns - (width - 1) / 2) / far
    at_y, at_x = rows - move[0] - move[2] * y, columns - move[1] - move[2] * x
    inside = (at_y > 2) & (at_y < height - 3) & (at_x > 2) & (at_x < width - 3)
    top, left = np.floor(at_y).astype(np.intp), np.floor(at_x).astype(np.intp)
    taps = np.arange(-1, 3)[:, None]
    lines, row = (top + taps).clip(0, height - 1)[:, None], (left + taps).clip(0, width - 1)
    values = _interpolated(evidence)[0](evidence.at("a", lines, row, names))  # [C, 4, 4, N]
    down, across = at_y - top - taps, at_x - left - taps
    ways = [(keys(down), keys(across))]
    if sloped:
        slopes = [(keys(t + _AROUND) - keys(t - _AROUND)) / (2 * _AROUND) for t in (down, across)]
        ways += [(slopes[0], ways[0][1]), (ways[0][0], slopes[1])]
    return inside, [np.einsum("kn,jn,ckjn->cn", k, j, values) for k, j in ways]

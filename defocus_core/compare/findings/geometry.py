"""Causes: B is another file, or A mirrored, turned, cropped, shifted or scaled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import Evidence, Explanation, steepness
from defocus_core.compare.findings.softness import keys

_PEAKS = 3  # peaks of each correlation that are tried
_EXPLAINED = 0.02  # residual below which no further move is searched
_LEAST_PART, _TOLD = 0.02, 0.1  # px of the largest move, and of a part of it that is told
_CHOSEN, _STEPS = 1600, 8  # samples that choose a small move, and steps to it
_AROUND = 1e-3  # px, step of the finite differences of a move


def other_file(evidence: Evidence) -> Iterator[Explanation]:
    """B is another file that lies beside A."""
    rows, columns = evidence.places
    for text, planes in evidence.others.items():
        if all(n in planes and planes[n].shape == evidence.size for n in evidence.names):
            there = np.stack([planes[n][rows, columns] for n in evidence.names])
            name, colon, which = text.partition(":")
            there = np.nan_to_num(there.astype(np.float32))
            yield evidence.explain(there, name, colon + which)


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
        yield evidence.explain(evidence.values_at("a", rows, columns), name, how)


def cropped(evidence: Evidence) -> Iterator[Explanation]:
    """B is 0 outside a window, and equals A within it."""
    kept = np.logical_or.reduce([evidence.pixels.plane("b", n) != 0 for n in evidence.names])
    if kept.all() or not kept.any():
        return
    ends = [np.flatnonzero(kept.any(axis=axis))[[0, -1]].tolist() for axis in (1, 0)]
    (top, bottom), (left, right) = ends
    rows, columns = evidence.places
    inside = (rows >= top) & (rows <= bottom) & (columns >= left) & (columns <= right)
    window = [left, top, right - left + 1, bottom - top + 1]
    if window[2:] != [*evidence.size[::-1]]:
        there = np.where(inside, evidence.sampled[0], np.float32(0.0))
        how = ": 0 outside of {2}x{3} at {0},{1}".format(*window)
        yield evidence.explain(there, "crop", how, {"window": window})


def moved(evidence: Evidence) -> Iterator[Explanation]:
    """B is A moved by whole or fractional px, and enlarged; pixels from outside A are ignored.

    A move is three numbers in px: down, right, and, half the longer side away from the centre,
    outwards. Fractions of px are found by Gauss-Newton steps (Lucas and Kanade, 1981).
    """
    names = sorted(evidence.names, key=lambda name: name[-1:] not in "GY")[:1]
    few = np.flatnonzero(evidence.fits)
    few = few[:: max(1, len(few) // _CHOSEN)]
    of_light, rows, columns = _is_of_light(evidence), *(v[few] for v in evidence.places)
    scale = evidence.light if of_light else evidence.scaled
    was, aim = (scale(evidence.values_at(side, rows, columns, names)) for side in "ab")
    slope = steepness(was) if of_light else 1.0  # of a screen

    def left(inside: Any, there: Any) -> float:
        """The squared residual of a move, as a share of the squared difference."""
        rest, every = (np.square((aim - v) * slope * inside).sum() for v in (there, was))
        return float(rest / every) if every else np.inf

    def at(move: NDArray[Any]) -> tuple[Any, Any]:
        return _moved(evidence, few, move, names)

    move = min(_ways(evidence), key=lambda way: left(*at(way)))
    for free in (0, 2, 3) if min(evidence.size) > 16 else (0,):
        best = move.copy()
        for _ in range(_STEPS if free else 0):
            inside, there = at(best)
            beside = [at(best + _AROUND * d)[1] for d in np.eye(3)[:free]]
            design = np.stack([((v - there) / _AROUND * slope * inside).ravel() for v in beside])
            sums = design @ ((aim - there) * slope * inside).ravel()
            step = np.linalg.lstsq(design @ design.T, sums, rcond=None)[0].clip(-2, 2)
            best[:free] += step
            if np.abs(step).max() < 0.002:
                break
        moves = np.isfinite(best).all() and np.abs(best).max() >= _LEAST_PART
        if moves and left(*at(best)) <= 0.5:
            move, fit = best, _explained(evidence, best)
            yield fit
            if fit.left <= _EXPLAINED:
                return


def _explained(evidence: Evidence, move: NDArray[Any]) -> Explanation:
    """The explanation that a move gives, as [down, right, outwards] in px."""
    inside, there = _moved(evidence, slice(None), move, evidence.names)
    there = evidence.stored(there) if _is_of_light(evidence) else evidence.unscaled(there)
    down, right, out = map(float, move)
    values = {"dx": right, "dy": down, "scale": 1 + out / (max(evidence.size) / 2)}
    # The sum makes 0 of −0.
    ways = ["shifted by ({:g}, {:g})".format(*(round(v, 2) + 0.0 for v in (right, down)))]
    if abs(out) > _TOLD:
        ways = [f"scaled by {values['scale']:.5g}", *ways * bool(np.hypot(right, down) > _TOLD)]
    name, space, how = " and ".join(ways).partition(" ")
    return evidence.explain(there, name, space + how, values, where=inside)


def _ways(evidence: Evidence) -> Iterator[NDArray[Any]]:
    """No move, and moves by whole px to peaks of the correlation of A and B in the frame."""
    yield np.zeros(3)
    a, b = (side.mean(axis=0) for side in evidence.framed)
    height, width = a.shape
    window = np.outer(*(np.hanning(n + 2)[1:-1].astype(a.dtype) for n in (height, width)))
    old, new = (np.fft.rfft2((v - v.mean()) * window) for v in (a, b))
    spectrum = np.conj(old) * new
    magnitude = np.abs(spectrum) + 1e-9 * float(np.abs(spectrum).max(initial=0.0)) + 1e-30
    for whitening in (1.0, 0.5):
        peaks = np.fft.irfft2(spectrum / magnitude**whitening, s=(height, width)).ravel()
        for place in np.argsort(peaks)[-_PEAKS:].tolist():
            dy, dx = divmod(place, width)
            down, right = dy - height * (dy > height // 2), dx - width * (dx > width // 2)
            yield np.array([down, right, 0.0])


def _is_of_light(evidence: Evidence) -> bool:
    """Whether moves interpolate linear light, not values on the scale of `Evidence.scaled`."""
    return evidence.gamma == 1.0 and bool(evidence.pixels.color)


def _moved(
    evidence: Evidence, few: Any, move: NDArray[Any], names: Sequence[str]
) -> tuple[NDArray[np.bool_], NDArray[Any]]:
    """Mask of the samples whose source lies within A, and values [C, N] of the moved A.

    `few`: the indices of the samples to move.
    """
    inside, axes = np.bool_(True), []
    for places, length, by in zip(evidence.places, evidence.size, move[:2], strict=True):
        out = (places[few] - (length - 1) / 2) / (max(evidence.size) / 2)
        at = places[few] - by - move[2] * out
        inside = inside & (at > 2) & (at < length - 3)
        taps = np.floor(at).astype(np.intp) + np.arange(-1, 3)[:, None]
        axes.append((taps.clip(0, length - 1), keys(at - taps)))
    (rows, down), (columns, across) = axes
    values = evidence.values_at("a", rows[:, None], columns, names)
    values = evidence.light(values) if _is_of_light(evidence) else evidence.scaled(values)
    return np.asarray(inside), np.einsum("kn,jn,ckjn->cn", down, across, values)

"""Explanations that spread light otherwise: another CoC, motion blur, resolution, bokeh shape.

A filter for all places is found by least squares, tap by tap. Where blur depends on depth, each
part of a picture has a filter of its own: a sum of A through gaussians of several widths.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.compare.findings.evidence import Evidence, Explanation, blocks_in_turn
from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.findings.geometry import fitted_in_parts

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

_REACH = 7  # px of a filter for all places
_CHOSEN = 4000  # pixels that choose it
_SIGMAS = (0.6, 1.2, 2.4, 4.8)  # px of the gaussians
_FILTER_LEFT, _RESOLUTION_LEFT, _SPREAD_LEFT = 0.3, 0.6, 0.25
_SURELY_SPREAD = 0.08  # left where kernels of another size or shape spread the light
_COC_LEFT, _ROUND_LEFT = 0.62, 0.45  # kernels of another shape are explained up to 0.47
_OF_A_FILTER = 0.25  # least power of what a filter spreads, by that of the difference
_LONG = 4.0  # how much wider than across a filter of motion is along
_PIECE = 192  # px of a side of the part whose resolution is looked at
_DETAIL_KEPT = 0.35  # of what a lower resolution cannot have
_NONE_KEPT = 0.04  # where B surely had a lower resolution
_SPREAD = 12.0  # px of the gaussian within which another bokeh shape keeps the light
_ONE_WAY = 0.85  # share of blurred blocks that makes a picture blurred more, or less
_UNLIKE_DETAIL = 0.35  # greatest correlation of noise with the detail of A
_UNLIKE_NEIGHBOURS = 0.3  # greatest correlation of noise with itself one pixel on


def explanations(evidence: Evidence) -> Iterator[Explanation]:
    """All that might be, the simplest first."""
    if min(evidence.framed[0].shape) < 4 * _REACH:
        return
    yield from _lower_resolution(evidence)
    yield from _filtered(evidence)
    yield from _another_coc(evidence)
    yield from _spread_otherwise(evidence)


def _slope(evidence: Evidence, light: NDArray[Any]) -> NDArray[Any]:
    """The slope of the scale of differences at some light."""
    step = np.maximum(np.abs(light) * 1e-3, 1e-5)
    high, low = (evidence.scaled_light(light + s).astype(np.float64) for s in (step, -step))
    slope: NDArray[Any] = (high - low) / (2 * step)
    return slope


def _filtered(evidence: Evidence) -> Iterator[Explanation]:
    """B is A through one filter for all places."""
    a, b = evidence.framed
    height, width = a.shape
    weights = _slope(evidence, np.maximum(np.abs(a), np.abs(b)))
    inner = np.zeros(a.shape, bool)
    inner[_REACH : height - _REACH, _REACH : width - _REACH] = True
    inner &= ~evidence.clipped_near
    chooses = blocks_in_turn(a.shape)
    fits = np.flatnonzero(inner & chooses)
    if fits.size < 4 * (2 * _REACH + 1) ** 2:
        return
    generator = np.random.default_rng(0)
    energy = np.square((b - a) * weights).ravel()[fits]
    total = float(energy.sum())
    if not total or not math.isfinite(total):
        return
    half = min(_CHOSEN, fits.size) // 2
    chosen = np.concatenate(
        [generator.choice(fits, half), generator.choice(fits, half, p=energy / total)]
    )
    steps = np.arange(-_REACH, _REACH + 1)
    taps = (steps[:, None] * width + steps).ravel()
    weight = weights.ravel()[chosen][:, None]
    design = a.ravel()[chosen[:, None] - taps] * weight
    aim = (b - a).ravel()[chosen] * weight[:, 0]
    square = design.T @ design
    square[np.diag_indices(len(square))] += 1e-5 * np.trace(square) / len(square)
    kernel = np.linalg.solve(square, design.T @ aim).reshape(len(steps), len(steps))
    predicted = a + _through(a, kernel)
    whole = 1 + float(kernel.sum())
    moved, every = (np.square(v * weights)[inner].sum() for v in (predicted - whole * a, b - a))
    if moved < _OF_A_FILTER * every:  # another exposure, with a little of something else
        return
    left = evidence.left_framed(predicted, inner & ~chooses)
    kernel[_REACH, _REACH] += 1.0
    finding = _of_kernel(kernel)
    if finding is not None:
        yield Explanation(finding, left, _FILTER_LEFT, 0.05)


def _through(values: NDArray[Any], kernel: NDArray[Any]) -> NDArray[Any]:
    """Values [h, w] through a kernel [k, k], around at the borders."""
    size, reach = values.shape, len(kernel) // 2
    padded = np.zeros(size)
    padded[: len(kernel), : len(kernel)] = kernel
    padded = np.roll(padded, (-reach, -reach), axis=(0, 1))
    through: NDArray[Any] = np.fft.irfft2(np.fft.rfft2(values) * np.fft.rfft2(padded), s=size)
    return through


def _of_kernel(kernel: NDArray[Any]) -> Finding | None:
    """What a filter does, by its moments of second order; None if it only moves or scales."""
    whole = float(kernel.sum())
    if not 0.2 < whole < 5:
        return None
    kernel = kernel / whole
    kept = np.where(np.abs(kernel) > 0.03 * np.abs(kernel).max(), kernel, 0.0)
    kept /= kept.sum()
    steps = np.arange(-_REACH, _REACH + 1.0)
    y, x = (float((kept.sum(axis=axis) * steps).sum()) for axis in (1, 0))
    dy, dx = steps[:, None] - y, steps[None, :] - x
    moments = [float((kept * each).sum()) for each in (dx * dx + 0 * dy, dy * dy + 0 * dx, dx * dy)]
    (small, large), _ = np.linalg.eigh([[moments[0], moments[2]], [moments[2], moments[1]]])
    if math.hypot(x, y) > 0.3:  # it moves
        return None
    if large > 0.3 and large > _LONG * max(small, 0.02) and small > -0.5:
        angle = 0.5 * math.degrees(math.atan2(-2 * moments[2], moments[0] - moments[1]))
        length = math.sqrt(12 * large)
        text = f"motion blur: {length:.2g} px at {angle:.0f}°"
        return Finding("motion blur", text, {"length": length, "angle": angle})
    if small + large < -0.02 and kernel[_REACH, _REACH] > 1.03:
        return Finding("sharpened", f"sharpened: detail x {float(kernel.max()):.3g}")
    if large > 0.02 and small > 0.0:
        radius = math.sqrt(2 * (small + large))  # of the disc of these moments
        text = f"another CoC: blurred more, everywhere alike, as by a radius of {radius:.2g} px"
        return Finding("another CoC", text, {"radius": radius})
    return None


def _lower_resolution(evidence: Evidence) -> Iterator[Explanation]:
    """B has as much detail as a picture of a half or a quarter of the size, enlarged."""
    whole = evidence.framed[0].copy()
    piece = tuple(
        slice(max(0, (n - _PIECE) // 2), max(0, (n - _PIECE) // 2) + _PIECE) for n in whole.shape
    )
    a, b = (side[piece] for side in evidence.framed)
    cut = np.zeros(whole.shape, bool)
    cut[piece] = True
    sure = ~evidence.clipped_near[piece]
    firsts = [one.start + part.start for one, part in zip(evidence.frame, piece, strict=True)]
    shown = [evidence.scaled_light(side).astype("f8") for side in (a, b)]
    for factor, size in ((2, "half"), (4, "a quarter of the")):
        for how in ("nearest", "bilinear", "bicubic"):
            ways = [
                _enlarging(n, first % factor, factor, how)
                for n, first in zip(a.shape, firsts, strict=True)
            ]
            # Detail that a lower resolution cannot have, of A and of B.
            lost, other = (
                side - evidence.scaled_light(_nearest_enlarged(light, ways))
                for side, light in zip(shown, (a, b), strict=True)
            )
            kept = abs(float((lost * other)[sure].sum()))
            kept /= max(float((lost * lost)[sure].sum()), 1e-300)
            if kept > _DETAIL_KEPT:
                continue
            small = [_reduced(a, ways)]
            if how == "nearest":  # pixels may have been left out, too
                rows, columns = (way.argmax(axis=0)[way.argmax(axis=1)] for way in ways)
                small.append(a[rows][:, columns])
            text = f"lower resolution: {size} resolution, {how}"
            finding = Finding("lower resolution", text, {"factor": factor})
            left = math.inf
            for predicted in small:
                whole[piece] = predicted
                left = min(left, evidence.left_framed(whole, cut))
            cost = kept + 0.02 * factor - 0.2 * (kept < _NONE_KEPT)
            yield Explanation(finding, left, _RESOLUTION_LEFT, cost)


def _enlarging(length: int, first: int, factor: int, how: str) -> NDArray[Any]:
    """The matrix [length, n] that enlarges a line of fewer pixels."""
    places = (np.arange(length) + first + 0.5) / factor - 0.5
    low = np.floor(places).astype(np.intp)
    t = places - low
    known: dict[str, dict[int, NDArray[Any]]] = {
        "nearest": {0: 1.0 * (t < 0.5), 1: 1.0 * (t >= 0.5)},
        "bilinear": {0: 1 - t, 1: t},
        "bicubic": {
            -1: ((-0.5 * t + 1) * t - 0.5) * t,
            0: (1.5 * t - 2.5) * t * t + 1,
            1: ((-1.5 * t + 2) * t + 0.5) * t,
            2: (0.5 * t - 0.5) * t * t,
        },
    }
    count = int(low[-1]) + 2
    matrix = np.zeros((length, count))
    for k, weight in known[how].items():
        np.add.at(matrix, (np.arange(length), (low + k).clip(0, count - 1)), weight)
    return matrix[:, matrix.any(axis=0)]


def _nearest_enlarged(values: NDArray[Any], ways: list[NDArray[Any]]) -> NDArray[Any]:
    """The enlarged picture that is nearest to values [h, w]."""
    for way in ways:
        square = way.T @ way
        square[np.diag_indices(len(square))] += 1e-9
        values = (way @ np.linalg.solve(square, way.T @ values)).T
    return values


def _reduced(values: NDArray[Any], ways: list[NDArray[Any]]) -> NDArray[Any]:
    """Values [h, w] as fewer pixels, means of what they are enlarged to, enlarged again."""
    for way in ways:
        values = (way @ ((way.T @ values) / way.sum(axis=0)[:, None])).T
    return values


def _another_coc(evidence: Evidence) -> Iterator[Explanation]:
    """B is A blurred, or A is B blurred, in each part by as much as it takes; or one way only."""
    a, b = evidence.framed
    if is_noise(*(evidence.scaled_light(side).astype("f8") for side in (a, b))):
        return  # which blur takes away
    weights = _slope(evidence, np.maximum(np.abs(a), np.abs(b))) * ~evidence.clipped_near
    chooses = blocks_in_turn(a.shape, 4)

    def left(one: Any, other: Any, details: list[Any], side: int) -> float:
        """What one, with multiples of details in each part, leaves of the other."""
        columns = [detail * weights for detail in details]
        change = fitted_in_parts(columns, (other - one) * weights, chooses, side)
        predicted = one + change / np.where(weights > 0, weights, 1.0)
        # Where A is B blurred, what B is predicted to be is wrong by as much as A is.
        return evidence.left_framed(predicted if one is a else a + (b - predicted), ~chooses)

    round_ones = []
    for one, other in ((a, b), (b, a)):
        details = [smooth(one, sigma) - one for sigma in _SIGMAS]
        round_ones += [left(one, other, details, side) for side in (16, 32)]
    blurred = min(round_ones)
    finding = _coc_words(a, b, weights)
    if blurred > _ROUND_LEFT:
        name = "another CoC or bokeh shape"
        finding = Finding(name, finding.text.replace(finding.name, name), finding.values)
    yield Explanation(finding, blurred, _COC_LEFT, 0.08)
    for axis, way in ((1, "across"), (0, "down")):
        details = [smooth(a, sigma, (axis,)) - a for sigma in _SIGMAS[1:]]
        moved = left(a, b, details, 32)
        if moved < blurred - 0.1:
            finding = Finding("motion blur", f"motion blur: {way}, in parts")
            yield Explanation(finding, moved, _COC_LEFT, 0.1)


def _coc_words(a: NDArray[Any], b: NDArray[Any], weights: NDArray[Any]) -> Finding:
    """Where B is blurred more, and where less: where its light has less detail, and where more."""
    energy = np.square((b - a) * weights)
    details = [sum(np.square(smooth(side, s) - side) for s in _SIGMAS) for side in (a, b)]
    old, new = (smooth(side, _SPREAD) for side in details)
    more, less = (float(energy[where].sum()) for where in (new < old, new > old))
    share = more / max(more + less, 1e-300)
    shares = {"blurred_more": round(share, 3), "blurred_less": round(1 - share, 3)}
    text = "blurred more in places, less in others"
    if share > _ONE_WAY:
        text = "blurred more"
    elif share < 1 - _ONE_WAY:
        text = "blurred less"
    return Finding("another CoC", f"another CoC: {text}", shares)


def _spread_otherwise(evidence: Evidence) -> Iterator[Explanation]:
    """The same light is spread otherwise within a few pixels, by whatever kernel."""
    a, b = evidence.framed
    weights = _slope(evidence, np.maximum(np.abs(a), np.abs(b)))
    difference = b - a
    if not difference.any() or noise_like(difference * weights):
        return
    # Light that only moved cancels within the reach of the gaussian.
    scale = smooth(weights, _SPREAD)
    kept, moved = (smooth(d, _SPREAD) * scale for d in (difference, np.abs(difference)))
    left = math.sqrt(float(np.square(kept).sum()) / float(np.square(moved).sum()))
    words = _coc_words(a, b, weights)
    how = words.text.partition(": ")[2]
    surely = left < _SURELY_SPREAD and "," not in how
    name = "another CoC or bokeh shape" if surely else "spread otherwise"
    finding = Finding(name, f"{name}: the same light, {how}", words.values)
    yield Explanation(finding, left, _SPREAD_LEFT, 1.0)  # where nothing else explains it


def is_noise(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Whether the difference of two pictures [h, w] has little in common with itself and with A."""
    difference, detail = b - a, a - smooth(a, 1.5)
    return noise_like(difference) and abs(alike(difference, detail)) <= _UNLIKE_DETAIL


def noise_like(difference: NDArray[Any]) -> bool:
    """Whether neighbours of a difference [h, w] have little in common."""
    pairs = (difference[1:], difference[:-1]), (difference[:, 1:], difference[:, :-1])
    return all(abs(alike(*pair)) < _UNLIKE_NEIGHBOURS for pair in pairs)


def alike(x: NDArray[Any], y: NDArray[Any]) -> float:
    """Correlation of two arrays, 0 if one is constant or empty."""
    if not x.size:
        return 0.0
    x, y = x - x.mean(), y - y.mean()
    # Not np.vdot: its threads wait for each other where several processes compare.
    scale = math.sqrt(float(np.square(x).sum()) * float(np.square(y).sum()))
    return float((x * y).sum()) / scale if scale else 0.0


def smooth(values: NDArray[Any], sigma: float, axes: tuple[int, ...] = (0, 1)) -> NDArray[Any]:
    """Values [h, w] through a gaussian along axes; the border is repeated."""
    reach = max(1, math.ceil(3 * sigma))
    weights = np.exp(-(np.arange(reach + 1) ** 2) / (2 * sigma * sigma))
    weights /= weights[0] + 2 * weights[1:].sum()
    for axis in axes:
        line = values.T if axis else values
        padded = np.pad(line, ((reach, reach), (0, 0)), mode="edge")
        mean = weights[0] * line
        for k in range(1, reach + 1):
            mean += weights[k] * (
                padded[reach - k :][: len(line)] + padded[reach + k :][: len(line)]
            )
        values = mean.T if axis else mean
    return values

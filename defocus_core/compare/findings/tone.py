"""Causes that change values in place: exposure, curves, colours, clipping, quantisation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import (
    EXACT,
    Cause,
    Evidence,
    Explanation,
    has_light,
)
from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.metrics import LUMINANCE
from defocus_core.compare.picture import color_layers, layers
from defocus_core.compare.pixels import Pixels
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear
from defocus_core.io.images.primaries import NAMED, between_primaries

_Curve = Callable[[Any], Any]
_MAX_SWAPPED = 4  # channels of a layer whose permutations are tried
_BITS = range(4, 13)
_KNOTS = 40  # of a tone curve
_MIXED = 0.02  # least share of other channels that makes a change of primaries
_NEAR = 0.02  # greatest difference of a matrix from that of known primaries
_GREY = 2e-3  # greatest relative difference of the channels of a grey
_SAME = 2e-3  # greatest relative difference from the limit of what was clipped
_CUT = 0.95  # least share of the pixels beyond the limit that are at it
_MORE = 1.05  # what was cut off is brighter than the limit by this


def clipped_light(pixels: Pixels) -> list[Finding]:
    """The limit that the light of B was clipped at, if it was; looked for in every pair."""
    found = []
    for layer in pixels.color:
        high, limit = (max(_high(pixels, side, name) for name in layer) for side in "ab")
        if not (math.isfinite(high) and high > _MORE * limit > 0):
            continue
        beyond, cut, between = 0, 0, 0
        for name in layer:
            a, b = pixels.plane("a", name), pixels.plane("b", name)
            over = a > (1 + _SAME) * limit
            old, new = a[over].astype(np.float64), b[over].astype(np.float64)
            at_limit = np.abs(new - limit) <= _SAME * limit
            beyond += new.size
            cut += int(np.count_nonzero(at_limit))
            between += int(np.count_nonzero(at_limit & (old < 0.98 * high)))
        plain = abs(limit - 1.0) <= _SAME
        if beyond and cut >= _CUT * beyond and (plain or between >= 3):
            name = f"clipped at {limit:.4g}"
            found.append(Finding(name, name, {"limit": limit, "values": beyond}))
    return found[:1]


def may_be_cut_below(pixels: Pixels) -> bool:
    """Whether numbers of A below 0 are no longer there in B."""
    ends = [(pixels.ranges[0][name][0], pixels.ranges[1][name][0]) for name in pixels.names]
    return any(old < new <= 0 or math.isnan(old + new) for old, new in ends)


def _high(pixels: Pixels, side: str, name: str) -> float:
    """The greatest number of a channel, NaN aside."""
    high = pixels.ranges["ab".index(side)][name][1]
    return float(np.nanmax(pixels.plane(side, name))) if math.isnan(high) else high


def _empty(evidence: Evidence) -> Iterator[Explanation]:
    """B has one value everywhere, or is 0 within the rectangle where it differs."""
    planes = [evidence.pixels.plane("b", name) for name in evidence.names]
    differs = evidence.pixels.greatest > 0
    rows, columns = (np.flatnonzero(differs.any(axis=axis)) for axis in (1, 0))
    top, left, bottom, right = (int(v) for v in (rows[0], columns[0], rows[-1], columns[-1]))
    cut = (slice(top, bottom + 1), slice(left, right + 1))
    values = [plane[cut] for plane in planes]
    if values[0].size < 9 or any((value != value[0, 0]).any() for value in values):
        return
    were = [evidence.pixels.plane("a", name)[cut] for name in evidence.names]
    if all((value == value[0, 0]).all() for value in were) and any(v.any() for v in values):
        return  # A has nothing there that B could lack
    firsts = zip(evidence.names, values, strict=True)
    level = ", ".join(f"{name} {float(value[0, 0]):g}" for name, value in firsts)
    where = f"within {right - left + 1}x{bottom - top + 1} at {left},{top}"
    if all((plane == plane.flat[0]).all() for plane in planes):
        where = "everywhere"
    elif any(value.any() for value in values):
        return
    yield Explanation(0.0, "empty", f": {level} {where}")


def _rounded(evidence: Evidence) -> Iterator[Explanation]:
    a, b = evidence.sampled
    with np.errstate(over="ignore"):
        rounded = a.astype(np.float16).astype(np.float32)
    if np.array_equal(rounded, b):
        yield Explanation(0.0, "rounded to half")


def _clipped(evidence: Evidence) -> Iterator[Explanation]:
    """B is A with all values beyond a limit set to the limit."""
    a, _ = evidence.sampled
    (low, high), (minimum, maximum) = (_range(evidence, side) for side in ("a", "b"))
    ways = [(-math.inf, maximum, "")] * (high > maximum)
    ways += [(minimum, math.inf, " from below")] * (low < minimum)
    if len(ways) == 2:
        ways.append((minimum, maximum, f" and, from below, at {minimum:.4g}"))
    for least, most, how in ways:
        limit = least if most == math.inf else most
        values = {"limit": limit} | ({"lowest": least} if len(how) > 20 else {})
        left = evidence.left(a.clip(least, most))
        yield Explanation(left, f"clipped at {limit:.4g}", how, values, 0.0005 * len(values))


def _range(evidence: Evidence, side: str) -> tuple[float, float]:
    """The least and the greatest finite value of the channels that differ."""
    pixels = evidence.pixels
    ends = [pixels.ranges["ab".index(side)][name] for name in evidence.names]
    if pixels.finite is not None:
        planes = [pixels.plane(side, name)[pixels.finite] for name in evidence.names]
        ends = [(float(plane.min()), float(plane.max())) for plane in planes]
    return min(low for low, _ in ends), max(high for _, high in ends)


def _is_clipped_at_white(evidence: Evidence) -> bool:
    return _range(evidence, "b")[1] <= 1.001 < _range(evidence, "a")[1]


def _quantised(evidence: Evidence) -> Iterator[Explanation]:
    """B is A rounded to the levels of few bits, which A is not on."""
    a, b = evidence.sampled
    if len(np.unique(b[0, :4096])) >= min(4096, a.shape[1]) * 0.9:
        return
    clipped = _is_clipped_at_white(evidence)
    aim = np.clip(a, 0.0, 1.0) if clipped else a
    curves: dict[str, tuple[_Curve, _Curve]] = {"": (np.asarray, np.asarray)}
    if evidence.gamma == 1.0 and float(aim.max()) <= 1.001:
        curves = {" (sRGB-encoded)": (linear_to_srgb, _decoded), **curves}
    for how, (curve, back) in curves.items():
        for bits in _BITS:
            top = 2**bits - 1
            stored = back(np.rint(curve(aim) * top) / np.float32(top))
            left = evidence.left(stored, a <= 1.0 if clipped else None, exact=True)
            yield Explanation(left, f"quantised to {bits} bits", how, {"bits": bits})


def _decoded(values: NDArray[Any]) -> NDArray[Any]:
    return srgb_to_linear(np.maximum(values, 0.0)).astype(np.float32)


def _swapped_channels(evidence: Evidence) -> Iterator[Explanation]:
    """Channels of one layer in another order."""
    for layer in layers(evidence.pixels.names):
        moved = [name for name in layer if name in evidence.names]
        if not (2 <= len(moved) <= _MAX_SWAPPED and len(moved) == len(evidence.names)):
            continue
        own = {name: name.rpartition(".")[2] for name in moved}
        for sources in list(permutations(moved))[1:]:
            pairs = dict(zip(moved, sources, strict=True))
            said = ", ".join(f"{own[n]} is {own[old]}" for n, old in pairs.items() if n != old)
            left = evidence.left(evidence.at("a", *evidence.places, sources))
            yield Explanation(left, "channels swapped", f": {said}", pairs)


def _swapped_views(evidence: Evidence) -> Iterator[Explanation]:
    """The layers of the left and the right view in the place of each other."""
    others = [_other_view(name) for name in evidence.names]
    pairs = zip(others, evidence.names, strict=True)
    if all(other in evidence.pixels.names and other != name for other, name in pairs):
        left = evidence.left(evidence.at("a", *evidence.places, others))
        yield Explanation(left, "left and right swapped")


def _other_view(name: str) -> str:
    for here, there in (("left", "right"), ("right", "left")):
        for spelling in (str.lower, str.capitalize, str.upper):
            if spelling(here) in name:
                return name.replace(spelling(here), spelling(there))
    return name


def _premultiplied(evidence: Evidence) -> Iterator[Explanation]:
    """Colour divided by its alpha, or multiplied once more."""
    alphas = [name[: -len(name.split(".")[-1])] + "A" for name in evidence.names]
    if not all(a in evidence.pixels.names and a not in evidence.names for a in alphas):
        return
    light = evidence.light(evidence.sampled[0])
    alpha = evidence.at("a", *evidence.places, alphas)
    divided = np.where(alpha > 0, light / np.where(alpha > 0, alpha, 1.0), light)
    for how, changed in (("divided", divided), ("multiplied", light * alpha)):
        left = evidence.left(evidence.stored(changed))
        yield Explanation(left, "premultiplication", f": colour {how} by alpha once more")


def _another_exposure(evidence: Evidence) -> Iterator[Explanation]:
    """B is a multiple of A, the same for all channels, or of its own for each."""
    light, aim = map(evidence.light, evidence.sampled)
    weights = _weights(evidence, light) * evidence.steady
    tops, squares = ((weights**2 * light * other).sum(axis=1) for other in (aim, light))
    if not squares.sum():
        return
    factor = float(tops.sum() / squares.sum())
    stops = f" ({np.log2(factor):+.3g} EV)" if factor > 0 else ""
    left = evidence.left(evidence.stored(light * factor), evidence.steady)
    yield Explanation(left, "another exposure", f": x {factor:.4g}{stops}", {"factor": factor})
    if len(light) > 1 and squares.all():
        factors = dict(zip(evidence.names, map(float, tops / squares), strict=True))
        each = ", ".join(f"{name} x {ratio:.4g}" for name, ratio in factors.items())
        left = evidence.left(evidence.stored(light * (tops / squares)[:, None]), evidence.steady)
        how = f" of each channel: {each}"
        yield Explanation(left, "another exposure", how, {"factors": factors}, 0.01)


def _sign_reversed(evidence: Evidence) -> Iterator[Explanation]:
    yield Explanation(evidence.left(-evidence.sampled[0]), "sign reversed", cost=-0.001)


def _weights(evidence: Evidence, light: NDArray[Any]) -> NDArray[Any]:
    """The slope of the scale of differences at some light, 0 where a sample chooses nothing."""
    magnitude = np.maximum(np.abs(light), 0.003)
    slopes = np.where(magnitude < 1.0, magnitude ** (1 / 2.4 - 1), 1.0 / magnitude)
    return np.asarray(slopes * evidence.fits)


def _solved(
    columns: Sequence[NDArray[Any]], aim: NDArray[Any], weights: NDArray[Any]
) -> NDArray[Any]:
    """The multiples of columns that sum up to an aim, by weighted least squares."""
    design = np.stack([(column * weights).ravel() for column in columns])
    square, sums = design @ design.T, design @ (aim * weights).ravel()
    square[np.diag_indices(len(columns))] *= 1 + 1e-12
    solved: NDArray[Any] = np.linalg.lstsq(square, sums, rcond=None)[0]
    return solved


def _another_gamma(evidence: Evidence) -> Iterator[Explanation]:
    """B is a power of A, of its values or of those that a screen shows; or encoded once more."""
    for name, curve in (("sRGB-encoded", linear_to_srgb), ("sRGB-decoded", _decoded)):
        left = evidence.left(curve(evidence.sampled[0]).astype(np.float32))
        yield Explanation(left, "another gamma", f": {name} once more")
    yield from _powers(evidence, np.asarray, np.asarray, "")
    if evidence.gamma == 1.0:
        clipped = _is_clipped_at_white(evidence)
        yield from _powers(evidence, linear_to_srgb, _decoded, ", sRGB-encoded", clipped=clipped)


def _powers(
    evidence: Evidence, curve: _Curve, back: _Curve, how: str, *, clipped: bool = False
) -> Iterator[Explanation]:
    a, b = (curve(np.clip(v, 0, 1) if clipped else v) for v in evidence.sampled)
    usable = (a > 0.02) & (b > 0.02) & evidence.fits & evidence.steady
    if np.count_nonzero(usable) < 16:
        return
    x, y = (np.log(side[usable], dtype=np.float64) for side in (a, b))
    weight = np.minimum(a[usable], 1.0)
    power = float((weight * x * y).sum() / max((weight * x * x).sum(), 1e-300))
    left = evidence.left(back(_power(a, power, 1.0)), evidence.steady)
    said = f": to the power {power:.4g}{how}"
    yield Explanation(left, "another gamma", said, {"power": power}, 0.005)
    if not how and float(np.ptp(x)) > 0.1:
        power, offset = (float(value) for value in np.polyfit(x, y, 1))
        factor = float(np.exp(offset))
        left = evidence.left(_power(a, power, factor), evidence.steady)
        said = f": to the power {power:.4g}, exposure x {factor:.4g}"
        yield Explanation(left, "another gamma", said, {"power": power, "factor": factor}, 0.02)


def _power(values: NDArray[Any], power: float, factor: float) -> NDArray[Any]:
    magnitude = np.abs(values).astype(np.float64)
    with np.errstate(divide="ignore", over="ignore"):
        scaled = np.where(magnitude > 0, magnitude**power, 0.0) * factor
    signed: NDArray[Any] = np.sign(values) * np.minimum(scaled, 1e30)
    return signed.astype(np.float32)


def _raised(evidence: Evidence) -> Iterator[Explanation]:
    """B is a multiple of A and a constant: of light, or of the values that a screen shows.

    Of these it is another contrast, if they turn around a middle.
    """
    a, b = evidence.sampled
    steady = evidence.steady & (b > _range(evidence, "b")[0])
    light, aim = evidence.light(a), evidence.light(b)
    weights = _weights(evidence, light) * steady
    for free in (False, True):
        columns = [np.ones_like(light), light][: 1 + free]
        solved = _solved(columns, aim if free else aim - light, weights)
        offset, factor = float(solved[0]), float(solved[1]) if free else 1.0
        left = evidence.left(evidence.stored(factor * light + offset), steady)
        yield _lifted(left, offset, factor, "light", 0.01 + 0.01 * free)
    if evidence.pixels.color:
        steady = steady & (a <= 1.0)
        shown, new = (evidence.scaled(side).astype(np.float64) for side in (a, b))
        chosen = 1.0 * (steady & evidence.fits)
        offset, factor = map(float, _solved([np.ones_like(shown), shown], new, chosen))
        left = evidence.left(evidence.unscaled(factor * shown + offset), steady)
        pivot = offset / (1 - factor) if factor != 1 else math.inf
        if 0.1 < pivot < 0.9:
            values = {"offset": offset, "factor": factor, "pivot": pivot}
            how = f": x {factor:.4g} around {pivot:.3g}"
            yield Explanation(left, "another contrast", how, values, 0.02)
        else:
            yield _lifted(left, offset, factor, "what a screen shows", 0.02)
    if len(light) > 1:
        steady = evidence.steady & (b > _range(evidence, "b")[0])
        sums = ((aim - light) * weights**2).sum(axis=1) / np.maximum((weights**2).sum(axis=1), 1e-9)
        left = evidence.left(evidence.stored(light + sums[:, None]), steady)
        offsets = dict(zip(evidence.names, map(float, sums), strict=True))
        each = ", ".join(f"{name} {value:+.3g}" for name, value in offsets.items())
        said = _blacks(sums.sum()), f": {each} of light"
        yield Explanation(left, *said, {"offsets": offsets}, 0.03)


def _lifted(left: float, offset: float, factor: float, of: str, cost: float) -> Explanation:
    how = f": {offset:+.3g} of {of}" + f", x {factor:.4g}" * (factor != 1.0)
    return Explanation(left, _blacks(offset), how, {"offset": offset, "factor": factor}, cost)


def _blacks(offset: float) -> str:
    return "raised blacks" if offset > 0 else "lowered blacks"


def _mixed_channels(evidence: Evidence) -> Iterator[Explanation]:
    """The channels of the only layer of R, G and B mixed by a matrix, of light or as shown.

    It makes the picture grey, changes the distances to luma by a factor, or is that of primaries.
    """
    found = [each for each in color_layers(evidence.pixels.names) if len(each) == 3]
    if len(found) != 1 or not set(evidence.names) <= set(found[0]):
        return
    (layer,) = found
    kept = [layer.index(name) for name in evidence.names]
    stored = [evidence.at(side, *evidence.places, layer) for side in ("a", "b")]
    dark = _range(evidence, "b")[0] == 0.0  # what would be negative may have become 0
    light: list[NDArray[Any]] = [evidence.light(side) for side in stored]
    lit = (light[1] > 0.0).all(axis=0) | (not dark)
    weights = _weights(evidence, light[0]) * (lit & evidence.steady.all(axis=0))
    shown = [evidence.scaled_light(side).astype(np.float64) for side in light]
    grey = _is_grey(stored[1]) and not _is_grey(stored[0]) and np.ptp(stored[1]) > 0
    for of, (old, new), weight, back in (
        ("", light, weights, evidence.stored),
        ("a screen shows", shown, 1.0 * (weights > 0), evidence.unscaled),
    ):
        for matrix, name, how, values, cost in _matrices(layer, old, new, weight, of, grey=grey):
            predicted = matrix @ old
            predicted = back(np.maximum(predicted, 0.0) if dark else predicted)[kept]
            left = evidence.left(
                np.asarray(predicted, np.float32), None if grey else evidence.steady
            )
            yield Explanation(left, name, f": {how}", values, cost)


def _is_grey(values: NDArray[Any]) -> bool:
    """Whether three channels [3, N] are equal."""
    return bool(np.ptp(values, axis=0).max() <= _GREY * max(float(values.max()), 1e-9))


def _matrices(
    layer: Sequence[str],
    old: NDArray[Any],
    new: NDArray[Any],
    weight: NDArray[Any],
    of: str,
    *,
    grey: bool,
) -> Iterator[tuple[NDArray[Any], str, str, dict[str, Any], float]]:
    """Matrices that make light of light, or what a screen shows, with words, values and cost."""
    shown = f" of what {of}" if of else ""
    if grey:
        shares = _solved(list(old), new[0], weight)
        how = " ".join(f"{s:+.2f} {n}" for n, s in zip(layer, shares, strict=True)).lstrip("+")
        values = {"weights": dict(zip(layer, map(float, shares), strict=True))}
        how += f" as {of} it" * bool(of)
        yield np.tile(shares, (3, 1)), "monochrome", how, values, -0.02
    luma = np.tile(LUMINANCE, (3, 1))
    factor = float(_solved([old - luma @ old], new - luma @ old, weight)[0])
    changed, how = luma + factor * (np.eye(3) - luma), f"x {factor:.4g}{shown}"
    yield changed, "another saturation", how, {"factor": factor}, 0.01
    matrix = np.stack([_solved(list(old), each, w) for each, w in zip(new, weight, strict=True)])
    if not of and np.abs(matrix - np.diag(np.diag(matrix))).max() >= _MIXED:
        yield matrix, "other primaries", _primaries(matrix), {"matrix": matrix.tolist()}, 0.03


def _primaries(matrix: NDArray[Any]) -> str:
    """What a matrix of colours does, in words."""
    apart = {
        f"{new} instead of {old}": float(np.abs(known - matrix).max())
        for old, new in permutations(NAMED, 2)
        if (known := between_primaries(NAMED[old], NAMED[new])) is not None
    }
    nearest = min(apart, key=lambda pair: apart[pair])
    return nearest if apart[nearest] < _NEAR else "channels mixed by a matrix"


def _vignette(evidence: Evidence) -> Iterator[Explanation]:
    """B is A times a polynomial of the distance to the middle of the picture."""
    height, width = evidence.size
    rows, columns = evidence.places
    y, x = rows / max(height - 1, 1) - 0.5, columns / max(width - 1, 1) - 0.5
    light, aim = map(evidence.light, evidence.sampled)
    weights = _weights(evidence, light) * evidence.steady
    for shape in (height / width, 1.0):  # round, or as wide as the picture
        far = ((y * shape) ** 2 + x * x) / (0.25 * (1 + shape * shape))
        for powers in (1, 2):
            terms = [light * far**k for k in range(1, powers + 1)]
            solved = _solved(terms, aim - light, weights)
            gain = 1 + sum(c * far**k for k, c in enumerate(solved, 1))
            left = evidence.left(evidence.stored(light * gain), evidence.steady)
            corners = 1 + float(solved.sum())
            how, values = f": corners x {corners:.3g}", {"corners": corners}
            yield Explanation(left, "vignette", how, values, 0.02 * powers)


def _tone_curve(evidence: Evidence) -> Iterator[Explanation]:
    """B is a curve of A that rises everywhere, the same for all channels or each with its own."""
    a, b = (evidence.scaled(side).astype(np.float64) for side in evidence.sampled)
    fits = np.broadcast_to(evidence.fits, a.shape) & evidence.steady
    curves = [_curved(a, b, fits)], [_curved(*sides) for sides in zip(a, b, fits, strict=True)]
    for how, each, cost in (("", curves[0], 0.05), (" of each channel", curves[1], 0.08)):
        if all(curve is not None for curve in each):
            stored = evidence.unscaled(np.stack(each).reshape(a.shape))
            left = evidence.left(stored, evidence.steady)
            yield Explanation(left, "another tone curve", how, cost=cost)


def _curved(old: NDArray[Any], new: NDArray[Any], used: NDArray[np.bool_]) -> Any:
    """The curve of the samples that are used at all of them; None if it falls somewhere."""
    x, y = old[used], new[used]
    if x.size < 4 * _KNOTS:
        return None
    knots = np.unique(np.quantile(x, np.linspace(0, 1, _KNOTS + 1)))
    place = np.searchsorted(knots, x, side="right").clip(1, max(len(knots) - 1, 1)) - 1
    counts = np.bincount(place, minlength=len(knots))
    sums = (np.bincount(place, weights=v, minlength=len(knots)) for v in (x, y))
    centres, values = (total[counts > 0] / counts[counts > 0] for total in sums)
    if len(centres) < 3 or (np.diff(values) < -0.004).any():
        return None
    slope = np.diff(values)[[0, -1]] / np.maximum(np.diff(centres)[[0, -1]], 1e-9)
    below, above = np.minimum(old - centres[0], 0), np.maximum(old - centres[-1], 0)
    return np.interp(old, centres, values) + slope[0] * below + slope[1] * above


TONE = (
    Cause(_empty),
    Cause(_rounded),
    Cause(_quantised, EXACT),
    Cause(_clipped, EXACT),
    Cause(_swapped_channels),
    Cause(_swapped_views),
    Cause(_premultiplied, needs=has_light),
    Cause(_sign_reversed),
    Cause(_another_exposure),
    Cause(_another_gamma),
    Cause(_raised),
    Cause(_vignette, needs=has_light),
    Cause(_mixed_channels, needs=has_light),
    Cause(_tone_curve, needs=has_light),
)

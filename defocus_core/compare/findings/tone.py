"""Causes that change values in place: exposure, curves, colours, clipping, quantisation."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.compare.findings.evidence import EXACT, Cause, Evidence, FittedCause
from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.picture import color_layers, layers
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear
from defocus_core.io.images.primaries import NAMED, between_primaries

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from defocus_core.compare.pixels import Pixels

_MAX_SWAPPED = 4  # channels of a layer whose permutations are tried
_BITS = range(4, 13)
_KNOTS = 40  # of a tone curve
_LUMA = (0.2126, 0.7152, 0.0722)  # of Rec. 709
_MIXED = 0.02  # least share of other channels that makes a change of primaries
_NEAR = 0.02  # greatest difference of a matrix from that of known primaries
_GREY = 2e-3  # greatest relative difference of the channels of a grey
_SAME = 2e-3  # greatest relative difference from the limit
_CUT = 0.95  # least share of the pixels beyond the limit that are at it
_MORE = 1.05  # what was cut off is brighter than the limit by this


def _empty(evidence: Evidence) -> Iterator[FittedCause]:
    """B has one value everywhere, or is 0 within the rectangle where it differs."""
    planes = [evidence.pixels.plane("b", name) for name in evidence.names]
    differs = evidence.pixels.greatest > 0
    rows, columns = (np.flatnonzero(differs.any(axis=axis)) for axis in (1, 0))
    top, left, bottom, right = (int(v) for v in (rows[0], columns[0], rows[-1], columns[-1]))
    cut = (slice(top, bottom + 1), slice(left, right + 1))
    if (bottom - top + 1) * (right - left + 1) < 9:
        return
    values = [plane[cut] for plane in planes]
    if any((value != value[0, 0]).any() for value in values):
        return
    were = [evidence.pixels.plane("a", name)[cut] for name in evidence.names]
    if all((value == value[0, 0]).all() for value in were) and any(v.any() for v in values):
        return  # A has nothing there that B could lack
    level = ", ".join(
        f"{n} {float(v[0, 0]):g}" for n, v in zip(evidence.names, values, strict=True)
    )
    where = f"within {right - left + 1}x{bottom - top + 1} at {left},{top}"
    if all((plane == plane.flat[0]).all() for plane in planes):
        where = "everywhere"
    elif any(value.any() for value in values):
        return
    yield FittedCause(0.0, said={"level": level, "where": where})


def _rounded(evidence: Evidence) -> Iterator[FittedCause]:
    a, b = evidence.sampled
    with np.errstate(over="ignore"):
        rounded = a.astype(np.float16).astype(np.float32)
    if np.array_equal(rounded, b):
        yield FittedCause(0.0)


def _clipped(evidence: Evidence) -> Iterator[FittedCause]:
    """B is A with all values beyond a limit set to the limit."""
    a, _ = evidence.sampled
    (low, high), (minimum, maximum) = (_range(evidence, side) for side in ("a", "b"))
    above, below = high > maximum, low < minimum
    if above:
        left = evidence.left(np.minimum(a, np.float32(maximum)))
        yield FittedCause(left, {"limit": maximum}, {"how": ""})
    if below:
        left = evidence.left(np.maximum(a, np.float32(minimum)))
        yield FittedCause(left, {"limit": minimum}, {"how": " from below"})
    if above and below:
        how = f" and, from below, at {minimum:.4g}"
        left = evidence.left(np.clip(a, minimum, maximum))
        yield FittedCause(left, {"limit": maximum, "lowest": minimum}, {"how": how}, 0.001)


def _range(evidence: Evidence, side: str) -> tuple[float, float]:
    """The least and the greatest finite value of the channels that differ."""
    pixels = evidence.pixels
    ends = [pixels.ranges["ab".index(side)][name] for name in evidence.names]
    if pixels.finite is not None:
        planes = [pixels.plane(side, name)[pixels.finite] for name in evidence.names]
        ends = [(float(plane.min()), float(plane.max())) for plane in planes]
    return min(low for low, _ in ends), max(high for _, high in ends)


def _quantised(evidence: Evidence) -> Iterator[FittedCause]:
    """B is A rounded to the levels of few bits, which A is not on."""
    a, b = evidence.sampled
    if len(np.unique(b[0, :4096])) >= min(4096, a.shape[1]) * 0.9:
        return
    clipped = _range(evidence, "b")[1] <= 1.001 < _range(evidence, "a")[1]
    aim = np.clip(a, 0.0, 1.0) if clipped else a
    curves: dict[str, tuple[Any, Any]] = {"": (_as_it_is, _as_it_is)}
    if evidence.gamma == 1.0 and float(aim.max()) <= 1.001:
        curves = {" (sRGB-encoded)": (linear_to_srgb, _decoded), **curves}
    for how, (curve, back) in curves.items():
        for bits in _BITS:
            top = 2**bits - 1
            stored = back(np.rint(curve(aim) * top) / np.float32(top))
            left = evidence.left(stored, a <= 1.0 if clipped else None, exact=True)
            yield FittedCause(left, {"bits": bits}, {"how": how})


def _as_it_is(values: NDArray[Any]) -> NDArray[Any]:
    return values


def _decoded(values: NDArray[Any]) -> NDArray[Any]:
    return srgb_to_linear(np.maximum(values, 0.0)).astype(np.float32)


def _swapped_channels(evidence: Evidence) -> Iterator[FittedCause]:
    """Channels of one layer in another order."""
    for layer in layers(evidence.pixels.names):
        moved = [name for name in layer if name in evidence.names]
        if not (2 <= len(moved) <= _MAX_SWAPPED and len(moved) == len(evidence.names)):
            continue
        for order in permutations(range(len(moved))):
            if list(order) == sorted(order):
                continue
            sources = [moved[index] for index in order]
            pairs = [f"{new} is {old}" for new, old in zip(moved, sources, strict=True)]
            said = ", ".join(_own(pair) for pair in pairs if len(set(pair.split(" is "))) > 1)
            predicted = evidence.at("a", *evidence.places, sources)
            values = dict(zip(moved, sources, strict=True))
            yield FittedCause(evidence.left(predicted), values, {"how": said})


def _swapped_views(evidence: Evidence) -> Iterator[FittedCause]:
    """The layers of the left and the right view in the place of each other."""
    names = evidence.pixels.names
    views = {name: _other_view(name) for name in evidence.names}
    if views and all(other in names and other != name for name, other in views.items()):
        yield FittedCause(evidence.left(evidence.at("a", *evidence.places, list(views.values()))))


def _own(text: str) -> str:
    return " ".join(word.rpartition(".")[2] for word in text.split(" "))


def _other_view(name: str) -> str:
    for here, there in (("left", "right"), ("right", "left")):
        for spelling in (str.lower, str.capitalize, str.upper):
            if spelling(here) in name:
                return name.replace(spelling(here), spelling(there))
    return name


def _premultiplied(evidence: Evidence) -> Iterator[FittedCause]:
    """Colour divided by its alpha, or multiplied once more."""
    names = evidence.pixels.names
    alphas = {name: name[: -len(name.split(".")[-1])] + "A" for name in evidence.names}
    if not all(alpha in names and alpha not in evidence.names for alpha in alphas.values()):
        return
    light = evidence.light(evidence.sampled[0])
    alpha = evidence.at("a", *evidence.places, list(alphas.values()))
    divided = np.where(alpha > 0, light / np.where(alpha > 0, alpha, 1.0), light)
    for text, changed in (("divided by alpha", divided), ("multiplied by alpha", light * alpha)):
        yield FittedCause(evidence.left(evidence.stored(changed)), said={"how": text})


def _factors(evidence: Evidence) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Light of A, and what makes that of B of it: tops / squares of each channel."""
    a, b = evidence.sampled
    light, aim = evidence.light(a), evidence.light(b)
    weights = _weights(evidence, light) * evidence.steady
    tops = (weights * aim * light * weights).sum(axis=1)
    return light, tops, np.square(weights * light).sum(axis=1)


def _another_exposure(evidence: Evidence) -> Iterator[FittedCause]:
    """B is a multiple of A, the same for all channels."""
    light, tops, squares = _factors(evidence)
    if squares.sum():
        factor = float(tops.sum() / squares.sum())
        stops = f" ({np.log2(factor):+.3g} EV)" if factor > 0 else ""
        left = evidence.left(evidence.stored(light * factor), evidence.steady)
        yield FittedCause(left, {"factor": factor}, {"stops": stops})


def _exposure_of_channels(evidence: Evidence) -> Iterator[FittedCause]:
    """Each channel of B is a multiple of its own of that of A."""
    light, tops, squares = _factors(evidence)
    if len(light) > 1 and squares.all():
        ratios = tops / squares
        each = ", ".join(f"{n} x {r:.4g}" for n, r in zip(evidence.names, ratios, strict=True))
        factors = dict(zip(evidence.names, map(float, ratios), strict=True))
        scaled = evidence.stored(light * ratios[:, None])
        left = evidence.left(scaled, evidence.steady)
        yield FittedCause(left, {"factors": factors}, {"each": each}, 0.01)


def _sign_reversed(evidence: Evidence) -> Iterator[FittedCause]:
    yield FittedCause(evidence.left(-evidence.sampled[0]), cost=-0.001)


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


def _encoded_again(evidence: Evidence) -> Iterator[FittedCause]:
    """A curve was applied once more."""
    for name, curve in (("sRGB-encoded", linear_to_srgb), ("sRGB-decoded", _decoded)):
        left = evidence.left(curve(evidence.sampled[0]).astype(np.float32))
        yield FittedCause(left, said={"how": name})


def _another_gamma(evidence: Evidence) -> Iterator[FittedCause]:
    """B is a power of A, of its values or of those that a screen shows."""
    yield from _powers(evidence, _as_it_is, _as_it_is, "")
    if evidence.gamma == 1.0:
        clipped = _range(evidence, "b")[1] <= 1.001 < _range(evidence, "a")[1]
        how = ", sRGB-encoded"
        yield from _powers(evidence, linear_to_srgb, _decoded, how, clipped=clipped)


def _powers(
    evidence: Evidence,
    curve: Callable[[Any], Any],
    back: Callable[[Any], Any],
    how: str,
    *,
    clipped: bool = False,
) -> Iterator[FittedCause]:
    a, b = (curve(np.clip(v, 0, 1) if clipped else v) for v in evidence.sampled)
    usable = (a > 0.02) & (b > 0.02) & evidence.fits & evidence.steady
    if np.count_nonzero(usable) < 16:
        return
    x, y = (np.log(side[usable], dtype=np.float64) for side in (a, b))
    weight = np.minimum(a[usable], 1.0)
    power = float((weight * x * y).sum() / max((weight * x * x).sum(), 1e-300))
    left = evidence.left(back(_power(a, power, 1.0)), evidence.steady)
    yield FittedCause(left, {"power": power}, {"how": how}, 0.005)
    if not how and float(np.ptp(x)) > 0.1:
        power, offset = (float(value) for value in np.polyfit(x, y, 1))
        factor = float(np.exp(offset))
        left = evidence.left(_power(a, power, factor), evidence.steady)
        how = f", exposure x {factor:.4g}"
        yield FittedCause(left, {"power": power, "factor": factor}, {"how": how}, 0.02)


def _power(values: NDArray[Any], power: float, factor: float) -> NDArray[Any]:
    magnitude = np.abs(values).astype(np.float64)
    with np.errstate(divide="ignore", over="ignore"):
        scaled = np.where(magnitude > 0, magnitude**power, 0.0) * factor
    signed: NDArray[Any] = np.sign(values) * np.minimum(scaled, 1e30)
    return signed.astype(np.float32)


def _raised(evidence: Evidence) -> Iterator[FittedCause]:
    """B is a multiple of A and a constant: of light, or of the values that a screen shows."""
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
    offset, factor, left = _line_of_shown(evidence)
    if not _turns_in_the_middle(offset, factor):
        yield _lifted(left, offset, factor, "what a screen shows", 0.02)
    if len(light) > 1:
        sums = ((aim - light) * weights**2).sum(axis=1) / np.maximum((weights**2).sum(axis=1), 1e-9)
        left = evidence.left(evidence.stored(light + sums[:, None]), steady)
        each = ", ".join(f"{n} {v:+.3g}" for n, v in zip(evidence.names, sums, strict=True))
        said = {"way": "raised" if sums.sum() > 0 else "lowered", "how": f"{each} of light"}
        yield FittedCause(
            left, {"offsets": dict(zip(evidence.names, map(float, sums), strict=True))}, said, 0.03
        )


def _lifted(left: float, offset: float, factor: float, of: str, cost: float) -> FittedCause:
    how = f"{offset:+.3g} of {of}" + f", x {factor:.4g}" * (factor != 1.0)
    said = {"way": "raised" if offset > 0 else "lowered", "how": how}
    return FittedCause(left, {"offset": offset, "factor": factor}, said, cost)


def _another_contrast(evidence: Evidence) -> Iterator[FittedCause]:
    """B is A stretched around a middle, as a screen shows it."""
    offset, factor, left = _line_of_shown(evidence)
    if _turns_in_the_middle(offset, factor):
        values = {"offset": offset, "factor": factor, "pivot": offset / (1 - factor)}
        yield FittedCause(left, values, cost=0.02)


def _turns_in_the_middle(offset: float, factor: float) -> bool:
    return factor != 1 and 0.1 < offset / (1 - factor) < 0.9


@lru_cache(maxsize=1)
def _line_of_shown(evidence: Evidence) -> tuple[float, float, float]:
    """What a screen shows of B by that of A: offset, factor, and what they leave."""
    a, b = evidence.sampled
    if not evidence.pixels.color:
        return 0.0, 1.0, np.inf
    steady = evidence.steady & (b > _range(evidence, "b")[0]) & (a <= 1.0)
    shown, aim = (evidence.scaled(side).astype(np.float64) for side in (a, b))
    offset, factor = _solved([np.ones_like(shown), shown], aim, 1.0 * (steady & evidence.fits))
    left = evidence.left(evidence.unscaled(factor * shown + offset), steady)
    return float(offset), float(factor), left


def _layer(evidence: Evidence) -> tuple[str, ...] | None:
    """The only layer of R, G and B, if nothing else differs."""
    layers_of = [each for each in color_layers(evidence.pixels.names) if len(each) == 3]
    if len(layers_of) != 1 or not set(evidence.names) <= set(layers_of[0]):
        return None
    return layers_of[0]


def _monochrome(evidence: Evidence) -> Iterator[FittedCause]:
    """B is grey, each pixel by the same sum of the channels of A, of light or as shown."""
    layer = _layer(evidence)
    if layer is None:
        return
    old, new = (evidence.at(side, *evidence.places, layer) for side in ("a", "b"))
    if np.ptp(new, axis=0).max() > _GREY * float(new.max()) or not np.ptp(new):
        return
    if np.ptp(old, axis=0).max() <= _GREY * max(float(old.max()), 1e-9):
        return
    kept = [layer.index(name) for name in evidence.names]
    for how, (columns, aim), back in (
        ("", [evidence.light(v) for v in (old, new)], evidence.stored),
        (" as a screen shows it", [evidence.scaled(v) for v in (old, new)], evidence.unscaled),
    ):
        shares = _solved(list(columns), aim[0], 1.0 * evidence.fits)
        predicted = back(np.tensordot(shares, columns, 1)[None].repeat(3, axis=0))[kept]
        said = " ".join(f"{s:+.2f} {n}" for n, s in zip(layer, shares, strict=True))
        weights = dict(zip(layer, map(float, shares), strict=True))
        left = evidence.left(np.asarray(predicted, np.float32))
        yield FittedCause(left, {"weights": weights}, {"how": said.lstrip("+") + how}, -0.02)


def _another_saturation(evidence: Evidence) -> Iterator[FittedCause]:
    """The distances of the channels to luma times a factor, of light or as a screen shows it."""
    layer = _layer(evidence)
    if layer is None:
        return
    light, aim, weights, dark = _of_layer(evidence, layer)
    kept = [layer.index(name) for name in evidence.names]
    shown = [evidence.scaled_light(side).astype(np.float64) for side in (light, aim)]
    for how, (old, new), weight in (
        ("", (light, aim), weights),
        (" of what a screen shows", shown, 1.0 * (weights > 0)),
    ):
        luma = np.tensordot(_LUMA, old, 1)
        factor = float(_solved([old - luma], new - luma, weight)[0])
        predicted = luma + factor * (old - luma)
        predicted = np.maximum(predicted, 0.0) if dark else predicted
        stored = evidence.unscaled(predicted) if how else evidence.stored(predicted)
        left = evidence.left(stored[kept], evidence.steady)
        yield FittedCause(left, {"factor": factor}, {"how": how}, 0.01)


def _of_layer(
    evidence: Evidence, layer: Sequence[str]
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], bool]:
    """Light of a layer of A and of B, weights that choose, and whether B is cut off at 0."""
    light, aim = (evidence.light(evidence.at(s, *evidence.places, layer)) for s in ("a", "b"))
    dark = _range(evidence, "b")[0] == 0.0  # what would be negative may have become 0
    weights = _weights(evidence, light) * ((aim > 0.0).all(axis=0) if dark else 1.0)
    if evidence.gamma != 1.0:
        weights = weights * evidence.steady.all(axis=0)
    return light, aim, weights, dark


def _other_primaries(evidence: Evidence) -> Iterator[FittedCause]:
    """The channels of one layer mixed by a matrix."""
    layer = _layer(evidence)
    if layer is None:
        return
    light, aim, weights, dark = _of_layer(evidence, layer)
    rows = [_solved(list(light), channel, w) for channel, w in zip(aim, weights, strict=True)]
    matrix = np.stack(rows)
    if np.abs(matrix - np.diag(np.diag(matrix))).max() < _MIXED:
        return
    predicted = matrix @ light
    stored = evidence.stored(np.maximum(predicted, 0.0) if dark else predicted)
    left = evidence.left(stored[[layer.index(name) for name in evidence.names]], evidence.steady)
    yield FittedCause(left, {"matrix": matrix.tolist()}, {"how": _primaries(matrix)}, 0.03)


def _primaries(matrix: NDArray[Any]) -> str:
    """What a matrix of colours does, in words."""
    apart = {
        f"{new} instead of {old}": float(np.abs(known - matrix).max())
        for old, new in permutations(NAMED, 2)
        if (known := between_primaries(NAMED[old], NAMED[new])) is not None
    }
    nearest = min(apart, key=lambda pair: apart[pair])
    return nearest if apart[nearest] < _NEAR else "channels mixed by a matrix"


def _vignette(evidence: Evidence) -> Iterator[FittedCause]:
    """B is A times a polynomial of the distance to the middle of the picture."""
    height, width = evidence.size
    rows, columns = evidence.places
    y, x = rows / max(height - 1, 1) - 0.5, columns / max(width - 1, 1) - 0.5
    a, b = evidence.sampled
    light, aim = evidence.light(a), evidence.light(b)
    weights = _weights(evidence, light) * evidence.steady
    for shape in (height / width, 1.0):  # round, or as wide as the picture
        far = ((y * shape) ** 2 + x * x) / (0.25 * (1 + shape * shape))
        for powers in (1, 2):
            terms = [light * far**k for k in range(1, powers + 1)]
            solved = _solved(terms, aim - light, weights)
            gain = 1 + sum(c * far**k for k, c in enumerate(solved, 1))
            corners = 1 + float(solved.sum())
            left = evidence.left(evidence.stored(light * gain), evidence.steady)
            yield FittedCause(left, {"corners": corners}, cost=0.02 * powers)


def _tone_curve(evidence: Evidence) -> Iterator[FittedCause]:
    """B is a curve of A that rises everywhere, the same for all channels or each with its own."""
    a, b = (evidence.scaled(side).astype(np.float64) for side in evidence.sampled)
    fits = np.broadcast_to(evidence.fits, a.shape) & evidence.steady

    def curved(old: NDArray[Any], new: NDArray[Any], used: NDArray[np.bool_]) -> Any:
        """The curve of some samples at all of them; None if it falls somewhere."""
        x, y = old[used], new[used]
        if x.size < 4 * _KNOTS:
            return None
        knots = np.unique(np.quantile(x, np.linspace(0, 1, _KNOTS + 1)))
        place = np.searchsorted(knots, x, side="right").clip(1, max(len(knots) - 1, 1)) - 1
        counts = np.bincount(place, minlength=len(knots))
        there = counts > 0
        centres, values = (
            np.bincount(place, weights=v, minlength=len(knots))[there] / counts[there]
            for v in (x, y)
        )
        if len(centres) < 3 or (np.diff(values) < -0.004).any():
            return None
        slope = np.diff(values)[[0, -1]] / np.maximum(np.diff(centres)[[0, -1]], 1e-9)
        below, above = np.minimum(old - centres[0], 0), np.maximum(old - centres[-1], 0)
        return np.interp(old, centres, values) + slope[0] * below + slope[1] * above

    whole = curved(a, b, fits)
    each = [curved(*sides) for sides in zip(a, b, fits, strict=True)]
    for how, predicted, cost in (
        ("", whole, 0.05),
        (" of each channel", None if any(c is None for c in each) else np.stack(each), 0.08),
    ):
        if predicted is not None:
            stored = evidence.unscaled(predicted)
            yield FittedCause(evidence.left(stored, evidence.steady), said={"how": how}, cost=cost)


TONE = (
    Cause("empty", _empty, "empty: {level} {where}"),
    Cause("rounded to half", _rounded),
    Cause("quantised to {bits} bits", _quantised, "quantised to {bits} bits{how}", EXACT),
    Cause("clipped at {limit:.4g}", _clipped, "clipped at {limit:.4g}{how}", EXACT),
    Cause("channels swapped", _swapped_channels, "channels swapped: {how}"),
    Cause("left and right swapped", _swapped_views),
    Cause(
        *("premultiplication", _premultiplied, "premultiplication: colour {how} once more"),
        of_color=True,
    ),
    Cause("sign reversed", _sign_reversed),
    Cause("another exposure", _another_exposure, "another exposure: x {factor:.4g}{stops}"),
    Cause(
        *("another exposure", _exposure_of_channels),
        "another exposure of each channel: {each}",
    ),
    Cause("another gamma", _encoded_again, "another gamma: {how} once more"),
    Cause("another gamma", _another_gamma, "another gamma: to the power {power:.4g}{how}"),
    Cause("{way} blacks", _raised, "{way} blacks: {how}"),
    Cause(
        *("another contrast", _another_contrast),
        "another contrast: x {factor:.4g} around {pivot:.3g}",
    ),
    Cause("vignette", _vignette, "vignette: corners x {corners:.3g}", of_color=True),
    Cause("monochrome", _monochrome, "monochrome: {how}", of_color=True),
    Cause(
        *("another saturation", _another_saturation),
        "another saturation: x {factor:.4g}{how}",
        of_color=True,
        of_many=True,
    ),
    Cause(
        *("other primaries", _other_primaries, "other primaries: {how}"),
        of_color=True,
        of_many=True,
    ),
    Cause(
        *("another tone curve", _tone_curve, "another tone curve{how}"),
        of_color=True,
        of_many=True,
    ),
)


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

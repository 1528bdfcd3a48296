"""Explanations that change values in place: exposure, curves, colours, clipping, quantisation."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.compare.findings.evidence import EXACT, Evidence, Explanation
from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.picture import color_layers, layers
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

_MAX_SWAPPED = 4  # channels of a layer whose permutations are tried
_BITS = range(4, 13)
_KNOTS = 40  # of a tone curve
_LUMA = (0.2126, 0.7152, 0.0722)  # of Rec. 709
_MIXED = 0.02  # least share of other channels that makes a change of primaries
_D65 = (0.3127, 0.3290)
# Chromaticities x, y of R, G and B with a white of D65: ITU-R BT.709, BT.2020, SMPTE EG 432-1.
_PRIMARIES = {
    "Rec. 709": ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06)),
    "Rec. 2020": ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),
    "P3": ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),
}


def explanations(evidence: Evidence) -> Iterator[Explanation]:
    """All that might be, the simplest first."""
    yield from _empty(evidence)
    if not evidence.sampled[0].size:
        return
    for rows in (_rounded, _quantised, _clipped, _swapped_channels):
        yield from rows(evidence)
    if evidence.pixels.color:
        yield from _premultiplied(evidence)
    for rows in (_another_exposure, _another_gamma, _raised):
        yield from rows(evidence)
    if evidence.pixels.color:
        yield from _vignette(evidence)
        if not evidence.is_small:  # their many parameters fit a few edges
            yield from _mixed(evidence)
            yield from _tone_curve(evidence)


def _empty(evidence: Evidence) -> Iterator[Explanation]:
    """B has one value everywhere, or is 0 within the rectangle where it differs."""
    planes = [evidence.pixels.plane("b", name) for name in evidence.names]
    differs = evidence.pixels.greatest > 0
    rows, columns = (np.flatnonzero(differs.any(axis=axis)) for axis in (1, 0))
    top, left, bottom, right = (int(v) for v in (rows[0], columns[0], rows[-1], columns[-1]))
    cut = (slice(top, bottom + 1), slice(left, right + 1))
    if (bottom - top) < 2 or (right - left) < 2:
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
    yield Explanation(Finding("empty", f"empty: {level} {where}"), 0.0)


def _rounded(evidence: Evidence) -> Iterator[Explanation]:
    a, b = evidence.sampled
    with np.errstate(over="ignore"):
        rounded = a.astype(np.float16).astype(np.float32)
    if np.array_equal(rounded, b):
        yield Explanation(Finding("rounded to half", "rounded to half"), 0.0)


def _clipped(evidence: Evidence) -> Iterator[Explanation]:
    """B is A with all values beyond a limit set to the limit."""
    a, _ = evidence.sampled
    (low, high), (minimum, maximum) = (_range(evidence, side) for side in ("a", "b"))
    if high > maximum:
        name = f"clipped at {maximum:.4g}"
        left = evidence.left(np.minimum(a, np.float32(maximum)))
        yield Explanation(Finding(name, name, {"limit": maximum}), left, EXACT)
    if low < minimum <= 0.0:
        name = f"clipped at {minimum:.4g}"
        below = Finding(name, f"{name} from below", {"limit": minimum})
        yield Explanation(below, evidence.left(np.maximum(a, np.float32(minimum))), EXACT)
        if high > maximum:
            text = f"clipped at {maximum:.4g} and, from below, at {minimum:.4g}"
            both = Finding(f"clipped at {maximum:.4g}", text, {"limits": [minimum, maximum]})
            yield Explanation(both, evidence.left(np.clip(a, minimum, maximum)), EXACT)


def _range(evidence: Evidence, side: str) -> tuple[float, float]:
    """The least and the greatest finite value of the channels that differ."""
    pixels = evidence.pixels
    ends = [pixels.ranges["ab".index(side)][name] for name in evidence.names]
    if pixels.finite is not None:
        planes = [pixels.plane(side, name)[pixels.finite] for name in evidence.names]
        ends = [(float(plane.min()), float(plane.max())) for plane in planes]
    return min(low for low, _ in ends), max(high for _, high in ends)


def _quantised(evidence: Evidence) -> Iterator[Explanation]:
    """B is A rounded to the levels of few bits, which A is not on."""
    a, _ = evidence.sampled
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
            name = f"quantised to {bits} bits"
            yield Explanation(Finding(name, f"{name}{how}", {"bits": bits}), left, EXACT)


def _as_it_is(values: NDArray[Any]) -> NDArray[Any]:
    return values


def _decoded(values: NDArray[Any]) -> NDArray[Any]:
    return srgb_to_linear(np.maximum(values, 0.0)).astype(np.float32)


def _swapped_channels(evidence: Evidence) -> Iterator[Explanation]:
    """Channels of one layer, or the layers of the left and the right view, in another order."""
    names = evidence.pixels.names
    for layer in layers(names):
        moved = [name for name in layer if name in evidence.names]
        if 2 <= len(moved) <= _MAX_SWAPPED and len(moved) == len(evidence.names):
            for order in permutations(range(len(moved))):
                if list(order) == sorted(order):
                    continue
                sources = [moved[index] for index in order]
                pairs = [f"{new} is {old}" for new, old in zip(moved, sources, strict=True)]
                said = ", ".join(_own(pair) for pair in pairs if len(set(pair.split(" is "))) > 1)
                finding = Finding(
                    "channels swapped",
                    f"channels swapped: {said}",
                    dict(zip(moved, sources, strict=True)),
                )
                predicted = evidence.at("a", *evidence.places, sources)
                yield Explanation(finding, evidence.left(predicted))
    views = {name: _other_view(name) for name in evidence.names}
    if views and all(other in names and other != name for name, other in views.items()):
        finding = Finding("left and right swapped", "left and right swapped")
        predicted = evidence.at("a", *evidence.places, list(views.values()))
        yield Explanation(finding, evidence.left(predicted))


def _own(text: str) -> str:
    return " ".join(word.rpartition(".")[2] for word in text.split(" "))


def _other_view(name: str) -> str:
    for here, there in (("left", "right"), ("right", "left")):
        for spelling in (str.lower, str.capitalize, str.upper):
            if spelling(here) in name:
                return name.replace(spelling(here), spelling(there))
    return name


def _premultiplied(evidence: Evidence) -> Iterator[Explanation]:
    """Colour divided by its alpha, or multiplied once more."""
    names = evidence.pixels.names
    alphas = {name: name[: -len(name.split(".")[-1])] + "A" for name in evidence.names}
    if not all(alpha in names and alpha not in evidence.names for alpha in alphas.values()):
        return
    light = evidence.light(evidence.sampled[0])
    alpha = evidence.at("a", *evidence.places, list(alphas.values()))
    divided = np.where(alpha > 0, light / np.where(alpha > 0, alpha, 1.0), light)
    for text, changed in (("divided by alpha", divided), ("multiplied by alpha", light * alpha)):
        finding = Finding("premultiplication", f"premultiplication: colour {text} once more")
        yield Explanation(finding, evidence.left(evidence.stored(changed)))


def _another_exposure(evidence: Evidence) -> Iterator[Explanation]:
    """B is a multiple of A, the same for all channels or each with its own."""
    a, b = evidence.sampled
    light, aim = evidence.light(a), evidence.light(b)
    weights = _weights(evidence, light) * evidence.steady
    tops = (weights * aim * light * weights).sum(axis=1)
    squares = np.square(weights * light).sum(axis=1)
    if not squares.sum():
        return
    factor = float(tops.sum() / squares.sum())
    left = evidence.left(evidence.stored(light * factor), evidence.steady)
    if abs(factor + 1) < 1e-3:
        finding = Finding("sign reversed", "sign reversed")
    else:
        stops = f" ({np.log2(factor):+.3g} EV)" if factor > 0 else ""
        text = f"another exposure: x {factor:.4g}{stops}"
        finding = Finding("another exposure", text, {"factor": factor})
    yield Explanation(finding, left)
    if len(a) > 1 and squares.all():
        ratios = tops / squares
        each = ", ".join(f"{n} x {r:.4g}" for n, r in zip(evidence.names, ratios, strict=True))
        finding = Finding(
            "another exposure",
            f"another exposure of each channel: {each}",
            {"factors": dict(zip(evidence.names, map(float, ratios), strict=True))},
        )
        scaled = evidence.stored(light * ratios[:, None])
        yield Explanation(finding, evidence.left(scaled, evidence.steady), cost=0.01)


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
    """B is a power of A, or a multiple of one; or a curve was applied once more."""
    a, _ = evidence.sampled
    for name, curve in (("sRGB-encoded", linear_to_srgb), ("sRGB-decoded", _decoded)):
        finding = Finding("another gamma", f"another gamma: {name} once more")
        yield Explanation(finding, evidence.left(curve(a).astype(np.float32)))
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
) -> Iterator[Explanation]:
    a, b = (curve(np.clip(v, 0, 1) if clipped else v) for v in evidence.sampled)
    usable = (a > 0.02) & (b > 0.02) & evidence.fits & evidence.steady
    if np.count_nonzero(usable) < 16:
        return
    x, y = (np.log(side[usable], dtype=np.float64) for side in (a, b))
    weight = np.minimum(a[usable], 1.0)
    power = float((weight * x * y).sum() / max((weight * x * x).sum(), 1e-300))
    text = f"another gamma: to the power {power:.4g}{how}"
    finding = Finding("another gamma", text, {"power": power})
    yield Explanation(
        finding, evidence.left(back(_power(a, power, 1.0)), evidence.steady), cost=0.005
    )
    if not how and float(np.ptp(x)) > 0.1:
        power, offset = (float(value) for value in np.polyfit(x, y, 1))
        factor = float(np.exp(offset))
        text = f"another gamma and exposure: to the power {power:.4g}, x {factor:.4g}"
        both = Finding("another gamma", text, {"power": power, "factor": factor})
        left = evidence.left(_power(a, power, factor), evidence.steady)
        yield Explanation(both, left, cost=0.02)


def _power(values: NDArray[Any], power: float, factor: float) -> NDArray[Any]:
    magnitude = np.abs(values).astype(np.float64)
    with np.errstate(divide="ignore", over="ignore"):
        scaled = np.where(magnitude > 0, magnitude**power, 0.0) * factor
    signed: NDArray[Any] = np.sign(values) * np.minimum(scaled, 1e30)
    return signed.astype(np.float32)


def _raised(evidence: Evidence) -> Iterator[Explanation]:
    """B is a multiple of A and a constant: of light, or of the values that a screen shows."""
    a, b = evidence.sampled
    steady = evidence.steady & (b > _range(evidence, "b")[0])
    light, aim = evidence.light(a), evidence.light(b)
    weights = _weights(evidence, light) * steady
    for free in (False, True):
        columns = [np.ones_like(light), light][: 1 + free]
        solved = _solved(columns, aim if free else aim - light, weights)
        offset, factor = float(solved[0]), float(solved[1]) if free else 1.0
        name = "raised blacks" if offset > 0 else "lowered blacks"
        text = f"{name}: {offset:+.3g} of light" + f", x {factor:.4g}" * free
        finding = Finding(name, text, {"offset": offset, "factor": factor})
        predicted = evidence.stored(factor * light + offset)
        yield Explanation(finding, evidence.left(predicted, steady), cost=0.01 + 0.01 * free)
    if not evidence.pixels.color:
        return
    steady = steady & (a <= 1.0)
    shown, aim = (evidence.scaled(side).astype(np.float64) for side in (a, b))
    offset, factor = _solved([np.ones_like(shown), shown], aim, 1.0 * (steady & evidence.fits))
    pivot = offset / (1 - factor) if factor != 1 else np.inf
    predicted = factor * shown + offset
    predicted = evidence.unscaled(predicted)
    name = "another contrast"
    text = f"{name}: x {factor:.4g} around {pivot:.3g}"
    if not 0.1 < pivot < 0.9:
        name = "raised blacks" if offset > 0 else "lowered blacks"
        text = f"{name}: {offset:+.3g} of what a screen shows, x {factor:.4g}"
    finding = Finding(name, text, {"offset": float(offset), "factor": float(factor)})
    yield Explanation(finding, evidence.left(predicted, steady), cost=0.02)


def _mixed(evidence: Evidence) -> Iterator[Explanation]:
    """Channels of one layer mixed: another saturation, or other primaries."""
    layers_of = [each for each in color_layers(evidence.pixels.names) if len(each) == 3]
    if len(layers_of) != 1 or not set(evidence.names) <= set(layers_of[0]):
        return
    layer = layers_of[0]
    light, aim = (evidence.light(evidence.at(s, *evidence.places, layer)) for s in ("a", "b"))
    kept = [layer.index(name) for name in evidence.names]
    dark = _range(evidence, "b")[0] == 0.0  # what would be negative may have become 0
    weights = _weights(evidence, light) * ((aim > 0.0).all(axis=0) if dark else 1.0)
    if evidence.gamma != 1.0:
        weights = weights * evidence.steady.all(axis=0)
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
        text = f"another saturation: x {factor:.4g}{how}"
        finding = Finding("another saturation", text, {"factor": factor})
        yield Explanation(finding, evidence.left(stored[kept], evidence.steady), cost=0.01)
    rows = [_solved(list(light), channel, w) for channel, w in zip(aim, weights, strict=True)]
    matrix = np.stack(rows)
    if np.abs(matrix - np.diag(np.diag(matrix))).max() < _MIXED:
        return
    finding = Finding("other primaries", _primaries(matrix), {"matrix": matrix.tolist()})
    stored = evidence.stored(matrix @ light)[kept]
    yield Explanation(finding, evidence.left(stored, evidence.steady), cost=0.03)


def _primaries(matrix: NDArray[Any]) -> str:
    """What a matrix of colours does, in words."""
    to_xyz = {name: _to_xyz(primaries) for name, primaries in _PRIMARIES.items()}
    for old, new in permutations(_PRIMARIES, 2):
        converted = np.linalg.solve(to_xyz[new], to_xyz[old])
        if np.abs(converted - matrix).max() < 0.03:
            return f"other primaries: {new} instead of {old}"
    return "other primaries: channels mixed by a matrix"


def _to_xyz(primaries: Sequence[tuple[float, float]]) -> NDArray[Any]:
    """The matrix from R, G, B to X, Y, Z of a white of D65."""
    columns = np.array([(x / y, 1.0, (1 - x - y) / y) for x, y in (*primaries, _D65)]).T
    whole: NDArray[Any] = columns[:, :3] * np.linalg.solve(columns[:, :3], columns[:, 3])
    return whole


def _vignette(evidence: Evidence) -> Iterator[Explanation]:
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
            finding = Finding(
                "vignette", f"vignette: corners x {corners:.3g}", {"corners": corners}
            )
            left = evidence.left(evidence.stored(light * gain), evidence.steady)
            yield Explanation(finding, left, cost=0.02 * powers)


def _tone_curve(evidence: Evidence) -> Iterator[Explanation]:
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
            finding = Finding("another tone curve", f"another tone curve{how}")
            yield Explanation(finding, evidence.left(stored, evidence.steady), cost=cost)

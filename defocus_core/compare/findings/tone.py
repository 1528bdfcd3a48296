"""Causes that change values in place: exposure, curves, colours, clipping, quantisation, layers.

Most are sums of terms of A, found by weighted least squares: of light, or of what a screen shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import Evidence, Explanation, steepness, summed_up
from defocus_core.compare.findings.table import Finding
from defocus_core.compare.metrics import LUMINANCE
from defocus_core.compare.pairing import other_view
from defocus_core.compare.picture import color_layers, layers
from defocus_core.compare.pixels import Pixels
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear
from defocus_core.io.images.primaries import NAMED, between_primaries

_Curve = Callable[[Any], Any]
_MAX_SWAPPED = 4  # channels of a layer whose permutations are tried
_BITS = range(3, 13)
_KNOTS = 40  # of a tone curve
_NEAR = 0.02  # greatest difference of a matrix from that of known primaries
_GREY = 2e-3  # greatest relative difference of the channels of a grey
_SAME = 2e-3  # greatest relative difference from the limit of what was clipped
_CUT = 0.95  # least share of the pixels beyond the limit that are at it
_BELOW = 0.97  # of the limit, beyond which there are values that were not cut off
_MORE = 1.05  # what was cut off is brighter than the limit by this
_SEVERAL = 3  # values that were cut off, at least
_MOST_IDS = 2000
_ONE = 1.001  # greatest number of values that are normalised


def clipped_light(pixels: Pixels) -> list[Finding]:
    """The limit that the light of B was clipped at, if it was; looked for in every pair."""
    for layer in pixels.color:
        high, limit = (max(_high(pixels, side, name) for name in layer) for side in "ab")
        if not (math.isfinite(high) and high > _MORE * limit > 0):
            continue
        beyond, cut, between, below = 0, 0, 0, 0
        for name in layer:
            a, b = pixels.plane("a", name), pixels.plane("b", name)
            over = a > (1 + _SAME) * limit
            below += int(np.count_nonzero((b > _BELOW * limit) & (b < (1 - _SAME) * limit)))
            old, new = a[over].astype(np.float64), b[over].astype(np.float64)
            at_limit = np.abs(new - limit) <= _SAME * limit
            beyond += new.size
            cut += int(np.count_nonzero(at_limit))
            between += int(np.count_nonzero(at_limit & (old < 0.98 * high)))
        plain = abs(limit - 1.0) <= _SAME
        # Coarse levels have none just below their highest.
        if beyond and cut >= _CUT * beyond and (plain or (between >= _SEVERAL and below)):
            name = f"clipped at {limit:.4g}"
            return [Finding(name, name, {"limit": limit, "values": beyond})]
    return []


def may_be_cut_below(pixels: Pixels) -> bool:
    """Whether numbers of A below 0 are no longer there in B."""
    ends = [(pixels.ranges[0][name][0], pixels.ranges[1][name][0]) for name in pixels.names]
    return any(old < new <= 0 or math.isnan(old + new) for old, new in ends)


def _high(pixels: Pixels, side: str, name: str) -> float:
    high = pixels.ranges["ab".index(side)][name][1]
    return float(np.nanmax(pixels.plane(side, name))) if math.isnan(high) else high


def lost_channels(pixels: Pixels) -> list[Finding]:
    """Channels of several values in A that are 0 everywhere in B; looked for in every pair."""
    zero, (old, new) = (0.0, 0.0), pixels.ranges
    lost = [name for name in pixels.names if new[name] == zero != old[name]]
    if not lost or pixels.selected is not None:
        return []
    said = f"empty: {', '.join(f'{n} 0' for n in lost)} everywhere"
    return [Finding("empty", said, {"channels": lost})]


def empty(evidence: Evidence) -> Iterator[Explanation]:
    """B has one value everywhere, or is 0 within the rectangle where it differs."""
    planes = [evidence.pixels.plane("b", name) for name in evidence.names]
    top, left, bottom, right = evidence.window
    cut = (slice(top, bottom), slice(left, right))
    values = [plane[cut] for plane in planes]
    if values[0].size < 9 or any((value != value[0, 0]).any() for value in values):
        return
    were = [evidence.pixels.plane("a", name)[cut] for name in evidence.names]
    if all((value == value[0, 0]).all() for value in were) and any(v.any() for v in values):
        return  # A has nothing there that B could lack
    firsts = zip(evidence.names, values, strict=True)
    level = ", ".join(f"{name} {float(value[0, 0]):g}" for name, value in firsts)
    where = f"within {right - left}x{bottom - top} at {left},{top}"
    if all((plane == plane.flat[0]).all() for plane in planes):
        where = "everywhere"
    elif any(value.any() for value in values):
        return
    yield Explanation(0.0, "empty", f": {level} {where}")


def rounded(evidence: Evidence) -> Iterator[Explanation]:
    """B is A in the number type of B: half, or integers of 8 bits."""
    a, b = evidence.sampled
    with np.errstate(over="ignore"):
        if np.array_equal(a.astype(np.float16).astype(np.float32), b):
            yield Explanation(0.0, "rounded to half")
    if evidence.types == {"uint8"} and np.array_equal(evidence.rounded(a), b):
        yield Explanation(0.0, "quantised to 8 bits", values={"bits": 8})


def clipped(evidence: Evidence) -> Iterator[Explanation]:
    """B is A with all values beyond a limit set to the limit."""
    a, _ = evidence.sampled
    (low, high), (minimum, maximum) = (_range(evidence, side) for side in ("a", "b"))
    ways = [(-math.inf, maximum, "")] * (high > maximum)
    ways += [(minimum, math.inf, " from below")] * (low < minimum)
    if len(ways) == 2:
        ways.append((minimum, maximum, f" and, from below, at {minimum:.4g}"))
    for least, most, how in ways:
        limit = least if most == math.inf else most
        beyond = a[(a < least) | (a > most)]
        if len(np.unique(beyond)) >= _SEVERAL:  # a factor makes one value of one
            left = evidence.left(a.clip(least, most))
            yield Explanation(left, f"clipped at {limit:.4g}", how, {"limit": limit})


def _range(evidence: Evidence, side: str) -> tuple[float, float]:
    """The least and the greatest finite value of the channels that differ."""
    pixels = evidence.pixels
    ends = [pixels.ranges["ab".index(side)][name] for name in evidence.names]
    if pixels.finite is not None:
        planes = [pixels.plane(side, name)[pixels.finite] for name in evidence.names]
        ends = [(float(plane.min()), float(plane.max())) for plane in planes]
    return min(low for low, _ in ends), max(high for _, high in ends)


def quantised(evidence: Evidence) -> Iterator[Explanation]:
    """B is A rounded to the levels of few bits."""
    a, b = evidence.sampled
    if len(np.unique(b[0, :4096])) >= min(4096, a.shape[1]) * 0.9:
        return
    clips = _range(evidence, "b")[1] <= _ONE < _range(evidence, "a")[1]
    aim = np.clip(a, 0.0, 1.0) if clips else a
    curves: dict[str, tuple[_Curve, _Curve]] = {"": (np.asarray, np.asarray)}
    if evidence.gamma == 1.0 and float(aim.max()) <= _ONE:
        curves = {" (sRGB-encoded)": (linear_to_srgb, _decoded), **curves}
    for how, (curve, back) in curves.items():
        for bits in _BITS:
            top = 2**bits - 1
            stored = back(np.rint(curve(aim) * top) / np.float32(top))
            left = evidence.left(stored, a <= 1.0 if clips else None)
            yield Explanation(left, f"quantised to {bits} bits", how, {"bits": bits})


def _decoded(values: NDArray[Any]) -> NDArray[Any]:
    return srgb_to_linear(np.maximum(values, 0.0)).astype(np.float32)


def exchanged(evidence: Evidence) -> Iterator[Explanation]:
    """Channels of a layer in another order, or layers in the place of each other."""
    pixels, places = evidence.pixels, evidence.places
    for layer in layers(pixels.names):
        moved = [name for name in layer if name in evidence.names]
        if not (2 <= len(moved) <= _MAX_SWAPPED and len(moved) == len(evidence.names)):
            continue
        own = {name: name.rpartition(".")[2] for name in moved}
        for sources in list(permutations(moved))[1:]:
            pairs = dict(zip(moved, sources, strict=True))
            said = ", ".join(f"{own[n]} is {own[old]}" for n, old in pairs.items() if n != old)
            left = evidence.left(evidence.at("a", *places, sources))
            yield Explanation(left, "channels swapped", f": {said}", pairs)
    split = [name.rpartition(".")[::2] for name in evidence.names]
    tried = {"left and right swapped": ([f"{other_view(p)}.{c}".lstrip(".") for p, c in split], "")}
    if len(prefixes := list(dict.fromkeys(prefix for prefix, _ in split))) == 2:
        other = dict(zip(prefixes, reversed(prefixes), strict=True))
        how = f": {prefixes[0] or 'the picture'} and {prefixes[1]}"
        tried["layers exchanged"] = [f"{other[p]}.{c}".lstrip(".") for p, c in split], how
    for name, (names, how) in tried.items():
        pairs_of = zip(names, evidence.names, strict=True)
        if all(source in pixels.names and source != n for source, n in pairs_of):
            yield Explanation(evidence.left(evidence.at("a", *places, names)), name, how)
    width = evidence.size[1]
    if width % 2 == 0:
        half = evidence.at("a", places[0], (places[1] + width // 2) % width)
        how = ": the halves of the picture"
        yield Explanation(evidence.left(half), "left and right swapped", how)


def exchanged_ids(evidence: Evidence) -> Iterator[Explanation]:
    """Each number of A is another one of the same numbers, as those that name objects."""
    if evidence.pixels.color:
        return
    a, b = evidence.sampled
    predicted, exchanged = a.copy(), 0
    for old, new, aim in zip(a, b, predicted, strict=True):
        known, place = np.unique(old, return_inverse=True)
        if not 2 <= len(known) <= min(_MOST_IDS, old.size // 8) or not np.isin(new, known).all():
            return
        counts = np.zeros((len(known), len(known)), np.int32)
        np.add.at(counts, (place, np.searchsorted(known, new)), 1)
        there = counts.argmax(axis=1)
        if len(set(there.tolist())) < len(known):
            return
        aim[:] = known[there][place]
        exchanged += int(np.count_nonzero(there != np.arange(len(known))))
    how, values = f": {exchanged} of the numbers", {"ids": exchanged}
    yield Explanation(evidence.left(predicted), "ids exchanged", how, values)


def normalised(evidence: Evidence) -> Iterator[Explanation]:
    """Numbers, or their inverse, with a factor and an offset by which they are 0…1."""
    low, high = _range(evidence, "b")
    _, before = _range(evidence, "a")
    if evidence.pixels.color or not (low >= -0.001 and high <= _ONE < before):
        return
    a, b = (side.astype("f8") for side in evidence.sampled)
    with np.errstate(divide="ignore"):
        inverse = np.where(a != 0, 1 / np.where(a != 0, a, 1), 0.0)
    chosen = (1.0 * evidence.fits) * ((b > 1e-4) & (b < 0.999))
    for old, how in ((a, ""), (inverse, " of the inverse")):
        each = zip(evidence.names, old, b, chosen, strict=True)
        solved = {n: summed_up([np.ones_like(o), o], new, w) for n, o, new, w in each}
        predicted = np.stack([c + f * o for (c, f), o in zip(solved.values(), old, strict=True)])
        said = ", ".join(f"{n} x {f:.4g}, {c:+.3g}" for n, (c, f) in solved.items())
        left = evidence.left(predicted.clip(0, 1))
        yield Explanation(left, "normalised", f"{how}: {said}")


def radial(evidence: Evidence) -> Iterator[Explanation]:
    """Distances along rays in the place of those along the axis, or the reverse."""
    if evidence.pixels.color or len(evidence.names) != 1:
        return
    (height, width), (rows, columns) = evidence.size, evidence.places
    far = (rows - (height - 1) / 2) ** 2.0 + (columns - (width - 1) / 2) ** 2.0
    a, b = (side[0].astype("f8") for side in evidence.sampled)
    usable = (a > 0) & (b > 0) & evidence.fits
    for name, one, other in (("radial depth", a, b), ("planar depth", b, a)):
        square = np.where(usable, (other / np.where(one != 0, one, 1)) ** 2 - 1, 0.0)
        slope = float((square * far).sum() / max(float((far[usable] ** 2).sum()), 1e-300))
        if slope > 0:
            stretch = np.sqrt(1 + slope * far)
            there = a * stretch if one is a else a / stretch
            how = f": by a focal length of {1 / math.sqrt(slope):.4g} px"
            left = evidence.left(there[None])
            yield Explanation(left, name, how, {"focal": 1 / math.sqrt(slope)})


def premultiplied(evidence: Evidence) -> Iterator[Explanation]:
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


@dataclass(frozen=True)
class _Scale:
    """A and B [C, N] as light or as a screen shows it, where terms of A are added up."""

    evidence: Evidence
    old: NDArray[Any]
    new: NDArray[Any]
    weights: NDArray[Any]  # 0 where a sample chooses nothing
    back: _Curve  # to the values of the file

    def fitted(
        self, terms: Sequence[NDArray[Any]], base: Any = 0.0, *, each: bool = False
    ) -> tuple[NDArray[Any], float]:
        """Multiples of terms that B is beside a base, of all channels or each; what is left."""
        aim = self.new - base
        terms = [np.broadcast_to(term, aim.shape) for term in terms]
        solved = np.stack([summed_up(terms, aim, self.weights)] * len(aim))
        if each:
            sides = zip(zip(*terms, strict=True), aim, self.weights, strict=True)
            solved = np.stack([summed_up(own, to, weights) for own, to, weights in sides])
        total = base + sum(solved[:, k : k + 1] * term for k, term in enumerate(terms))
        # Of a value at a bound of the file, what is beyond is not known.
        return solved, self.evidence.left(self.back(total), self.evidence.steady)


def _scales(evidence: Evidence) -> Iterator[tuple[_Scale, str]]:
    """Light, and the values that a screen shows."""
    stored = evidence.sampled
    inner = evidence.steady & (stored[1] > _range(evidence, "b")[0])
    if evidence.gamma != 1.0 and evidence.pixels.color:
        inner &= stored[1] < 0.996
    chosen = np.sqrt(evidence.weights) * evidence.fits * inner
    old, new = map(evidence.light, stored)
    of = "light" if evidence.pixels.color else "its values"
    yield _Scale(evidence, old, new, chosen * steepness(old), evidence.stored), of
    if evidence.pixels.color:
        old, new = (evidence.scaled(side).astype(np.float64) for side in stored)
        chosen = chosen * (stored[0] <= 1.0)
        yield _Scale(evidence, old, new, chosen, evidence.unscaled), "what a screen shows"


def _named(evidence: Evidence, numbers: NDArray[Any], sign: str) -> tuple[dict[str, float], str]:
    values = dict(zip(evidence.names, map(float, numbers), strict=True))
    return values, ", ".join(
        f"{name} {sign and sign + ' '}{v:{'.4g' if sign else '+.3g'}}" for name, v in values.items()
    )


def exposed(evidence: Evidence) -> Iterator[Explanation]:
    """B is a multiple of A, the same for all channels, or of its own for each."""
    light, _ = next(_scales(evidence))
    solved, left = light.fitted([light.old])
    factor = float(solved[0, 0])
    if factor > 0:
        how = f": x {factor:.4g} ({np.log2(factor):+.3g} EV)"
        yield Explanation(left, "another exposure", how, {"factor": factor})
    if len(evidence.names) > 1:
        factors, left = light.fitted([light.old], each=True)
        if (factors > 0).all():
            numbers, said = _named(evidence, factors[:, 0], "x")
            how = f" of each channel: {said}"
            yield Explanation(left, "another exposure", how, {"factors": numbers})


def another_gamma(evidence: Evidence) -> Iterator[Explanation]:
    """B is a power of A, of its values or of those that a screen shows; or encoded once more."""
    for name, curve in (("sRGB-encoded", linear_to_srgb), ("sRGB-decoded", _decoded)):
        left = evidence.left(curve(evidence.sampled[0]).astype(np.float32))
        yield Explanation(left, "another gamma", f": {name} once more")
    yield from _powers(evidence, np.asarray, np.asarray, "")
    if evidence.gamma == 1.0 and evidence.pixels.color:
        clips = _range(evidence, "b")[1] <= _ONE < _range(evidence, "a")[1]
        yield from _powers(evidence, linear_to_srgb, _decoded, ", sRGB-encoded", clips=clips)


def _powers(
    evidence: Evidence, curve: _Curve, back: _Curve, how: str, *, clips: bool = False
) -> Iterator[Explanation]:
    a, b = (curve(np.clip(v, 0, 1) if clips else v) for v in evidence.sampled)
    usable = (a > 0.02) & (b > 0.02) & evidence.fits & evidence.steady
    if np.count_nonzero(usable) < 16:
        return
    x, y = (np.log(side[usable], dtype=np.float64) for side in (a, b))
    weight = np.minimum(a[usable], 1.0)
    power = float((weight * x * y).sum() / max((weight * x * x).sum(), 1e-300))
    fits = [(power, 1.0, f": to the power {power:.4g}{how}")]
    if not how and float(np.ptp(x)) > 0.1:
        power, offset = (float(value) for value in np.polyfit(x, y, 1))
        factor = float(np.exp(offset))
        fits.append((power, factor, f": to the power {power:.4g}, exposure x {factor:.4g}"))
    for power, factor, said in fits:
        left = evidence.left(back(_power(a, power, factor)), evidence.steady)
        yield Explanation(left, "another gamma", said, {"power": power, "factor": factor})


def _power(values: NDArray[Any], power: float, factor: float) -> NDArray[Any]:
    magnitude = np.abs(values).astype(np.float64)
    with np.errstate(divide="ignore", over="ignore"):
        scaled = np.where(magnitude > 0, magnitude**power, 0.0) * factor
    signed: NDArray[Any] = np.sign(values) * np.minimum(scaled, 1e30)
    return signed.astype(np.float32)


def offset(evidence: Evidence) -> Iterator[Explanation]:
    """B is a multiple of A and a constant: of light, or of the values that a screen shows."""
    for scale, of in _scales(evidence):
        one = np.ones_like(scale.old)
        solved, left = scale.fitted([one], scale.old)
        lift = float(solved[0, 0])
        if lift > 0 or of != "light":
            how = f": {lift:+.3g} of {of}"
            yield Explanation(left, "offset or contrast", how, {"offset": lift, "factor": 1.0})
        solved, left = scale.fitted([one, scale.old])
        lift, factor = map(float, solved[0])
        name, values = "offset or contrast", {"offset": lift, "factor": factor}
        how = f": x {factor:.4g}, {lift:+.3g} of {of}"
        if factor < 0:
            name, how = "inverted", f": {lift:.3g} - {-factor:.4g} x A of {of}"
        elif 0.1 < (pivot := lift / (1 - factor) if factor != 1 else math.inf) < 0.9:
            how = f": x {factor:.4g} around {pivot:.3g} of {of}"
        yield Explanation(left, name, how, values)
        if len(scale.old) > 1:
            offsets, left = scale.fitted([one], scale.old, each=True)
            numbers, said = _named(evidence, offsets[:, 0], "")
            how = f": {said} of {of}"
            yield Explanation(left, "offset or contrast", how, {"offsets": numbers})


def mixed_channels(evidence: Evidence) -> Iterator[Explanation]:
    """The channels of the only layer of R, G and B mixed by a matrix, of light or as shown.

    It makes the picture grey, changes the distances to luma by a factor, or is that of primaries.
    """
    found = [each for each in color_layers(evidence.pixels.names) if len(each) == 3]
    if len(found) != 1 or not set(evidence.names) <= set(found[0]):
        return
    (layer,) = found
    kept = [layer.index(name) for name in evidence.names]
    stored = [evidence.at(side, *evidence.places, layer) for side in ("a", "b")]
    light: list[NDArray[Any]] = [evidence.light(side) for side in stored]
    dark = float(stored[1].min()) >= 0.0  # what would be negative may have become 0
    steady = np.asarray(evidence.steady.all(axis=0))
    lit = (stored[1] > 0.0).all(axis=0) | np.bool_(not dark)
    chosen = np.sqrt(evidence.weights) * (evidence.fits & lit & steady)
    shown = [evidence.scaled_light(side).astype(np.float64) for side in light]
    grey = _is_grey(stored[1]) and not _is_grey(stored[0])
    for of, (old, new), weight, back in (
        ("", light, chosen * steepness(light[0]), evidence.stored),
        (" of what a screen shows", shown, np.stack([chosen] * 3), evidence.unscaled),
    ):
        for matrix, how, values in _matrices(layer, old, new, weight, of, grey=grey):
            there = matrix @ old
            predicted = back(np.maximum(there, 0.0) if dark else there)[kept]
            left = evidence.left(np.asarray(predicted, np.float32), None if grey else steady)
            yield Explanation(left, "primaries or saturation", f": {how}", values)


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
) -> Iterator[tuple[NDArray[Any], str, dict[str, Any]]]:
    """Matrices that make light of light, or what a screen shows, with words and values."""
    if grey:
        shares = summed_up(list(old), new[0], weight[0])
        said = " ".join(f"{s:+.2f} {n}" for n, s in zip(layer, shares, strict=True)).lstrip("+")
        values = {"weights": dict(zip(layer, map(float, shares), strict=True))}
        yield np.tile(shares, (3, 1)), f"monochrome, {said}{of}", values
    luma = np.tile(LUMINANCE, (3, 1))
    factor = float(summed_up([old - luma @ old], new - luma @ old, weight)[0])
    changed, how = luma + factor * (np.eye(3) - luma), f"saturation x {factor:.4g}{of}"
    yield changed, how, {"factor": factor}
    matrix = np.stack([summed_up(list(old), each, w) for each, w in zip(new, weight, strict=True)])
    if not of:
        yield matrix, _primaries(matrix), {"matrix": matrix.tolist()}


def _primaries(matrix: NDArray[Any]) -> str:
    apart = {
        f"{new} instead of {old}": float(np.abs(known - matrix).max())
        for old, new in permutations(NAMED, 2)
        if (known := between_primaries(NAMED[old], NAMED[new])) is not None
    }
    nearest = min(apart, key=lambda pair: apart[pair])
    return nearest if apart[nearest] < _NEAR else "channels mixed by a matrix"


def curve(evidence: Evidence) -> Iterator[Explanation]:
    """B is a curve of A that rises everywhere, the same for all channels or each with its own."""
    a, b = (evidence.scaled(side).astype(np.float64) for side in evidence.sampled)
    fits = np.broadcast_to(evidence.fits, a.shape) & evidence.steady
    curves = [_curved(a, b, fits)], [_curved(*sides) for sides in zip(a, b, fits, strict=True)]
    for how, each in (("", curves[0]), (" of each channel", curves[1])):
        if all(curve is not None for curve in each):
            stored = evidence.unscaled(np.stack(each).reshape(a.shape))
            left = evidence.left(stored, evidence.steady)
            yield Explanation(left, "another tone curve", how)


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

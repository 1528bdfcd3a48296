"""Causes that change values in place: exposure, curves, colours, clipping, quantisation, layers.

Most are sums of terms of A, by weighted least squares, in light or in sRGB values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
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
_NEAR = 0.02  # greatest difference from a matrix of known primaries
_SAME = 2e-3  # greatest relative difference from the limit of what was clipped
_CUT = 0.95  # least share of the pixels beyond the limit that are at it
_BELOW = 0.97  # factor of the limit, beyond which values were not cut off
_MORE = 1.05  # factor by which cut-off values exceed the limit
_SEVERAL = 3  # least number of cut-off values
_MOST_IDS = 2000
_ONE = 1.001  # greatest number of values that are normalised


def clipped_light(pixels: Pixels) -> list[Finding]:
    """The limit at which the light of B was clipped, if it was; checked in every pair."""
    for layer in pixels.color:
        high, limit = (max(_high(pixels, side, name) for name in layer) for side in "ab")
        if not (math.isfinite(high) and high > _MORE * limit > 0):
            continue
        planes = [[pixels.plane(side, name) for name in layer] for side in "ab"]
        over = [a > (1 + _SAME) * limit for a in planes[0]]
        old, new = (
            np.concatenate(
                [plane[mask].astype("f8") for plane, mask in zip(side, over, strict=True)]
            )
            for side in planes
        )
        cut = np.abs(new - limit) <= _SAME * limit
        # Coarse levels have no value just below their highest.
        below = any(((b > _BELOW * limit) & (b < (1 - _SAME) * limit)).any() for b in planes[1])
        several = below and np.count_nonzero(cut & (old < 0.98 * high)) >= _SEVERAL
        if cut.size and cut.mean() >= _CUT and (several or abs(limit - 1.0) <= _SAME):
            name = f"clipped at {limit:.4g}"
            return [Finding(name, name, {"limit": limit, "values": cut.size})]
    return []


def may_be_cut_below(pixels: Pixels) -> bool:
    """Whether B lacks the negative numbers of A."""
    ends = [(pixels.ranges[0][name][0], pixels.ranges[1][name][0]) for name in pixels.names]
    return any(old < new <= 0 or math.isnan(old + new) for old, new in ends)


def _high(pixels: Pixels, side: str, name: str) -> float:
    high = pixels.ranges["ab".index(side)][name][1]
    return float(np.nanmax(pixels.plane(side, name))) if math.isnan(high) else high


def lost_channels(pixels: Pixels) -> list[Finding]:
    """Channels with several values in A that are 0 everywhere in B; checked in every pair."""
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
        return  # A has no content there that B could lack
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
            left = evidence.left(evidence.values_at("a", *places, sources))
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
            yield Explanation(evidence.left(evidence.values_at("a", *places, names)), name, how)
    width = evidence.size[1]
    if width % 2 == 0:
        half = evidence.values_at("a", places[0], (places[1] + width // 2) % width)
        how = ": the halves of the picture"
        yield Explanation(evidence.left(half), "left and right swapped", how)


def exchanged_ids(evidence: Evidence) -> Iterator[Explanation]:
    """Numbers of A are permuted in B, like ids of objects."""
    if evidence.pixels.color or len(evidence.names) > 1:
        return
    (old,), (new,) = evidence.sampled
    known, place = np.unique(old, return_inverse=True)
    if 2 <= len(known) <= min(_MOST_IDS, old.size // 8) and np.isin(new, known).all():
        counts = np.zeros((len(known), len(known)), np.int32)
        np.add.at(counts, (place, np.searchsorted(known, new)), 1)
        there = counts.argmax(axis=1)
        if len(set(there.tolist())) == len(known):
            number = int(np.count_nonzero(there != np.arange(len(known))))
            left, how = evidence.left(known[there][place][None]), f": {number} of the numbers"
            yield Explanation(left, "ids exchanged", how, {"ids": number})


def radial(evidence: Evidence) -> Iterator[Explanation]:
    """Depth along rays instead of along the axis, or the reverse."""
    if evidence.pixels.color or len(evidence.names) != 1:
        return
    (height, width), (rows, columns) = evidence.size, evidence.places
    far = (rows - (height - 1) / 2) ** 2.0 + (columns - (width - 1) / 2) ** 2.0
    a, b = (side[0].astype("f8") for side in evidence.sampled)
    usable = (a > 0) & (b > 0) & evidence.fits
    for name, one, other, power in (("radial depth", a, b, 0.5), ("planar depth", b, a, -0.5)):
        square = np.where(usable, (other / np.where(one != 0, one, 1)) ** 2 - 1, 0.0)
        slope = float((square * far).sum() / max(float((far[usable] ** 2).sum()), 1e-300))
        if slope > 0:
            focal = 1 / math.sqrt(slope)
            left = evidence.left((a * (1 + slope * far) ** power)[None])
            how = f": by a focal length of {focal:.4g} px"
            yield Explanation(left, name, how, {"focal": focal})


def premultiplied(evidence: Evidence) -> Iterator[Explanation]:
    """Colour divided by its alpha, or multiplied once more."""
    alphas = [name[: -len(name.split(".")[-1])] + "A" for name in evidence.names]
    if not all(a in evidence.pixels.names and a not in evidence.names for a in alphas):
        return
    light = evidence.light(evidence.sampled[0])
    alpha = evidence.values_at("a", *evidence.places, alphas)
    divided = np.where(alpha > 0, light / np.where(alpha > 0, alpha, 1.0), light)
    for how, changed in (("divided", divided), ("multiplied", light * alpha)):
        left = evidence.left(evidence.stored(changed))
        yield Explanation(left, "premultiplication", f": colour {how} by alpha once more")


def _gain_words(constant: float, factor: float) -> str:
    ways = [f"x {factor:.4g}"] * (factor != 1) + [f"{constant:+.3g}"] * (constant != 0)
    return ", ".join(ways)


def _as_exposure(_: float, factor: float) -> str:
    return f"x {factor:.4g} ({math.log2(max(factor, 1e-9)):+.3g} EV)"


def _as_power(constant: float, power: float) -> str:
    return f"to the power {power:.4g}" + f", exposure x {math.exp(constant):.4g}" * (constant != 0)


@dataclass(frozen=True)
class _Scale:
    """A and B [C, N] on a scale where B = a A + b.

    Attributes:
        models: terms of factors ``A`` and constants ``1``, with ``s`` for one per channel; a
            constant alone is added to A itself.
        weights: 0 for samples that are ignored.
        back: function to the values of the file.
        of: words for the scale.
    """

    name: str
    models: tuple[str, ...]
    old: NDArray[Any]
    new: NDArray[Any]
    weights: NDArray[Any]
    back: _Curve
    words: Callable[[float, float], str] = _gain_words
    of: str = ""

    def fit(self, evidence: Evidence, terms: str, *, each: bool) -> Explanation:
        """The explanation by some terms."""
        aim, count = self.new - (0.0 if "A" in terms else self.old), len(self.new)
        columns = [self.old if term == "A" else np.ones_like(self.old) for term in terms]
        numbers = np.tile([0.0, 1.0], (count, 1))  # constants and factors
        for cut in [slice(k, k + 1) for k in range(count)] if each else [slice(None)]:
            solved = summed_up([c[cut] for c in columns], aim[cut], self.weights[cut])
            numbers[cut, ["1A".index(term) for term in terms]] = solved
        # A value at the limit of the number type may have been clipped.
        total = numbers[:, :1] + numbers[:, 1:] * self.old
        left = evidence.left(self.back(total), evidence.steady)
        constants, factors = numbers.T.tolist()
        words = [self.words(*both) for both in zip(constants, factors, strict=True)]
        name = "inverted" if self.name[0] == "o" and factors[0] < 0 else self.name
        if not each:
            values = {"factor": factors[0], "offset": constants[0]}
            return Explanation(left, name, f": {words[0]}{self.of}", values)
        said = ", ".join(f"{n} {w}" for n, w in zip(evidence.names, words, strict=True))
        named = [dict(zip(evidence.names, v, strict=True)) for v in (factors, constants)]
        values = dict(zip(("factors", "offsets"), named, strict=True))
        return Explanation(left, name, f" of each channel: {said}{self.of}", values)


def summed(evidence: Evidence) -> Iterator[Explanation]:
    """B = a A + b on some scale; or B is encoded once more."""
    for scale in _scales(evidence):
        for terms in scale.models:
            if len(evidence.names) > 1 or terms[-1] != "s":
                yield scale.fit(evidence, terms.strip("s"), each=terms[-1] == "s")
    for name, curve in (("sRGB-encoded", linear_to_srgb), ("sRGB-decoded", _decoded)):
        left = evidence.left(curve(evidence.sampled[0]).astype(np.float32))
        yield Explanation(left, "another gamma", f": {name} once more")


def _scales(evidence: Evidence) -> Iterator[_Scale]:
    """The scales on which B may be a A + b."""
    stored, color = evidence.sampled, evidence.pixels.color
    low, high = _range(evidence, "b")
    is_wider = high <= _ONE < _range(evidence, "a")[1]
    fits = np.broadcast_to(evidence.fits, stored[0].shape)
    inner = evidence.steady & (stored[1] > low)
    if evidence.gamma != 1.0 and color:
        inner &= stored[1] < 0.996
    chosen = np.sqrt(evidence.weights) * fits * inner
    old, new = map(evidence.light, stored)
    light, shown = chosen * steepness(old), chosen * (stored[0] <= 1.0)
    of = " of light" if color else " of its values"
    yield _Scale("another exposure", ("A", "As"), old, new, light, evidence.stored, _as_exposure)
    lifts = ("1", "1A", "1s")
    yield _Scale("offset or contrast", lifts, old, new, light, evidence.stored, of=of)
    if color:
        old, new = (evidence.scaled(side).astype("f8") for side in stored)
        of = " of what a screen shows"
        yield _Scale("offset or contrast", lifts, old, new, shown, evidence.unscaled, of=of)
    elif low >= -0.001 and is_wider:
        a, b = (side.astype("f8") for side in stored)
        between = 1.0 * fits * ((b > 1e-4) & (b < 0.999))
        inverse = np.where(a != 0, 1 / np.where(a != 0, a, 1), 0.0)
        for old, of in ((a, ""), (inverse, " of the inverse")):
            yield _Scale("normalised", ("1A", "1As"), old, b, between, _unit, of=of)
    for curve, back, of in (
        (np.asarray, np.asarray, ""),
        (linear_to_srgb, _decoded, ", sRGB-encoded"),
    ):
        if not of or (evidence.gamma == 1.0 and color):
            sides = [curve(np.clip(v, 0, 1) if of and is_wider else v) for v in stored]
            usable = (sides[0] > 0.02) & (sides[1] > 0.02) & fits & evidence.steady
            old, new = (np.log(np.maximum(np.abs(side), 1e-30), dtype="f8") for side in sides)
            weights = usable * np.sqrt(sides[0].clip(0, 1))
            way = partial(_powers, back, np.sign(sides[0]))
            models = ("A",) if of else ("A", "1A")
            yield _Scale("another gamma", models, old, new, weights, way, _as_power, of)


def _powers(back: _Curve, sign: NDArray[Any], logarithms: NDArray[Any]) -> NDArray[Any]:
    values: NDArray[Any] = back((sign * np.exp(logarithms.clip(-80, 69))).astype(np.float32))
    return values


def _unit(values: NDArray[Any]) -> NDArray[Any]:
    return values.clip(0, 1)


def mixed_channels(evidence: Evidence) -> Iterator[Explanation]:
    """R, G and B of the only layer, in light or in sRGB values, mixed by a matrix."""
    found = [each for each in color_layers(evidence.pixels.names) if len(each) == 3]
    if len(found) != 1 or not set(evidence.names) <= set(found[0]):
        return
    (layer,) = found
    kept = [layer.index(name) for name in evidence.names]
    stored = [evidence.values_at(side, *evidence.places, layer) for side in ("a", "b")]
    dark = float(stored[1].min()) >= 0.0  # negative results may have become 0
    chosen = np.sqrt(evidence.weights) * (evidence.fits & evidence.steady.all(axis=0))
    if dark:
        chosen = chosen * (stored[1] > 0.0).all(axis=0)
    old, new = map(evidence.light, stored)
    weights = chosen * steepness(old)
    shown = (evidence.scaled_light(old).astype("f8"), evidence.scaled_light(new).astype("f8"))
    luma = np.tile(LUMINANCE, (3, 1))
    scales: list[tuple[Any, Any, NDArray[Any], _Curve, str]] = [
        (old, new, weights, evidence.stored, ""),
        (*shown, np.stack([chosen] * 3), evidence.unscaled, " of what a screen shows"),
    ]
    for a, b, weight, back, of in scales:
        mixed = np.stack([summed_up(list(a), to, w) for to, w in zip(b, weight, strict=True)])
        factor = float(summed_up([a - luma @ a], b - luma @ a, weight)[0])
        saturated = (luma + factor * (np.eye(3) - luma), f"saturation x {factor:.4g}{of}")
        ways = [saturated] * (abs(factor) > _NEAR)
        if not of:
            ways.append((mixed, _primaries(mixed)))
        for matrix, how in ways:
            total = np.maximum(matrix @ a, 0.0) if dark else matrix @ a
            left = evidence.left(np.asarray(back(total)[kept], np.float32))
            values = {"matrix": matrix.tolist()}
            yield Explanation(left, "primaries or saturation", f": {how}", values)


def _primaries(matrix: NDArray[Any]) -> str:
    """Words for a matrix of linear light."""
    if np.ptp(matrix, axis=0).max() < _NEAR:
        shares = zip("RGB", matrix.mean(axis=0), strict=True)
        return "monochrome, " + " ".join(f"{s:+.2f} {n}" for n, s in shares).lstrip("+")
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
    """The curve fitted to used samples, at all samples; None if it is not monotonic."""
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

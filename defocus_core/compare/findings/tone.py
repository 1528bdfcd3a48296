"""Causes that change values in place: exposure, curves, colours, clipping, quantisation, layers.

Most are sums of terms of A, by weighted least squares, in light or in sRGB values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import Evidence, Explanation, steepness, summed_up
from defocus_core.compare.findings.table import FACTOR, Finding
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
_MORE = 1.05  # factor by which cut-off values exceed the limit
_SEVERAL = 3  # least number of cut-off values
_MOST_IDS = 2000
_SLIGHTLY = 3e-3  # difference of a factor from 1, and of a constant from 0, that is not told
_CONTRAST = "offset or contrast"
_ONE = 1.001  # greatest number of values that are normalised


def clipped_light(pixels: Pixels) -> list[Finding]:
    """The finding of the limit at which light of B is clipped, if any; needs no `Evidence`."""
    for layer in pixels.color:
        (_, high), (_, limit) = (_ends(pixels, side, layer) for side in (0, 1))
        if not (math.isfinite(high) and high > _MORE * limit > 0):
            continue
        planes = [(pixels.plane("a", name), pixels.plane("b", name)) for name in layer]
        over = [(a[mask], b[mask]) for a, b in planes for mask in [a > (1 + _SAME) * limit]]
        old, new = (np.concatenate(side).astype("f8") for side in zip(*over, strict=True))
        cut = np.abs(new - limit) <= _SAME * limit
        several = np.count_nonzero(cut & (old < 0.98 * high)) >= _SEVERAL
        if cut.size and cut.mean() >= _CUT and (several or abs(limit - 1.0) <= _SAME):
            name = f"clipped at {limit:.4g}"
            return [Finding(name, name, {"limit": limit, "values": cut.size})]
    return []


def may_be_cut_below(pixels: Pixels) -> bool:
    """Whether several values of B equal its minimum, and A has lower ones."""
    old, new = pixels.ranges
    return any(
        old[name][0] < low and np.count_nonzero(pixels.plane("b", name) == low) >= _SEVERAL
        for name, (low, _) in new.items()
    )


def _ends(pixels: Pixels, side: int, names: Sequence[str]) -> tuple[float, float]:
    """The least and the greatest value, except NaN, of channels of A (side 0) or B (side 1)."""
    ends = [pixels.ranges[side][name] for name in names]
    if any(math.isnan(low) for low, _ in ends):
        planes = [pixels.plane("ab"[side], name) for name in names]
        ends = [(float(np.nanmin(plane)), float(np.nanmax(plane))) for plane in planes]
    return min(low for low, _ in ends), max(high for _, high in ends)


def lost_channels(pixels: Pixels) -> list[Finding]:
    """The finding of channels that are 0 everywhere in B, but not in A; needs no `Evidence`."""
    zero, (old, new) = (0.0, 0.0), pixels.ranges
    lost = [name for name in pixels.names if new[name] == zero != old[name]]
    if not lost or pixels.selected is not None:
        return []
    said = f"empty: {', '.join(f'{n} 0' for n in lost)} everywhere"
    return [Finding("empty", said, {"channels": lost})]


def empty(evidence: Evidence) -> Iterator[Explanation]:
    """B has one value everywhere, or is 0 within the rectangle where it differs."""
    top, left, bottom, right = evidence.window
    cut = (slice(top, bottom), slice(left, right))
    old, new = ([evidence.pixels.plane(side, n)[cut] for n in evidence.names] for side in "ab")
    if new[0].size < 9 or not all(map(_is_one, new)) or all(map(_is_one, old)):
        return
    firsts = [float(values[0, 0]) for values in new]
    level = ", ".join(f"{n} {v:g}" for n, v in zip(evidence.names, firsts, strict=True))
    if all(low == high for low, high in (evidence.pixels.ranges[1][n] for n in evidence.names)):
        yield Explanation(0.0, "empty", f": {level} everywhere")
    elif not any(firsts):
        where = f"within {right - left}x{bottom - top} at {left},{top}"
        yield Explanation(0.0, "empty", f": {level} {where}")


def _is_one(values: NDArray[Any]) -> bool:
    return bool((values == values[0, 0]).all())


def clipped(evidence: Evidence) -> Iterator[Explanation]:
    """B is A with all values beyond a limit set to the limit."""
    a, _ = evidence.sampled
    old, new = (_ends(evidence.pixels, side, evidence.names) for side in (0, 1))
    ways = [(-math.inf, new[1], new[1], "")] * (old[1] > new[1])
    ways += [(new[0], math.inf, new[0], " from below")] * (old[0] < new[0])
    for least, most, limit, how in ways:
        if len(np.unique(a[(a < least) | (a > most)])) >= _SEVERAL:  # a factor makes one of one
            name, values = f"clipped at {limit:.4g}", {"limit": limit}
            yield evidence.explain(a.clip(least, most), name, how, values)


def quantised(evidence: Evidence) -> Iterator[Explanation]:
    """B is A rounded to half floats, to 8 bits, or to fewer levels."""
    a, b = evidence.sampled
    with np.errstate(over="ignore"):
        half = a.astype(np.float16).astype(np.float32)
    if np.array_equal(half, b):
        yield Explanation(0.0, "rounded to half")
    if len(np.unique(b[0, :4096])) >= min(4096, a.shape[1]) * 0.45:  # neighbours are often equal
        return
    clips = _exceeds(evidence)
    aim = np.clip(a, 0.0, 1.0) if clips else a
    curves: dict[str, tuple[_Curve, _Curve]] = {"": (np.asarray, np.asarray)}
    if evidence.gamma == 1.0 and float(aim.max()) <= _ONE:
        curves = {" (sRGB-encoded)": (linear_to_srgb, _decoded), **curves}
    for how, (curve, back) in curves.items():
        for bits in _BITS:
            top = np.float32(2**bits - 1)
            name, shown = f"quantised to {bits} bits", back(np.rint(curve(aim) * top) / top)
            if "half" in evidence.types:
                shown = np.asarray(shown, np.float16)
            where = a <= 1.0 if clips else None
            yield evidence.explain(shown, name, how, {"bits": bits}, where=where)


def _exceeds(evidence: Evidence) -> bool:
    """Whether A has values beyond 1, and B has none."""
    ends = [_ends(evidence.pixels, side, evidence.names)[1] for side in (0, 1)]
    return ends[1] <= _ONE < ends[0]


def _decoded(values: NDArray[Any]) -> NDArray[Any]:
    return srgb_to_linear(np.maximum(values, 0.0)).astype(np.float32)


def exchanged(evidence: Evidence) -> Iterator[Explanation]:
    """Channels of a layer are in another order in B, or layers have changed places."""
    names, known, (rows, columns) = evidence.names, evidence.pixels.names, evidence.places
    ways: list[tuple[str, str, Sequence[str]]] = []
    for layer in layers(known):
        if 2 <= len(names) <= _MAX_SWAPPED and set(names) <= set(layer):
            for sources in list(permutations(names))[1:]:
                pairs = zip(names, sources, strict=True)
                own = [[n.rpartition(".")[2] for n in both] for both in pairs]
                said = ", ".join(f"{new} is {old}" for new, old in own if new != old)
                ways.append(("channels swapped", f": {said}", sources))
    split = [name.rpartition(".")[::2] for name in names]
    views = [f"{other_view(prefix)}.{c}".lstrip(".") for prefix, c in split]
    ways.append(("left and right swapped", "", views))
    if len(prefixes := list(dict.fromkeys(prefix for prefix, _ in split))) == 2:
        how = f": {prefixes[0] or 'the picture'} and {prefixes[1]}"
        others = [prefixes[p == prefixes[0]] for p, _ in split]
        swapped = [f"{p}.{c}".lstrip(".") for p, (_, c) in zip(others, split, strict=True)]
        ways.append(("layers exchanged", how, swapped))
    for name, how, there in ways:
        if set(there) <= set(known) and tuple(there) != names:
            values = dict(zip(names, there, strict=True)) if name[0] == "c" else {}
            yield evidence.explain(evidence.values_at("a", rows, columns, there), name, how, values)


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
            how, values = f": {number} of the numbers", {"ids": number}
            yield evidence.explain(known[there][place][None], "ids exchanged", how, values)


def radial(evidence: Evidence) -> Iterator[Explanation]:
    """B is depth along rays where A is depth along the axis, or the reverse."""
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
            focal, there = 1 / math.sqrt(slope), a * (1 + slope * far) ** power
            how = f": by a focal length of {focal:.4g} px"
            yield evidence.explain(there[None], name, how, {"focal": focal})


def premultiplied(evidence: Evidence) -> Iterator[Explanation]:
    """B is A with colour divided by alpha, or multiplied by it once more."""
    alphas = [name[: -len(name.split(".")[-1])] + "A" for name in evidence.names]
    if not all(a in evidence.pixels.names and a not in evidence.names for a in alphas):
        return
    light = evidence.light(evidence.sampled[0])
    alpha = evidence.values_at("a", *evidence.places, alphas)
    divided = np.where(alpha > 0, light / np.where(alpha > 0, alpha, 1.0), light)
    for word, changed in (("divided", divided), ("multiplied", light * alpha)):
        how = f": colour {word} by alpha once more"
        yield evidence.explain(evidence.stored(changed), "premultiplication", how)


def summed(evidence: Evidence) -> Iterator[Explanation]:
    """B = a A + b in light or in sRGB, for all channels or for each; or A is encoded once more."""
    (a, b), color, back = evidence.sampled, evidence.is_light, evidence.stored
    low, is_wider = _ends(evidence.pixels, 1, evidence.names)[0], _exceeds(evidence)
    fits = evidence.fits & evidence.steady
    inner = fits & (b > low) & (evidence.is_linear | (b < 0.996))
    chosen, light = np.sqrt(evidence.weights) * inner, (evidence.light(a), evidence.light(b))
    weights, of = chosen * steepness(light[0]), " of light" if color else " of its values"
    yield from _sums(evidence, FACTOR[not color], light, weights, back=back)
    yield from _sums(evidence, _CONTRAST, light, weights, back=back, of=of)
    if color:
        shown, of = (evidence.scaled(a), evidence.scaled(b)), " of what a screen shows"
        below = chosen * (a <= 1)
        yield from _sums(evidence, _CONTRAST, shown, below, back=evidence.unscaled, of=of)
    elif low >= -0.001 and is_wider:
        between = 1.0 * fits * ((b > 1e-4) & (b < 0.999))
        inverse = np.where(a != 0, 1 / np.where(a != 0, a, 1).astype("f8"), 0.0)
        for old, of in ((a.astype("f8"), ""), (inverse, " of the inverse")):
            unit = partial(np.clip, a_min=0, a_max=1)
            yield from _sums(evidence, "normalised", (old, b), between, back=unit, of=of)
    old, new = (np.log(np.maximum(np.abs(side), 1e-30), dtype="f8") for side in (a, b))
    weights = ((a > 0.02) & (b > 0.02) & fits) * np.sqrt(a.clip(0, 1))

    def power(logs: Any) -> Any:
        return (np.sign(a) * np.exp(logs.clip(-80, 69))).astype(np.float32)

    yield from _sums(evidence, "another gamma", (old, new), weights, back=power)
    for how, curve in (("sRGB-encoded", linear_to_srgb), ("sRGB-decoded", _decoded)):
        yield evidence.explain(curve(a).astype("f4"), "another gamma", f": {how} once more")


def _sums(
    evidence: Evidence,
    name: str,
    sides: tuple[NDArray[Any], NDArray[Any]],
    weights: NDArray[Any],
    *,
    back: _Curve,
    of: str = "",
) -> Iterator[Explanation]:
    """B = a A + b, fitted to `sides`, A and B [C, N] on a scale: for all channels, and for each.

    `weights`: 0 for samples that are ignored. `back`: a function from values on the scale to those
    of the file. `of`: the name of the scale, for the text.
    """
    (old, new), names = sides, evidence.names
    columns = [old, np.ones_like(old)][: 1 if name in FACTOR else 2]
    each = [slice(k, k + 1) for k in range(len(names))]
    for cuts in ([slice(None)], each)[: len(names)]:
        numbers = np.tile([1.0, 0.0], (len(names), 1))
        for cut in cuts:
            some = [column[cut] for column in columns]
            numbers[cut, : len(some)] = summed_up(some, new[cut], weights[cut])
        (factors, offsets), said = numbers.T.tolist(), [_words(name, *v) for v in numbers.tolist()]
        how, values = f": {said[0]}{of}", {"factor": factors[0], "offset": offsets[0]}
        if cuts is each:
            how = f" of each channel: {', '.join(map(' '.join, zip(names, said, strict=True)))}{of}"
            both = (("factors", factors), ("offsets", offsets))
            values = {key: dict(zip(names, v, strict=True)) for key, v in both}
        called = "inverted" if name == _CONTRAST and factors[0] < 0 else name
        there = back(numbers[:, :1] * old + numbers[:, 1:])
        yield evidence.explain(there, called, how, values, where=evidence.steady)


def _words(name: str, factor: float, constant: float) -> str:
    """The factor and the constant of a sum, as text."""
    if name in FACTOR:
        stops = f" ({math.log2(max(factor, 1e-9)):+.3g} EV)"
        return f"x {factor:.4g}" + stops * (name == FACTOR[0])
    if name == "another gamma":
        light = f", exposure x {math.exp(constant):.4g}" * (abs(constant) > _SLIGHTLY)
        return f"to the power {factor:.4g}{light}"
    factors = [f"x {factor:.4g}"] * (abs(factor - 1) > _SLIGHTLY)
    return ", ".join([*factors, f"{constant:+.3g}"])


def mixed_channels(evidence: Evidence) -> Iterator[Explanation]:
    """R, G and B of the only layer are mixed by a matrix, in linear light or sRGB-encoded."""
    found = [each for each in color_layers(evidence.pixels.names) if len(each) == 3]
    if evidence.is_small or len(found) != 1 or not set(evidence.names) <= set(found[0]):
        return
    kept = [found[0].index(name) for name in evidence.names]
    stored = [evidence.values_at(side, *evidence.places, found[0]) for side in ("a", "b")]
    light = [evidence.light(side) for side in stored]
    shown = [evidence.scaled_light(side).astype("f8") for side in light]
    weights = np.sqrt(evidence.weights) * (evidence.fits & evidence.steady.all(axis=0))
    weights = weights * (stored[1] != 0.0).all(axis=0)  # negative results may have become 0
    least = 0.0 if float(stored[1].min()) >= 0.0 else -math.inf
    for (old, new), slope, back, of in (
        (light, steepness(light[0]), evidence.stored, ""),
        (shown, np.ones((3, 1)), evidence.unscaled, " of what a screen shows"),
    ):
        rows = zip(new, weights * slope, strict=True)
        matrix = np.stack([summed_up(list(old), to, weight) for to, weight in rows])
        there = np.asarray(back(np.maximum(matrix @ old, least))[kept], np.float32)
        how = f": {_mixture(matrix)}{of}"
        fit = evidence.explain(there, "primaries or saturation", how, follows_rounding=True)
        yield replace(fit, values={"matrix": matrix.tolist()})


def _mixture(matrix: NDArray[Any]) -> str:
    """Words for a matrix of channels."""
    luma, factor = np.tile(LUMINANCE, (3, 1)), (np.trace(matrix) - 1) / 2
    known = {f"saturation x {round(factor, 2) + 0.0:g}": luma + factor * (np.eye(3) - luma)}
    for old, new in permutations(NAMED, 2):
        if (between := between_primaries(NAMED[old], NAMED[new])) is not None:
            known[f"{new} instead of {old}"] = between
    apart = {words: float(np.abs(each - matrix).max()) for words, each in known.items()}
    nearest = min(apart, key=lambda words: apart[words])
    return nearest if apart[nearest] < _NEAR else "channels mixed by a matrix"


def curve(evidence: Evidence) -> Iterator[Explanation]:
    """B is a curve of A that rises everywhere, the same for all channels."""
    old, new = (evidence.scaled(side).astype(np.float64) for side in evidence.sampled)
    used = np.broadcast_to(evidence.fits, old.shape) & evidence.steady
    x, y = old[used], new[used]
    if not evidence.is_light or evidence.is_small or x.size < 4 * _KNOTS:
        return
    order = np.argsort(x)
    parts = [np.array_split(v[order], _KNOTS) for v in (x, y)]
    centres, values = (np.array([part.mean() for part in of]) for of in parts)
    distinct = np.append(True, np.diff(centres) > 1e-9)
    centres, values = centres[distinct], values[distinct]
    if len(centres) < 3 or (np.diff(values) < -0.004).any():
        return
    slope = (np.diff(values) / np.diff(centres))[[0, -1]]
    below, above = np.minimum(old - centres[0], 0), np.maximum(old - centres[-1], 0)
    there = np.interp(old, centres, values) + slope[0] * below + slope[1] * above
    fit = evidence.explain(
        *(evidence.unscaled(there), "another tone curve"),
        where=evidence.steady,
        follows_rounding=True,
    )
    yield replace(fit, but_noise=math.inf)  # a curve follows much else

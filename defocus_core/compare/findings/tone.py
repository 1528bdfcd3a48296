"""Explanations that change values in place: channels, exposure, gamma, clipping, quantisation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.compare.findings.evidence import LEFT, Evidence, Explanation
from defocus_core.compare.findings.finding import Finding
from defocus_core.compare.picture import layers
from defocus_core.io.images.color_space import linear_to_srgb, srgb_to_linear

_MOST_SWAPPED = 4  # channels of a layer whose permutations are tried
_DARKEST, _BRIGHTEST = 0.01, 0.995  # of values that are far from black and not clipped
_ON_GRID = 0.12  # of a step: half floats near 1 are as far from the levels of 8 bits
_BITS = range(4, 11)


def explanations(evidence: Evidence) -> Iterator[Explanation]:
    """All that might be, the simplest first."""
    yield from _empty(evidence)
    yield from _rounded(evidence)
    yield from _quantised(evidence)
    yield from _clipped(evidence)
    yield from _swapped_channels(evidence)
    yield from _scaled(evidence)


def _empty(evidence: Evidence) -> Iterator[Explanation]:
    values = evidence.b.reshape(len(evidence.b), -1)
    if (values == values[:, :1]).all():
        pairs = zip(evidence.names, values[:, 0], strict=True)
        level = ", ".join(f"{name} {value:g}" for name, value in pairs)
        yield Explanation(Finding("empty", f"empty: {level} everywhere"), 0.0)


def _rounded(evidence: Evidence) -> Iterator[Explanation]:
    a, b = evidence.sampled
    with np.errstate(over="ignore"):
        rounded = a.astype(np.float16).astype(np.float32)
    if np.array_equal(rounded, b):
        yield Explanation(Finding("rounded to half", "rounded to half"), 0.0)


def _clipped(evidence: Evidence) -> Iterator[Explanation]:
    """B is A with all values beyond a limit set to the limit."""
    a, _ = evidence.sampled
    most, least = float(evidence.b.max()), float(evidence.b.min())
    if float(evidence.a.max()) > most:
        name = f"clipped at {most:.4g}"
        left = evidence.left(np.minimum(a, np.float32(most)))
        yield Explanation(Finding(name, name, {"limit": most}), left)
    if float(evidence.a.min()) < least <= 0.0:
        name = f"clipped at {least:.4g}"
        below = Finding(name, f"{name} from below", {"limit": least})
        yield Explanation(below, evidence.left(np.maximum(a, np.float32(least))))
        if float(evidence.a.max()) > most:
            text = f"clipped at {most:.4g} and, from below, at {least:.4g}"
            both = Finding(f"clipped at {most:.4g}", text, {"limits": [least, most]})
            yield Explanation(both, evidence.left(np.clip(a, least, most)))


def _quantised(evidence: Evidence) -> Iterator[Explanation]:
    """All values of B are on the grid of few bits, and those of A are not."""
    a, b = evidence.sampled
    if float(evidence.b.min()) < 0.0 or float(evidence.b.max()) > 1.0 + 1e-3:
        return
    clipped = float(evidence.a.max()) > 1.0 + 1e-3
    aim = np.clip(a, 0.0, 1.0)
    curves: tuple[Any, ...] = (_as_it_is,)
    if evidence.gamma == 1.0:
        curves = (linear_to_srgb, _as_it_is)
    for curve in curves:
        old, new = curve(aim), curve(b)
        for bits in _BITS:
            top = 2**bits - 1
            away = np.abs(new * top - np.rint(new * top))
            if away.max() > _ON_GRID or np.abs(new - old).max() > 1.1 / top:
                continue
            if np.abs(old * top - np.rint(old * top)).mean() < _ON_GRID:
                return  # those of A are, too
            name = f"quantised to {bits} bits"
            how = " (sRGB-encoded)" if curve is linear_to_srgb else ""
            text = f"clipped at 1 and {name}{how}" if clipped else f"{name}{how}"
            yield Explanation(Finding(name, text, {"bits": bits, "clipped": clipped}), 0.0)
            return


def _as_it_is(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return values


def _swapped_channels(evidence: Evidence) -> Iterator[Explanation]:
    """Channels of one layer, or the layers of the left and the right view, in another order."""
    names, places = evidence.pixels.names, evidence.places
    for layer in layers(names):
        moved = [name for name in layer if name in evidence.names]
        if 2 <= len(moved) <= _MOST_SWAPPED and len(moved) == len(evidence.names):
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
                yield Explanation(finding, evidence.left(_from_a(evidence, sources, places)))
    views = {name: _other_view(name) for name in evidence.names}
    if views and all(other in names and other != name for name, other in views.items()):
        finding = Finding("left and right swapped", "left and right swapped")
        left = evidence.left(_from_a(evidence, [views[name] for name in evidence.names], places))
        yield Explanation(finding, left)


def _own(text: str) -> str:
    return " ".join(word.rpartition(".")[2] for word in text.split(" "))


def _other_view(name: str) -> str:
    for here, there in (("left", "right"), ("right", "left")):
        for spelling in (str.lower, str.capitalize, str.upper):
            if spelling(here) in name:
                return name.replace(spelling(here), spelling(there))
    return name


def _from_a(evidence: Evidence, sources: Sequence[str], places: Any) -> NDArray[np.float32]:
    """Channels of A [C, N] by name, at the sampled pixels."""
    planes = [evidence.pixels.plane("a", name)[places] for name in sources]
    return np.stack(planes).astype(np.float32)


def _scaled(evidence: Evidence) -> Iterator[Explanation]:
    """Another exposure or gamma, in linear light and in the values as stored."""
    a, b = evidence.sampled
    if evidence.gamma == 1.0:
        for name, curve in (("sRGB-encoded", linear_to_srgb), ("sRGB-decoded", _decoded)):
            finding = Finding("another gamma", f"another gamma: {name} once more")
            yield Explanation(finding, evidence.left(curve(a).astype(np.float32)))
    yield from _another_exposure(evidence, a, b)
    yield from _another_gamma(evidence, a, b)


def _decoded(values: NDArray[np.float32]) -> NDArray[np.float64]:
    return srgb_to_linear(np.maximum(values, 0.0))


def _another_exposure(
    evidence: Evidence, a: NDArray[np.float32], b: NDArray[np.float32]
) -> Iterator[Explanation]:
    gamma = evidence.gamma
    linear, aim = (_light(values, gamma) for values in (a, b))
    usable = (np.abs(linear) > 1e-3) & (np.abs(aim) > 1e-4)
    unclipped = np.ones(a.shape, bool)
    if gamma != 1.0:
        usable &= (a < _BRIGHTEST) & (b < _BRIGHTEST)
        unclipped = (a < _BRIGHTEST) & (b < _BRIGHTEST)
    ratios = [
        float(np.median(aim[c][usable[c]] / linear[c][usable[c]])) if usable[c].any() else 1.0
        for c in range(len(a))
    ]
    if not usable.any():
        return
    factor = float(np.median(aim[usable] / linear[usable]))
    left = evidence.left(_stored(linear * factor, gamma), unclipped)
    if abs(factor + 1) < 1e-3:
        finding = Finding("sign reversed", "sign reversed")
    else:
        stops = f" ({np.log2(factor):+.3g} EV)" if factor > 0 else ""
        text = f"another exposure: x {factor:.4g}{stops}"
        finding = Finding("another exposure", text, {"factor": factor})
    yield Explanation(finding, left)
    if left > LEFT and len(ratios) > 1:
        scaled = linear * np.asarray(ratios, linear.dtype)[:, None]
        each = ", ".join(f"{n} x {r:.4g}" for n, r in zip(evidence.names, ratios, strict=True))
        finding = Finding(
            "another exposure",
            f"another exposure of each channel: {each}",
            {"factors": dict(zip(evidence.names, ratios, strict=True))},
        )
        yield Explanation(finding, evidence.left(_stored(scaled, gamma), unclipped))


def _another_gamma(
    evidence: Evidence, a: NDArray[np.float32], b: NDArray[np.float32]
) -> Iterator[Explanation]:
    """B is a power of A, or a multiple of a power."""
    usable = (a > _DARKEST) & (b > _DARKEST)
    usable &= np.abs(np.log(np.where(usable, a, 1.0))) > 0.02
    if np.count_nonzero(usable) < 16:
        return
    x, y = np.log(a[usable], dtype=np.float64), np.log(b[usable], dtype=np.float64)
    power = float(np.median(y / x))
    finding = Finding("another gamma", f"another gamma: to the power {power:.4g}", {"power": power})
    left = evidence.left(_power(a, power, 1.0))
    yield Explanation(finding, left)
    if evidence.gamma == 1.0:
        yield from _another_display_gamma(evidence, a, b)
    if left > LEFT and float(np.ptp(x)) > 0.1:
        power, offset = (float(value) for value in np.polyfit(x, y, 1))
        factor = float(np.exp(offset))
        text = f"another gamma and exposure: to the power {power:.4g}, x {factor:.4g}"
        both = Finding("another gamma", text, {"power": power, "factor": factor})
        yield Explanation(both, evidence.left(_power(a, power, factor)))


def _another_display_gamma(
    evidence: Evidence, a: NDArray[np.float32], b: NDArray[np.float32]
) -> Iterator[Explanation]:
    """The sRGB-encoded values of B are a power of those of A, which may have been clipped at 1."""
    clipped = float(evidence.b.max()) <= 1.0 + 1e-3 < float(evidence.a.max())
    old, new = (linear_to_srgb(np.minimum(side, 1.0) if clipped else side) for side in (a, b))
    usable = (old > 0.1) & (new > 0.1) & (np.abs(np.log(np.where(old > 0.1, old, 1.0))) > 0.02)
    if np.count_nonzero(usable) < 16:
        return
    power = float(np.median(np.log(new[usable]) / np.log(old[usable])))
    text = f"another gamma: to the power {power:.4g}, sRGB-encoded"
    if clipped:
        text = f"clipped at 1 and {text}"
    values = {"power": power, "clipped": clipped}
    predicted = _decoded(_power(old, power, 1.0)).astype(np.float32)
    yield Explanation(Finding("another gamma", text, values), evidence.left(predicted))


def _power(values: NDArray[np.float32], power: float, factor: float) -> NDArray[np.float32]:
    magnitude = np.abs(values).astype(np.float64)
    with np.errstate(divide="ignore", over="ignore"):
        scaled = np.where(magnitude > 0, magnitude**power, 0.0) * factor
    return (np.sign(values) * np.minimum(scaled, 1e30)).astype(np.float32)


def _light(values: NDArray[np.float32], gamma: float | None) -> NDArray[np.float64]:
    if gamma == 1.0:
        return values.astype(np.float64)
    return (
        _decoded(values) if gamma is None else np.maximum(values, 0.0).astype(np.float64) ** gamma
    )


def _stored(linear: NDArray[np.float64], gamma: float | None) -> NDArray[np.float32]:
    light = linear.astype(np.float32)
    if gamma == 1.0:
        return light
    light = np.clip(light, 0.0, 1.0)
    return linear_to_srgb(light) if gamma is None else light ** np.float32(1 / gamma)

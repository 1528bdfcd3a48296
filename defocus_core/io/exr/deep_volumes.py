"""Samples of two deep pictures in one pixel: volumes are cut, and those in one place are mixed.

Light is absorbed evenly along a volume: a part t of one of alpha a has 1 - (1 - a)^t. Samples in
one place are mixed by what each absorbs (P. Hillman, The Theory of OpenEXR Deep Samples; F. Kainz,
Interpreting OpenEXR Deep Pixels, 2013).
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

from defocus_core.io.exr.deep_samples import ALPHA, BACK, DEPTH, FRONT, Strip, middle

if TYPE_CHECKING:
    from numpy.typing import NDArray

_CUT = 1 << 12  # pixels cut at once
_OPAQUE = 1e6  # absorption of alpha 1


def tidy(strip: Strip, light: tuple[str, ...], mixed: NDArray[Any]) -> Strip:
    """The samples in which no volume holds another one."""
    import numpy as np

    front, back = strip.values[FRONT], strip.values[BACK]
    is_volume = (back > front) & np.isfinite(back) & (front > 0)
    counts = np.bincount(strip.pixel)
    cut = np.unique(strip.pixel[is_volume & (counts[strip.pixel] > 1)])
    kept = ~is_volume | ~np.isin(strip.pixel, cut)
    pieces = [(strip.pixel[kept], *(strip.values[n][kept] for n in (*light, DEPTH)))]
    for first in range(0, len(cut), _CUT):
        pieces += _pieces(strip, is_volume, cut[first : first + _CUT], light)
    pixel, *values = (np.concatenate(column) for column in zip(*pieces, strict=True))
    order = np.lexsort((np.nan_to_num(values[-1], nan=np.inf, posinf=np.inf), pixel))
    pixel, values = _mixed(pixel[order], [each[order] for each in values], mixed)
    rank = np.arange(len(pixel)) - np.searchsorted(pixel, pixel)
    named = zip((*light, DEPTH), values, strict=True)
    return Strip(strip.window, pixel, rank, {n: each.astype("f4") for n, each in named})


def _pieces(
    strip: Strip, is_volume: NDArray[Any], pixels: NDArray[Any], light: tuple[str, ...]
) -> list[tuple[NDArray[Any], ...]]:
    """The pixel, light and depth of the volumes of pixels between neighbouring cuts."""
    import numpy as np

    chosen = np.flatnonzero(np.isin(strip.pixel, pixels))
    at = np.searchsorted(pixels, strip.pixel[chosen]), strip.rank[chosen]
    shape = len(pixels), int(strip.rank[chosen].max()) + 1

    def dense(values: NDArray[Any], nothing: float) -> NDArray[Any]:
        array = np.full(shape, nothing, np.float64)
        array[at] = values[chosen]
        return array

    front, back = (dense(strip.values[n], np.inf) for n in (FRONT, BACK))
    volume = dense(is_volume, 0) > 0
    back = np.where(volume, back, front)
    alpha = dense(strip.values[ALPHA], 0)
    color = [dense(strip.values[n], 0) / np.where(alpha > 0, alpha, 1) for n in light]
    length = np.subtract(back, front, where=volume, out=np.ones(shape))
    cuts, absorbed, pieces = np.sort(np.concatenate([front, back], 1), 1).T, _absorbed(alpha), []
    for near, far in pairwise(cuts):
        inside = volume & (front <= near[:, None]) & (back >= far[:, None]) & (far > near)[:, None]
        some = inside.any(1)
        first, last = near[some], far[some]
        fractions = (inside * absorbed / length)[some] * (last - first)[:, None]
        alphas = _alpha_per(total := fractions.sum(1)) * total
        values = [_ratio((fractions * each[some]).sum(1), total) * alphas for each in color]
        pieces.append((pixels[some], *values, middle(first, last)))
    return pieces


def _mixed(
    pixel: NDArray[Any], values: list[NDArray[Any]], where: NDArray[Any]
) -> tuple[NDArray[Any], list[NDArray[Any]]]:
    """Sorted samples, their alpha and depth last, in which those of one place are one."""
    import numpy as np

    *light, alpha, depth = values
    same = (pixel[1:] == pixel[:-1]) & (depth[1:] == depth[:-1]) & np.isin(pixel[1:], where)
    if not same.any():
        return pixel, values
    first = np.concatenate([[True], ~same])
    group, absorbed = np.cumsum(first) - 1, _absorbed(alpha)
    weights = _ratio(absorbed, alpha) * _alpha_per(np.bincount(group, absorbed))[group]
    mixed = [np.bincount(group, weights * each) for each in (*light, alpha)]
    return pixel[first], [*mixed, depth[first]]


def _absorbed(alpha: NDArray[Any]) -> NDArray[Any]:
    """How much samples absorb: it adds up, and 1 - exp(-absorbed) is their alpha."""
    import numpy as np

    with np.errstate(divide="ignore"):
        absorbed: NDArray[Any] = np.minimum(-np.log1p(-alpha.astype("f8")), _OPAQUE)
    return absorbed


def _alpha_per(absorbed: NDArray[Any]) -> NDArray[Any]:
    """Alpha by what is absorbed."""
    import numpy as np

    return _ratio(-np.expm1(-absorbed), absorbed)


def _ratio(part: NDArray[Any], whole: NDArray[Any]) -> NDArray[Any]:
    import numpy as np

    ratio: NDArray[Any] = part / np.where(whole > 0, whole, 1)
    return ratio

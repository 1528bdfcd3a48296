"""Measures of a finished picture for the card of a dataset: its blur, its lights, its trust.

They are of a grid of its pixels, so that they cost next to nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from defocus_core.io.arrays import sample_plane
from defocus_core.picture.take import Take

_WHITE = 0.9999  # of an integer picture, in linear light
_FLOATS = (".exr", ".hdr")  # whose light has no end
RADII = ("coc_mean_px", "coc_p50_px", "coc_p99_px")  # mean, median, 99th percentile, unsigned
# Keys of the measures, in the order of the table of a card.
MEASURES = (*RADII, "clipped_share", "invented_share")


def measures(take: Take) -> dict[str, float | None]:
    """The measures of a picture.

    Returns ``coc_mean_px``, ``coc_p50_px`` and ``coc_p99_px`` of the radii without sign, in px, of
    pixels that hold something; ``clipped_share`` of the pixels that are white in a colour, not of
    EXR and HDR; ``invented_share`` of the pixels of which less than 99 % of the lens saw what the
    picture holds; None where nothing is known.
    """
    nothing = None if take.inputs.empty is None else sample_plane(take.inputs.empty)
    pixels = take.stats.get("pixels", 0)
    invented = take.stats.get("pixels_invented")
    return {
        **radius_measures(sample_plane(take.shown), nothing),
        "clipped_share": _clipped_share(take),
        "invented_share": None if invented is None or not pixels else invented / pixels,
    }


def radius_measures(radius: Any, nothing: Any) -> dict[str, float]:
    """Mean, median and 99th percentile of the radii without sign, in px, by their keys.

    `nothing`: where pixels hold nothing; None if nowhere.
    """
    sizes = np.abs((radius if nothing is None else radius[~nothing]).astype("float64"))
    if not sizes.size:
        return dict.fromkeys(RADII, 0.0)
    # as `np.percentile` has them, which imports a tenth of NumPy
    ordered, place = np.sort(sizes, axis=None), np.array([0.5, 0.99]) * (sizes.size - 1)
    percentiles = np.interp(place, np.arange(sizes.size), ordered)
    return dict(zip(RADII, map(float, (sizes.mean(), *percentiles)), strict=True))


def _clipped_share(take: Take) -> float | None:
    """The share of pixels of the input that are white in a colour; None of EXR and HDR."""
    color = take.inputs.color
    if color.path.suffix.lower() in _FLOATS:
        return None
    return float(np.mean(np.any([sample_plane(plane) >= _WHITE for plane in color.light], axis=0)))

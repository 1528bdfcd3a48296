"""Qualities: settings on one curve from fast to accurate."""

from __future__ import annotations

from dataclasses import dataclass, replace

from defocus_core.allowed_values import QUALITIES
from defocus_core.gone import remedy


@dataclass(frozen=True)
class Quality:
    """Settings of the renderer that trade time for error; the algorithm is the same for all.

    Thresholds of radii and slopes are no round numbers, so that rounding does not decide a
    comparison.
    """

    near_spacing: float  # distance in px between the radii of neighbouring slices near focus
    far_spacing: float  # the same as a share of the radius, where that is more
    # Greatest ratio of radii within a layer: slices of one layer add up, layers occlude each
    # other
    layer_ratio: float
    hidden_stride: int  # hidden content uses every slice (1) or every other (2)
    hidden_level: int  # how many times the resolution of hidden content is halved
    min_slope: float  # slopes of the radius in px per px below which a surface counts as not tilted
    # Radius in px from which on slices are blurred at half resolution; from twice this radius
    # at a quarter, and so on
    full_resolution: float
    # Number of parts of the aperture that are composited one by one for the centre image: 1, 4
    # or 16. With 1, the dual-pixel pair composites its halves in addition
    parts: int
    known_parts: int  # the same where layers say what is hidden: more parts are more accurate then

    def of_layers(self, deepest: int) -> Quality:
        """The same settings for layers."""
        return self if deepest == 1 else replace(self, parts=self.known_parts)


_STANDARD = Quality(
    near_spacing=0.75,
    far_spacing=0.12,
    layer_ratio=1.6,
    hidden_stride=2,
    hidden_level=1,
    min_slope=0.1013,
    full_resolution=20.0,
    parts=1,
    known_parts=4,
)
_HIGH = replace(
    _STANDARD,
    far_spacing=0.06,
    layer_ratio=4 / 3,
    hidden_stride=1,
    hidden_level=0,
    min_slope=0.0513,
    full_resolution=40.0,
    parts=4,
)
_REFERENCE = replace(
    _HIGH,
    far_spacing=0.04,
    layer_ratio=1.2,
    min_slope=0.0213,
    full_resolution=60.0,
    parts=16,
    known_parts=16,
)
QUALITY: dict[str, Quality] = dict(zip(QUALITIES, (_STANDARD, _HIGH, _REFERENCE), strict=True))


def find(name: str) -> Quality:
    """The settings of a quality."""
    if name not in QUALITIES:  # a name that has no hash is refused, too
        suited = remedy("value", name, "quality", "standard suits most")
        raise ValueError(f"quality must be one of {', '.join(QUALITIES)}, got {name!r}; {suited}")
    return QUALITY[name]

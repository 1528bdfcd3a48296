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
    # Whether a pixel that holds parts of two surfaces is taken apart; pictures that are
    # rendered at half size gain nothing by it
    unmixes: bool
    hidden_stride: int  # hidden content uses every slice (1) or every other (2)
    hidden_level: int  # how many times the resolution of hidden content is halved
    min_slope: float  # slopes of the radius in px per px below which a surface counts as not tilted
    # Radius in px from which on slices are blurred at half resolution; from twice this radius
    # at a quarter, and so on
    full_resolution: float
    # Whether a picture is rendered at half its size, and gets the detail of its parts in focus
    # afterwards
    half_size: bool
    # Number of parts of the aperture that are composited one by one for the centre image: 1, 4
    # or 16. With 1, the dual-pixel pair composites its halves in addition
    parts: int
    known_parts: int  # the same where layers say what is hidden: more parts are more accurate then

    def of_layers(self, deepest: int) -> Quality:
        """The same settings for layers, which are not rendered at half size."""
        parts = self.parts if deepest == 1 else self.known_parts
        return replace(self, half_size=False, parts=parts)

    def in_coarse_pixels(self) -> Quality:
        """The same settings for a picture at half size: lengths in coarse pixels of two px."""
        near, full = self.near_spacing / 2, self.full_resolution / 2
        return replace(self, near_spacing=near, full_resolution=full, half_size=False)


_DRAFT = Quality(
    near_spacing=1.5,
    far_spacing=0.2,
    layer_ratio=2.0,
    unmixes=False,
    hidden_stride=2,
    hidden_level=1,
    min_slope=0.2013,
    full_resolution=28.0,
    half_size=True,
    parts=1,
    known_parts=1,
)
_STANDARD = replace(
    _DRAFT,
    near_spacing=0.75,
    far_spacing=0.12,
    layer_ratio=1.6,
    unmixes=True,
    min_slope=0.1013,
    full_resolution=20.0,
    half_size=False,
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
QUALITY: dict[str, Quality] = dict(
    zip(QUALITIES, (_DRAFT, _STANDARD, _HIGH, _REFERENCE), strict=True)
)


def find(name: str) -> Quality:
    """The settings of a quality."""
    if name not in QUALITIES:  # a name that has no hash is refused, too
        suited = remedy("value", name, "quality", "standard suits most")
        raise ValueError(f"quality must be one of {', '.join(QUALITIES)}, got {name!r}; {suited}")
    return QUALITY[name]

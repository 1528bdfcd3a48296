"""Qualities: settings on one curve from fast to accurate."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Quality:
    """Settings of the renderer that trade time for error; the algorithm is the same for all.

    What radii and slopes are compared with is no round number: see `ties`.

    Attributes:
        near_spacing: Distance in px between the radii of neighbouring slices near focus.
        far_spacing: The same as a share of the radius, where that is more.
        layer_ratio: Greatest ratio of radii within a layer: slices of one layer add up, layers
            occlude each other.
        unmixes: Whether pixels that hold parts of two surfaces are taken apart; cells that get
            their detail back gain nothing by it.
        hidden_stride: Hidden content uses every slice (1) or every other (2).
        hidden_halvings: How many times the resolution of what is invented is halved.
        least_slope: Slopes of the radius in px per px below which a surface counts as not tilted.
        full_resolution: Radius in px from which on slices are blurred at half resolution, at twice
            that at a quarter, and so on.
        half_size: Whether pictures are rendered at half of their size, and get the detail of what
            is in focus afterwards.
        parts: Parts of the aperture that are composited one by one for the centre image: 1, 4
            or 16. With one, the dual-pixel pair composites its halves besides.
    """

    near_spacing: float
    far_spacing: float
    layer_ratio: float
    unmixes: bool
    hidden_stride: int
    hidden_halvings: int
    least_slope: float
    full_resolution: float
    half_size: bool
    parts: int

    def in_cells(self) -> Quality:
        """The same settings in cells of two px."""
        near, full = self.near_spacing / 2, self.full_resolution / 2
        return replace(self, near_spacing=near, full_resolution=full, half_size=False)


QUALITY: dict[str, Quality] = {
    "draft": Quality(
        near_spacing=1.5,
        far_spacing=0.2,
        layer_ratio=2.0,
        unmixes=False,
        hidden_stride=2,
        hidden_halvings=1,
        least_slope=0.2013,
        full_resolution=28.0,
        half_size=True,
        parts=1,
    ),
    "standard": Quality(
        near_spacing=0.75,
        far_spacing=0.12,
        layer_ratio=1.6,
        unmixes=True,
        hidden_stride=2,
        hidden_halvings=1,
        least_slope=0.1013,
        full_resolution=20.0,
        half_size=False,
        parts=1,
    ),
    "high": Quality(
        near_spacing=0.75,
        far_spacing=0.06,
        layer_ratio=4 / 3,
        unmixes=True,
        hidden_stride=1,
        hidden_halvings=0,
        least_slope=0.0513,
        full_resolution=40.0,
        half_size=False,
        parts=4,
    ),
    "reference": Quality(
        near_spacing=0.75,
        far_spacing=0.04,
        layer_ratio=1.2,
        unmixes=True,
        hidden_stride=1,
        hidden_halvings=0,
        least_slope=0.0213,
        full_resolution=60.0,
        half_size=False,
        parts=16,
    ),
}
QUALITIES: tuple[str, ...] = tuple(QUALITY)


def find(name: str) -> Quality:
    """The settings of that name.

    Raises:
        ValueError: If there is none.
    """
    if name not in QUALITIES:  # which asks for no hash
        raise ValueError(
            f"quality must be one of {', '.join(QUALITIES)}, got {name!r}; standard suits most"
        )
    return QUALITY[name]

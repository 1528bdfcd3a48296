"""Settings of a rendering, which are checked when they are made, and those of each quality."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from defocus_core.allowed_values import QUALITIES
from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.repair import check_repair
from defocus_core.gone import remedy
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import CatEye
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.optics.outline import PupilImage
from defocus_core.tensors.box import BLOCK
from defocus_core.tensors.validation import described, flag, number, whole


@dataclass(frozen=True)
class Quality:
    """Settings of the renderer that trade time for error; the algorithm is the same for all.

    Thresholds of radii and slopes are not round numbers, so that rounding does not decide
    comparisons.
    """

    near_spacing: float  # distance in px between the radii of neighbouring slices near focus
    far_spacing: float  # the same as a share of the radius, where that is more
    # Greatest ratio of radii within a layer: slices of one layer add up, layers occlude each
    # other
    layer_ratio: float
    hidden_stride: int  # hidden content uses every slice (1) or every other (2)
    hidden_level: int  # how many times the resolution of hidden content is halved
    min_slope: float  # slopes of the radius in px per px below which a surface counts as not tilted
    # Radius in px above which slices are blurred at half resolution; above twice this radius at
    # a quarter, and so on
    full_resolution: float
    # Number of parts of the aperture that are composited one by one for the centre image: 1, 4
    # or 16. With 1, the dual-pixel pair composites its halves in addition
    parts: int
    known_parts: int  # the same where layers say what is hidden, as more parts are more accurate

    def of_layers(self, deepest: int) -> Quality:
        """These settings for a layered scene with at most `deepest` samples in a pixel."""
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


def quality_of(name: str) -> Quality:
    """The settings of a quality."""
    if name not in QUALITIES:  # a name that has no hash is refused, too
        suited = remedy("value", name, "quality", "standard suits most")
        raise ValueError(f"quality must be one of {', '.join(QUALITIES)}, got {name!r}; {suited}")
    return QUALITY[name]


_MAX_LAYERS = 1 << 16  # the number of levels of depth in 16 bits
_BY_SCENE = "None lets the scene decide"


@dataclass(frozen=True)
class Settings:
    """The options of `render`."""

    aperture: Aperture = field(default_factory=Aperture)
    quality: str = "standard"
    left_right: bool = False
    num_layers: int | None = None
    psf_ks: int | None = None
    threads: int = 1
    tile: int | None = None
    infinity: float | None = None
    depth_repair: str = "auto"
    edge_width: float | None = None
    # The repair of depth, where it is known already, as for a frame of a shot
    decided: DepthRepair | None = None
    dual_pixel: DualPixel = field(default_factory=DualPixel)
    cat_eye: CatEye | None = None
    # Which back blurs and composites: "auto" takes the compiled one where it carries the picture
    back: str = "auto"

    def __post_init__(self) -> None:
        """Check each option; convert whole numbers of other types to int."""
        if not isinstance(self.aperture, Aperture):
            problem = f"aperture must be an Aperture, got {described(self.aperture)}"
            remedy = "Aperture() is round"
            if isinstance(self.aperture, PupilImage):
                remedy = "give Aperture(image=…)"
            raise ValueError(f"{problem}; {remedy}")
        if not isinstance(self.dual_pixel, DualPixel):
            problem = f"dual_pixel must be a DualPixel, got {described(self.dual_pixel)}"
            raise ValueError(f"{problem}; DualPixel() has ideal halves")
        if not isinstance(self.cat_eye, CatEye | None):
            problem = f"cat_eye must be a CatEye, got {described(self.cat_eye)}"
            raise ValueError(f"{problem}; None clips nothing")
        opaque = float(self.aperture.fixed.obstruction)
        if self.cat_eye and opaque and opaque >= (size := number("size", self.cat_eye.size)):
            problem = f"cat_eye must be larger than the opaque middle of the pupil, got size {size}"
            raise ValueError(f"{problem} and obstruction {opaque}: no light would pass both")
        quality_of(self.quality)
        flag("left_right", self.left_right)
        check_repair(self.depth_repair, self.edge_width)
        checked: dict[str, float] = {
            "threads": whole("threads", self.threads, "it is how many tiles are computed at once")
        }
        for name, minimum in {"num_layers": 1, "psf_ks": 1, "tile": BLOCK}.items():
            if (count := getattr(self, name)) is not None:
                checked[name] = whole(name, count, _BY_SCENE, minimum)
        if checked.get("num_layers", 1) > _MAX_LAYERS:
            problem = f"num_layers must be {_MAX_LAYERS} at most, got {self.num_layers}"
            raise ValueError(f"{problem}; {_BY_SCENE}")
        if self.infinity is not None:
            radius = checked["infinity"] = number("infinity", self.infinity, "in px")
            if not math.isfinite(radius):
                problem = f"infinity must be a finite radius in px, got {radius}"
                raise ValueError(f"{problem}; None if not known")
        for name, value in checked.items():
            object.__setattr__(self, name, value)


STANDARD = Settings()

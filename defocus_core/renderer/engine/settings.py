"""Settings of a rendering: the options of `render`, checked once for all its pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.repair import check_repair
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import CatEye
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.optics.pupil_image import PupilImage
from defocus_core.renderer.layers.quality import find
from defocus_core.tensors.box import BLOCK
from defocus_core.tensors.validation import described, flag, number, whole

_MAX_LAYERS = 1 << 16  # the number of levels of depth in 16 bits
_BY_SCENE = "None lets the scene decide"


@dataclass(frozen=True)
class Settings:
    """The options that `render` explains."""

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

    def __post_init__(self) -> None:
        """Check each option; whole numbers of other types become int."""
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
        find(self.quality)
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

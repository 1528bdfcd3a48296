"""Dual pixels: how the two photodiodes of a pixel share the light of the pupil."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from defocus_core.allowed_values import DUAL_PIXEL_MODELS, DUAL_PIXEL_SENSORS
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import Rim
from defocus_core.optics.parts import LEFT, RIGHT, Part, Sensitivity
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.validation import Scalar, described, number, one_of

# The share of the light at lens point u.x that the left photodiode gets is 1 for the left half of
# the pupil and 0 for the right, or (1 - u.x) / 2 throughout.
_HALVES: dict[str, tuple[Part, Part]] = dict(
    zip(DUAL_PIXEL_MODELS, ((LEFT, RIGHT), (Part(lean=-1.0), Part(lean=1.0))), strict=True)
)
_MAX_CROSSTALK = 0.5


@dataclass(frozen=True)
class DualPixel:
    """The left and the right photodiodes of a sensor.

    Attributes:
        model: "split", each sees half of the pupil; or "smooth", each sees all of it, with a
            sensitivity that falls linearly from its own side to the other: the linear mask of
            Abuolaim et al., "Learning to reduce defocus blur by realistically modeling dual-pixel
            data", ICCV 2021. Or the name of a sensor that was measured, "@pixel4" or "@canon-dpp":
            one of these models with a crosstalk of its own.
        measured: What the left and the right photodiodes see of a point beyond focus, by
            `sensitivities` of kernels that were measured, instead of a model.
        crosstalk: The share of its light that each gives to the other, below 0.5; a number, or a
            tensor of one number that a gradient flows to.

    Raises:
        ValueError: If an attribute is not one of the above.
    """

    model: str = "split"
    crosstalk: Scalar = 0.0
    measured: tuple[Sensitivity, Sensitivity] | None = None

    def __post_init__(self) -> None:
        one_of("model", self.model, (*DUAL_PIXEL_MODELS, *DUAL_PIXEL_SENSORS))
        pair = self.measured or ()
        if pair and [isinstance(each, Sensitivity) for each in pair] != [True, True]:
            problem = f"measured must be two of Sensitivity, got {described(self.measured)}"
            raise ValueError(f"{problem}; make them of kernels by sensitivities")
        meaning = "it is the share of the light that goes to the other photodiode"
        if not 0 <= number("crosstalk", self.crosstalk, meaning) < _MAX_CROSSTALK:
            problem = f"crosstalk must be 0 or more and below 0.5, got {self.crosstalk}"
            raise ValueError(f"{problem}; {meaning}")

    @property
    def halves(self) -> tuple[Part, Part]:
        """The parts of the pupil that the left and the right photodiodes see."""
        if self.measured is None:
            return _HALVES[DUAL_PIXEL_SENSORS.get(self.model, (self.model,))[0]]
        left, right = (Part(sensitivity=each) for each in self.measured)
        return left, right

    def kernels(self, aperture: Aperture, radius: Tensor, size: int) -> Tensor:
        """`Aperture.kernel` of the centre, left and right images: [..., 3, size, size]."""
        left, right = (aperture.kernel(radius, size, part) for part in self.halves)
        centre = aperture.kernel(radius, size)
        return torch.stack([centre, *self.crossed(torch.stack([left, right]), centre)], -3)

    def crossed(self, pair: Tensor, centre: Tensor) -> Tensor:
        """Left and right [2, C, h, w] with crosstalk, which keeps their mean, the centre."""
        apart = self.separation
        if isinstance(apart, float) and apart == 1:
            return pair
        return centre + (pair - centre) * apart

    @property
    def separation(self) -> Scalar:
        """The distance between left and right with crosstalk, as a fraction of that without."""
        own = DUAL_PIXEL_SENSORS[self.model][1] if self.model in DUAL_PIXEL_SENSORS else 0.0
        return (1 - 2 * self.crosstalk) * (1 - 2 * (0.0 if self.measured else own))

    def disparity(
        self, aperture: Aperture, *, nearer: bool = False, view: Rim | None = None
    ) -> Any:
        """The distance in px along x between the centroids of left and right per px of CoC radius.

        It has the sign of the radius. Returns a number, or [n] for the n points of a view.
        `nearer`: for points nearer than focus, which differ under spherical aberration.
        """
        pupil = aperture.fixed
        left, right = (pupil.centroid(part, nearer=nearer, view=view)[0] for part in self.halves)
        return (right - left) * float(self.separation)

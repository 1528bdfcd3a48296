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

# The share of the light at lens point u.x that the left photodiode gets: by "split", 1 in the left
# half of the pupil and 0 in the right; by "smooth", (1 - u.x) / 2 everywhere.
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
        crosstalk: The share of its light that each photodiode gives to the other, 0 or more and
            below 0.5; a number, or a tensor of one number that a gradient flows to.
        measured: The sensitivities of the left and of the right photodiode, made from measured
            kernels by `sensitivities`; they replace the model.

    Raises:
        ValueError: If the model is unknown, or another attribute is not as described.
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
        """Kernels of the centre, left and right images, in this order: [..., 3, size, size].

        Each is an `Aperture.kernel`; left and right have crosstalk.
        """
        left, right = (aperture.kernel(radius, size, part) for part in self.halves)
        centre = aperture.kernel(radius, size)
        return torch.stack([centre, *self.crossed(torch.stack([left, right]), centre)], -3)

    def crossed(self, pair: Tensor, centre: Tensor) -> Tensor:
        """The pair (left, right) [2, ...] with crosstalk added; their mean stays `centre` [...]."""
        apart = self.separation
        if isinstance(apart, float) and apart == 1:
            return pair
        return centre + (pair - centre) * apart

    @property
    def separation(self) -> Scalar:
        """The distance between left and right, as a fraction of that without crosstalk."""
        own = DUAL_PIXEL_SENSORS[self.model][1] if self.model in DUAL_PIXEL_SENSORS else 0.0
        return (1 - 2 * self.crosstalk) * (1 - 2 * (0.0 if self.measured else own))

    def disparity(
        self, aperture: Aperture, *, nearer: bool = False, view: Rim | None = None
    ) -> Any:
        """The x of the right centroid minus that of the left, in px per px of CoC radius.

        It has the sign of the radius.

        Args:
            aperture: The pupil.
            nearer: Whether points are nearer than focus, which matters with spherical aberration.
            view: The rim that clips the pupil, as seen from n points of the frame; None if nothing
                clips it.

        Returns:
            A number, or a tensor [n] if there is a view.
        """
        pupil = aperture.fixed
        left, right = (pupil.centroid(part, nearer=nearer, view=view)[0] for part in self.halves)
        return (right - left) * float(self.separation)

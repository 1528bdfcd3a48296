"""A pupil given as a picture of its transmission, such as a measured kernel or a cut-out shape."""

from __future__ import annotations

from hashlib import blake2b

import torch
from torch import Tensor

from defocus_core.optics.outline import Outline
from defocus_core.tensors.validation import described

# Transmission below this share of the greatest is dark: noise of a measured picture has no extent.
_DARK = 1e-3


class PupilImage(Outline):
    """A picture of the pupil as points beyond focus show it: x to the right, y down.

    Its centroid lies in the middle of the lens, and the radius of the lens is the greatest distance
    from there to the border of a bright pixel, sideways or up and down. Pixels are squares of even
    transmission, so that areas are exact. Two of the same picture are equal.
    """

    def __init__(self, transmission: Tensor) -> None:
        """Find the centroid and the extent of a picture.

        Args:
            transmission: [H, W], 0 or more; its scale does not matter.

        Raises:
            ValueError: If it is no picture of finite numbers, or all of it is dark.
        """
        if not (isinstance(transmission, Tensor) and transmission.dim() == 2):
            problem = f"transmission must be a tensor [H, W], got {described(transmission)}"
            raise ValueError(f"{problem}; give the mean of a coloured one")
        picture = transmission.detach().to("cpu", torch.float64)
        if not bool(picture.isfinite().all() and (picture >= 0).all()):
            raise ValueError(
                "transmission must be finite and 0 or more, got a value that is not; "
                "mend the picture of the pupil"
            )
        maximum = float(picture.max()) if picture.numel() else 0.0
        if maximum <= 0:
            raise ValueError(
                "transmission must be above 0 somewhere, got a black picture; the pupil is bright"
            )
        picture = picture / maximum
        picture = torch.where(picture > _DARK, picture, 0.0)
        self._key = (tuple(picture.shape), blake2b(picture.numpy().tobytes()).digest())
        self._sums = torch.nn.functional.pad(picture, (1, 0, 1, 0)).cumsum(0).cumsum(1)
        mass = float(self._sums[-1, -1])
        rows, columns = (torch.arange(n, dtype=torch.float64) + 0.5 for n in picture.shape)
        self._middle = float(picture.sum(0) @ columns) / mass, float(picture.sum(1) @ rows) / mass
        self._bright = [(picture.amax(axis) > 0).nonzero()[:, 0] for axis in (0, 1)]
        self._radius = self.reach(self._middle)

    def reach(self, middle: tuple[float, float]) -> float:
        """The greatest distance in px along an axis to the border of a bright pixel."""
        return max(
            max(at - int(bright[0]), int(bright[-1]) + 1 - at)
            for at, bright in zip(middle, self._bright, strict=True)
        )

    @property
    def deviation(self) -> float:
        """The standard deviation of its light along x, in px."""
        light = self._sums[-1].diff()
        away = torch.arange(len(light), dtype=light.dtype) + 0.5 - self._middle[0]
        return float((light @ away**2 / light.sum()).sqrt())

    def about(self, middle: tuple[float, float], radius: float) -> None:
        """Let another place be the middle of the lens, and another radius its own."""
        self._middle, self._radius = middle, radius
        position = repr((*middle, radius)).encode()
        self._key = (self._key[0], blake2b(self._key[1] + position).digest())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PupilImage) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @classmethod
    def placed(cls, picture: Tensor, middle: tuple[float, float], radius: float) -> PupilImage:
        """A picture [H, W] as it is: its px x and y in the middle of the lens, and its radius."""
        image = object.__new__(cls)
        image._key = (tuple(picture.shape), blake2b(picture.numpy().tobytes()).digest())
        image._sums = torch.nn.functional.pad(picture, (1, 0, 1, 0)).cumsum(0).cumsum(1)
        image.about(middle, radius)
        return image

    @property
    def middle(self) -> tuple[float, float]:
        """The px, x and y, of the middle of the lens."""
        return self._middle

    @property
    def radius(self) -> float:
        """The radius of the lens in px."""
        return self._radius

    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """The sum of the picture left of x and above y: bilinear between corners of its pixels."""
        sums = self._sums.to(x.device)
        (row, below), (column, beside) = (
            self._coarse_pixel(value, middle, count)
            for value, middle, count in zip(
                (y, x), reversed(self._middle), self._key[0], strict=True
            )
        )
        corners = [[sums[row + i, column + j] for j in (0, 1)] for i in (0, 1)]
        above, under = (torch.lerp(left, right, beside) for left, right in corners)
        return torch.lerp(above, under, below) / self._radius**2

    def _coarse_pixel(self, position: Tensor, middle: float, count: int) -> tuple[Tensor, Tensor]:
        """The pixel, of `count`, that holds each place of the lens, and the share before it."""
        at = (position * self._radius + middle).clamp(0, count)
        pixel = at.detach().floor().clamp(max=count - 1)
        return pixel.long(), at - pixel

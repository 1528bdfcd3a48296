"""Cat's eyes: the rim of the barrel clips the pupil, more so farther from the middle of the frame.

Light for the border of the frame passes the barrel obliquely, so that the rim and the pupil are not
aligned. What stays open of the pupil has the shape of a cat's eye.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from defocus_core.optics.outline import Disc, Outline, Squeezed
from defocus_core.optics.parts import middles
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.validation import Scalar, number

_LENGTHS = "lengths are in radii of the pupil"
# The rim leaves at least this share of its radius open about the middle of the pupil.
_MIN_OPEN = 0.1
_TINY = 1e-12
# Radius in px below which a clipped pupil is sampled more than once per pixel; most samples per
# pixel and axis.
_FINE_RADIUS, _MAX_FINE = 10.0, 16


class Rim(NamedTuple):
    """The rim of the barrel in front of the pupil, as one or more points of the frame see it."""

    size: Scalar  # its radius in radii of the pupil
    x: Scalar  # lens coordinate u.x of its middle, a number or [...], one for each point
    y: Scalar  # lens coordinate u.y of its middle

    @property
    def outline(self) -> Outline:
        """The outline of the rim's opening."""
        return _OffsetDisc(*self)

    def left_open(
        self, areas: Tensor, x: Tensor, y: Tensor, narrowing: tuple[Scalar, Scalar]
    ) -> Tensor:
        """The share of the pupil's area in each pixel that the rim leaves open.

        Where the borders of pupil and rim cut the same pixel, their overlap is computed as if both
        were straight lines through the middle of the pixel: the smaller area if they are parallel
        and open to the same side, the product of the areas if they cross at right angles.

        Args:
            areas: Area of the pupil in each pixel, [..., m - 1, n - 1]; inf counts as full.
            x: Lens coordinates of the pixels' vertical sides, [..., n].
            y: Lens coordinates of the pixels' horizontal sides, [..., m].
            narrowing: As `Aperture.narrowing`.

        Returns:
            Shares [..., m - 1, n - 1] in [0, 1].
        """
        opening = Squeezed(self.outline, *narrowing).areas(x, y)
        whole = (x.diff()[..., None, :] * y.diff()[..., :, None]).abs()
        there = whole > 0
        pupil, rim = (
            (area / torch.where(there, whole, 1.0)).clamp(0, 1) for area in (areas, opening)
        )
        along = self._parallelism(
            *(middles(at) * times for at, times in zip((x, y), narrowing, strict=True))
        )
        product = pupil * rim
        maximum = torch.where(along > 0, torch.minimum(pupil, rim), (pupil + rim - 1).clamp(min=0))
        both = torch.lerp(product, maximum, along.abs())
        is_open = there & (pupil > 0)
        return torch.where(is_open, both / torch.where(is_open, pupil, 1.0), 0.0)

    def _parallelism(self, x: Tensor, y: Tensor) -> Tensor:
        """How parallel the borders of pupil and rim are at lens points x [..., n], y [..., m].

        Returns [..., m, n]: 1 for parallel borders with openings on the same side, 0 for borders at
        right angles, -1 for parallel borders with openings on opposite sides.
        """
        left, top = (
            middle[..., None] if isinstance(middle, Tensor) else middle
            for middle in (self.x, self.y)
        )
        across, down = x[..., None, :], y[..., :, None]
        beside, below = (x - left)[..., None, :], (y - top)[..., :, None]
        lengths = ((across**2 + down**2) * (beside**2 + below**2) + _TINY).sqrt()
        cosine = (across * beside + down * below) / lengths
        return cosine * (0.6 + 0.4 * cosine**2)  # about 1 minus the angle in right angles

    @property
    def points(self) -> int:
        """The number of points of the frame that see the rim."""
        return self.x.numel() if isinstance(self.x, Tensor) else 1

    @classmethod
    def concatenate(cls, rims: Sequence[Rim]) -> Rim:
        """One rim with the points of several rims, which all have the same size."""
        x, y = (
            torch.stack([torch.as_tensor(each, dtype=torch.float64) for each in positions])
            for positions in zip(*((rim.x, rim.y) for rim in rims), strict=True)
        )
        return cls(rims[0].size, x, y)

    def select(self, which: Tensor | slice) -> Rim:
        """The rim with only the points of the given indices."""
        x, y = (torch.as_tensor(position)[which] for position in (self.x, self.y))
        return self._replace(x=x, y=y)


@dataclass(frozen=True)
class _OffsetDisc(Outline):
    """A disc of any radius and centre, in lens coordinates."""

    size: Scalar
    x: Scalar
    y: Scalar

    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """The area of this disc left of x and above y, scaled from that of the unit disc."""
        left, top = (
            middle[..., None, None] if isinstance(middle, Tensor) else middle
            for middle in (self.x, self.y)
        )
        across = ((x - left) / self.size).clamp(-1, 1)
        down = ((y - top) / self.size).clamp(-1, 1)
        return self.size * self.size * Disc().cumulative_area(across, down)


@dataclass(frozen=True)
class CatEye:
    """A barrel that clips the pupil off the middle of the frame.

    Attributes:
        size: Radius of the rim in radii of the pupil; a small rim clips in the middle, too.
        shift: Distance between the centres of rim and pupil at the corners of the frame, in radii
            of the pupil: the distance of the rim before the pupil, in these radii, times the
            tangent of the field angle.
        vignetting: Whether the picture is darkened by the share of light that the rim blocks.
        pixel_aspect: Width of a pixel divided by its height.

    Size and shift may be tensors of one number, and gradients flow to them.

    Raises:
        ValueError: Unless size is positive and finite, and shift is at least 0 and at most 0.9 of
            size, so that the middle of the pupil stays open.
    """

    size: Scalar = 1.0
    shift: Scalar = 0.0
    vignetting: bool = False
    pixel_aspect: float = 1.0

    def __post_init__(self) -> None:
        size, shift = number("size", self.size, _LENGTHS), number("shift", self.shift, _LENGTHS)
        if not 0 < size < math.inf or not 0 <= shift <= (1 - _MIN_OPEN) * size:
            problem = f"shift must be 0 or more and at most 0.9 of size, got {shift:g} of {size:g}"
            raise ValueError(f"{problem}; {_LENGTHS}")

    @property
    def requires_grad(self) -> bool:
        """Whether gradients flow to size or shift; what depends on them is then not cached."""
        values = (self.size, self.shift)
        return any(isinstance(value, Tensor) and value.requires_grad for value in values)

    def view(self, x: Scalar, y: Scalar, frame: tuple[int, int]) -> Rim:
        """The rim as points of a frame (height, width) see it; x and y are px from the upper left.

        The rim clips the pupil on the side where the point lies: at u.x > 0 for the right border.
        """
        across, down = self._from_middle(x, y, frame)
        size, shift = (
            value.to(x) if isinstance(value, Tensor) and isinstance(x, Tensor) else value
            for value in (self.size, self.shift)
        )
        return Rim(size, shift * -across, shift * -down)

    def _from_middle(self, x: Scalar, y: Scalar, frame: tuple[int, int]) -> tuple[Scalar, Scalar]:
        """Offsets (right, down) of points from the middle, in units of the distance to a corner."""
        height, width = frame
        corner = math.hypot(height, width * self.pixel_aspect) / 2
        return (x - width / 2) * self.pixel_aspect / corner, (y - height / 2) / corner

    def centre_distance(self, x: Tensor, y: Tensor, frame: tuple[int, int]) -> Tensor:
        """The distance between the centres of rim and pupil, in radii of the pupil.

        Arguments are as for `view`. The gradient to `shift` exists in the middle of the frame and
        at a shift of 0, too.
        """
        rim = self.view(x, y, frame)
        distance = torch.hypot(torch.as_tensor(rim.x).detach(), torch.as_tensor(rim.y).detach())
        if not (isinstance(self.shift, Tensor) and self.shift.requires_grad):
            return distance
        across, down = self._from_middle(x, y, frame)
        unit = torch.hypot(torch.as_tensor(across), torch.as_tensor(down))
        shift = self.shift.to(unit)
        return distance + unit * (shift - shift.detach())


def falloff(apart: Tensor, size: Scalar) -> Tensor:
    """The share [...] of a round pupil's area that a rim leaves open.

    Args:
        apart: Distance [...] between the centres of pupil and rim, in radii of the pupil.
        size: Radius of the rim, in radii of the pupil.
    """
    rim = torch.as_tensor(size, dtype=apart.dtype, device=apart.device)
    d, r = apart.detach().clamp(min=1e-9), rim.detach()
    first = ((d * d + 1 - r * r) / (2 * d)).clamp(-1, 1)
    second = ((d * d + r * r - 1) / (2 * d * r)).clamp(-1, 1)
    kite = ((1 + r - d) * (d + 1 - r) * (d - 1 + r) * (d + 1 + r)).clamp(min=0).sqrt()
    lens = first.acos() + r * r * second.acos() - kite / 2
    fraction = (lens / math.pi).clamp(0, 1)
    if not (apart.requires_grad or rim.requires_grad):
        return fraction
    # derivatives of the area: minus the common chord by the distance, and the arc by the radius of
    # the rim; where circles touch, the formula's own derivative is 0/0
    chord, arc = 2 * (1 - first * first).sqrt(), 2 * r * second.acos()
    return fraction + (arc * (rim - r) - chord * (apart - apart.detach())) / math.pi


def fineness(radius: float) -> int:
    """The number of samples per pixel and axis for a blur of `radius` px that a rim clips."""
    return max(1, min(_MAX_FINE, math.ceil(_FINE_RADIUS / radius)))

"""Outlines of the pupil: disc, polygon or picture; obstructed or squeezed.

An outline lies in the unit disc of lens points and gives G(x, y), its area left of x and above y;
differences of G over corners are exact areas of rectangles.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from itertools import pairwise

from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.validation import Scalar, described

# A flatter edge is taken as level at its mean height: 1/slope would cost more than it gains.
_LEVEL_SLOPE = 1e-6
# Rounding error of differences of areas of about 1; the least area that counts in rectangles so
# small, as a share of the rectangle.
_ROUNDING, _MIN_FRACTION = 2e-15, 1e-2
# Opaque discs below this radius hide less than rounding error.
_MIN_RATIO = 1e-7
# Areas are interpolated below this curvature, where the sagitta is below 4e-4 of the radius.
_STRAIGHT = 1e-3


class Outline(ABC):
    """The border of the pupil."""

    @abstractmethod
    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """The area left of x [..., 1, n] and above y [..., m, 1], G(x, y).

        Returns [..., m, n]. Terms of x alone or of y alone may be missing: they cancel in the
        differences of `areas`.
        """

    def areas(self, x: Tensor, y: Tensor) -> Tensor:
        """Areas [..., m - 1, n - 1] of the outline between consecutive x [..., n] and y [..., m].

        x and y lie in [-1, 1], and both ascend or both descend; the unit is the lens radius
        squared.
        """
        x, y = x[..., None, :], y[..., :, None]
        areas = self.cumulative_area(x, y).diff(dim=-1).diff(dim=-2)
        # outside the outline only rounding is left
        minimum = (_MIN_FRACTION * (x.diff(dim=-1) * y.diff(dim=-2)).abs()).clamp(max=_ROUNDING)
        return torch.where(areas > minimum, areas, 0.0)


@dataclass(frozen=True)
class Disc(Outline):
    """The unit disc."""

    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """The area left of x and above y, without terms of x alone or y alone.

        It is the integral over x' <= x of clip(y, -h, h) with h = sqrt(1 - x'²). The integrand
        follows the rim for |x'| beyond a = sqrt(1 - y²), and is constant between.
        """
        a = _half_chord(y)
        rim, rim_at_a = _half_disc_area(x), _half_disc_area(a)
        along_rim = torch.minimum(rim, math.pi / 2 - rim_at_a) + torch.maximum(rim, rim_at_a)
        return y.sign() * along_rim + y * torch.maximum(torch.minimum(x, a), -a)


@dataclass(frozen=True)
class Polygon(Outline):
    """A regular polygon inscribed in the unit disc."""

    sides: int
    # Angle of one vertex in degrees, counter-clockwise from +x as seen in the image
    rotation: float

    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """The area left of x and above y by Green's theorem.

        It is the sum over edges of the integral of min(y, edge height) up to x, which is added for
        edges that bound the polygon at large y, and subtracted for the others.
        """
        total, width = torch.zeros_like(x), torch.zeros_like(x)  # width multiplies y
        for sign, left, right, height, slope in self._edges:
            reach = x.clamp(left, right)
            width = width + sign * reach
            if abs(slope) < _LEVEL_SLOPE:
                middle = height + slope * (right - left) / 2
                total = total + sign * reach * (middle - y).clamp(max=0)
            else:
                drop = (height + slope * (reach - left) - y).clamp(max=0)
                total = total + drop * drop * (sign / (2 * slope))
        return total + width * y

    @cached_property
    def _edges(self) -> list[tuple[float, float, float, float, float]]:
        """Edges that are not vertical: (sign, left x, right x, y at the left, slope)."""
        angles = [math.radians(self.rotation + 360.0 * k / self.sides) for k in range(self.sides)]
        vertices = [(math.cos(a), -math.sin(a)) for a in angles]
        edges = []
        for start, end in zip(vertices, vertices[1:] + vertices[:1], strict=True):
            (x0, y0), (x1, y1) = sorted((start, end))
            if x1 - x0 > 1e-12:
                sign = 1.0 if end[0] > start[0] else -1.0
                edges.append((sign, x0, x1, y0, (y1 - y0) / (x1 - x0)))
        return edges


@dataclass(frozen=True)
class Obstructed(Outline):
    """An outline around an opaque disc, like the secondary mirror of a mirror lens."""

    outline: Outline
    ratio: Scalar  # radius of the opaque disc in radii of the lens, within [0, 1)

    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """The area left of x and above y: that of the outline minus that of the opaque disc."""
        ratio = self.ratio if self.ratio > _MIN_RATIO else 1.0  # its factor below is nearly 0
        inner = Disc().cumulative_area((x / ratio).clamp(-1, 1), (y / ratio).clamp(-1, 1))
        return self.outline.cumulative_area(x, y) - self.ratio**2 * inner


@dataclass(frozen=True)
class Squeezed(Outline):
    """An outline that is narrower along one axis, as an anamorphic lens shows it."""

    outline: Outline
    across: Scalar  # how many times it is narrower along x, 1 or more
    down: Scalar  # how many times it is narrower along y, 1 or more

    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """The area left of x and above y, from that of the outline before it is squeezed."""
        wide, high = (x * self.across).clamp(-1, 1), (y * self.down).clamp(-1, 1)
        return self.outline.cumulative_area(wide, high) / (self.across * self.down)


def _half_disc_area(x: Tensor) -> Tensor:
    """The integral of sqrt(1 - t²) over t from -1 to x."""
    h = _half_chord(x)
    return (x * h + torch.atan2(x, h) + math.pi / 2) / 2


def _half_chord(x: Tensor, radius: Tensor | float = 1.0) -> Tensor:
    """sqrt(radius² - x²), with gradient 0 instead of infinity at |x| = radius."""
    squared = radius * radius - x * x
    inside = squared > 0
    return torch.where(inside, torch.where(inside, squared, 1.0).sqrt(), 0.0)


@dataclass(frozen=True)
class CurvedPolygon(Outline):
    """A polygon inscribed in the unit disc, whose edges are arcs through its vertices."""

    sides: int
    # Angle of one vertex in degrees, counter-clockwise from +x as seen in the image
    rotation: float
    curvature: Scalar  # 1 / radius of the arcs, within [0, 1]; 0 is straight, and 1 is the disc

    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """The area left of x and above y; for nearly straight arcs it is interpolated.

        Areas beside arcs of very large circles lose digits, and are linear in curvature there.
        """
        curvature = torch.as_tensor(self.curvature, dtype=x.dtype, device=x.device)
        if self.curvature >= _STRAIGHT:
            return self._within_arcs(x, y, 1 / curvature)
        straight = Polygon(self.sides, self.rotation).cumulative_area(x, y)
        bulging = self._within_arcs(x, y, torch.full_like(curvature.detach(), 1 / _STRAIGHT))
        return torch.lerp(straight, bulging, curvature / _STRAIGHT)

    def _within_arcs(self, x: Tensor, y: Tensor, radius: Tensor) -> Tensor:
        """The area left of x and above y that arcs of a radius, in lens radii, enclose.

        It is the sum over arcs of the integral of min(y, height of the arc) up to x, which is added
        for arcs that bound the area at large y, and subtracted for the others.
        """
        apothem, half = math.cos(math.pi / self.sides), math.sin(math.pi / self.sides)
        # from the middle of the pupil to the centre of an arc's circle; 0 or negative
        distance = apothem - (radius * radius - half * half).sqrt()
        span = float(torch.asin(half / radius.detach()))
        total = torch.zeros((), dtype=x.dtype, device=x.device)
        for k in range(self.sides):
            start, middle, end = (
                math.radians(self.rotation + 360.0 * (k + part) / self.sides)
                for part in (0.0, 0.5, 1.0)
            )
            across, down = distance * math.cos(middle), -distance * math.sin(middle)
            t, height = x - across, y - down
            upright = _upright(middle - span, middle + span)
            cuts = [
                math.cos(start) - across,
                *(radius * math.cos(angle) for angle in upright),
                math.cos(end) - across,
            ]
            angles = [middle - span, *upright, middle + span]
            for side, limits in zip(pairwise(angles), pairwise(cuts), strict=True):
                left, right = sorted(limits, key=torch.Tensor.item)
                # a gradient moves the cut where the arc ends at it
                piece = torch.where(t < right, torch.where(t > left, t, left), right)
                if math.sin(sum(side) / 2) < 0:  # y is downwards
                    total = total + _up_to_arc(piece, height, radius)
                else:
                    total = total - height * piece - _up_to_arc(piece, -height, radius)
        return total


def inradius(sides: int, curvature: float) -> float:
    """The distance from the middle of the pupil to the middle of an edge."""
    half = math.sin(math.pi / sides)
    sagitta = curvature * half**2 / (1 + math.sqrt(1 - (curvature * half) ** 2))
    return math.cos(math.pi / sides) + sagitta


def _upright(start: float, end: float) -> list[float]:
    """Angles between `start` and `end` at which the tangent of a circle is vertical.

    Between two of them, the arc has one height at each x.
    """
    first, last = math.floor(start / math.pi) + 1, math.ceil(end / math.pi) - 1
    return [k * math.pi for k in range(first, last + 1)]


def _up_to_arc(t: Tensor, height: Tensor, radius: Tensor) -> Tensor:
    """The integral of min(height, sqrt(radius² - t²)) up to t.

    Terms that depend on the height alone are left out.
    """
    chord = torch.where(height > 0, _half_chord(height, radius), radius)
    area, low, high = (_area(s, radius) for s in (t, -chord, chord))
    level = height * torch.where(t.abs() < chord, t, torch.where(t > 0, chord, -chord))
    return level + torch.minimum(area, low) + torch.maximum(area, high)


def _area(t: Tensor, radius: Tensor) -> Tensor:
    """Integral of sqrt(radius² - t²) from 0 to t."""
    h = _half_chord(t, radius)
    return (t * h + radius * radius * torch.atan2(t, h)) / 2


# Transmission below this share of the greatest is dark, so that noise does not extend the pupil.
_DARK = 1e-3


class PupilImage(Outline):
    """A picture of the pupil as points beyond focus show it: x to the right, y down.

    Its centroid is the middle of the lens. The radius of the lens is half the side of the
    smallest square around it that holds all bright pixels. Pixels are squares of constant
    transmission, so that areas are exact. Instances with equal pictures are equal.
    """

    def __init__(self, transmission: Tensor) -> None:
        """Find the centroid and the extent of a picture.

        Args:
            transmission: [H, W], 0 or more; its scale does not matter.

        Raises:
            ValueError: If transmission is not a picture of finite numbers, or all dark.
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
        """Half the side in px of the least square around `middle` that holds all bright pixels."""
        return max(
            max(at - int(bright[0]), int(bright[-1]) + 1 - at)
            for at, bright in zip(middle, self._bright, strict=True)
        )

    @property
    def deviation(self) -> float:
        """The standard deviation of the light along x, in px."""
        light = self._sums[-1].diff()
        away = torch.arange(len(light), dtype=light.dtype) + 0.5 - self._middle[0]
        return float((light @ away**2 / light.sum()).sqrt())

    def set_circle(self, middle: tuple[float, float], radius: float) -> None:
        """Set the middle (x, y) and the radius of the lens, in px of the picture."""
        self._middle, self._radius = middle, radius
        position = repr((*middle, radius)).encode()
        self._key = (self._key[0], blake2b(self._key[1] + position).digest())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PupilImage) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @classmethod
    def placed(cls, picture: Tensor, middle: tuple[float, float], radius: float) -> PupilImage:
        """The pupil of a picture [H, W] whose middle (x, y) and radius are given in px."""
        image = object.__new__(cls)
        image._key = (tuple(picture.shape), blake2b(picture.numpy().tobytes()).digest())
        image._sums = torch.nn.functional.pad(picture, (1, 0, 1, 0)).cumsum(0).cumsum(1)
        image.set_circle(middle, radius)
        return image

    @property
    def middle(self) -> tuple[float, float]:
        """The middle of the lens as (x, y) in px."""
        return self._middle

    @property
    def radius(self) -> float:
        """The radius of the lens in px."""
        return self._radius

    def cumulative_area(self, x: Tensor, y: Tensor) -> Tensor:
        """The area left of x and above y, in lens radii squared, weighted by transmission.

        It is a sum of pixels, bilinear between their corners.
        """
        sums = self._sums.to(x.device)
        (row, below), (column, beside) = (
            self._pixel_at(value, middle, count)
            for value, middle, count in zip(
                (y, x), reversed(self._middle), self._key[0], strict=True
            )
        )
        corners = [[sums[row + i, column + j] for j in (0, 1)] for i in (0, 1)]
        above, under = (torch.lerp(left, right, beside) for left, right in corners)
        return torch.lerp(above, under, below) / self._radius**2

    def _pixel_at(self, position: Tensor, middle: float, count: int) -> tuple[Tensor, Tensor]:
        """The index, below `count`, of the pixel at each lens coordinate, and the position in it.

        Positions in a pixel are 0 to 1. `middle` is the middle of the lens in px along the same
        axis.
        """
        at = (position * self._radius + middle).clamp(0, count)
        pixel = at.detach().floor().clamp(max=count - 1)
        return pixel.long(), at - pixel

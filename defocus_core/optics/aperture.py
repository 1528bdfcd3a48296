"""The pupil: its kernels, sampled by exact area, its parts and their moments.

Lens points ``u`` live in the unit disc, x to the right and y down as in the image, seen from behind
the camera. A scene point at signed radius ``r`` is seen through ``u`` at the offset ``r u``: beyond
focus (r > 0) the blur has the pupil's own orientation, nearer than focus it is turned by 180°.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise

import torch
from torch import Tensor

from defocus_core.optics.outline import Disc, Outline, Polygon
from defocus_core.runtime.validation import number, whole

PSF_TYPES: tuple[str, ...] = ("pillbox", "gaussian")
_MOST_BLADES = 10_000
# Radii below this are drawn as this: far below half a pixel the kernel no longer changes.
_LEAST_RADIUS = 1e-6
# Cuts between sixteen parts, along both axes; the outer parts of a disc are then about as large.
_CUTS = (-1.0, -0.45, 0.0, 0.45, 1.0)
# The least share of the pupil that is a part.
_LEAST_PART = 1e-3
# Pixels across the pupil with which the weight of a part of a gaussian pupil is summed.
_WEIGHING_RADIUS = 256.0
# Radius in px of the kernel of which a centroid is taken.
_CENTROID_RADIUS = 48.0


@dataclass(frozen=True)
class Part:
    """An axis-parallel part of the pupil in lens coordinates: x0 <= u.x <= x1, y0 <= u.y <= y1."""

    x0: float = -1.0
    x1: float = 1.0
    y0: float = -1.0
    y1: float = 1.0

    def clamp(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Lens coordinates, moved into the part."""
        return x.clamp(self.x0, self.x1), y.clamp(self.y0, self.y1)


FULL = Part()
LEFT = Part(x1=0.0)
RIGHT = Part(x0=0.0)


@dataclass(frozen=True)
class Aperture:
    """The pupil: its outline inside the f-number's unit disc, and the weight across it.

    Attributes:
        blades: 0 for a disc, N >= 3 for a regular polygon inscribed in it.
        rotation: Angle of one vertex in degrees, counter-clockwise from +x as seen in the image,
            for points beyond focus.
        psf_type: "pillbox", constant inside the outline as a lens is, or "gaussian",
            exp(-d² / 2 r²) inside the outline.

    Raises:
        ValueError: If blades, rotation or psf_type is not one of the above.
    """

    blades: int = 0
    rotation: float = 0.0
    psf_type: str = "pillbox"

    def __post_init__(self) -> None:
        blades = whole("blades", self.blades, "write 0 for a round aperture", least=0)
        if blades in (1, 2):
            raise ValueError(
                f"blades must be 0 or at least 3, got {blades}; write 0 for a round aperture"
            )
        if blades > _MOST_BLADES:
            raise ValueError(
                f"blades must be {_MOST_BLADES} at most, got {blades}; write 0 for a round aperture"
            )
        if not math.isfinite(number("rotation", self.rotation, "it is an angle in degrees")):
            raise ValueError(
                f"rotation must be a finite angle in degrees, got {self.rotation}; "
                "write 0 for a vertex at +x"
            )
        if self.psf_type not in PSF_TYPES:
            raise ValueError(
                f"psf_type must be one of {', '.join(PSF_TYPES)}, got {self.psf_type!r}; "
                "pillbox is the thin lens"
            )

    @cached_property
    def outline(self) -> Outline:
        """The border; a new shape of pupil is another class of outline, chosen here."""
        return Polygon(self.blades, self.rotation) if self.blades else Disc()

    def kernel(self, radius: Tensor, size: int, part: Part = FULL) -> Tensor:
        """The blur of a point at the given signed radius, sampled by area.

        The value at a pixel is the share of the part's area that falls on this pixel. The sum is 1
        if the blur fits (a gaussian is normalised over the grid); what does not fit is cut off. A
        disc with |radius| <= 0.5 on an odd grid is a delta. Differentiable in radius.

        Args:
            radius: Signed CoC radius in px, any shape, floating point.
            size: Number of pixels on a side. The centre is at (size - 1) / 2 on both axes, for an
                even size the corner between the four middle pixels.
            part: The part of the pupil to draw; turned with it where radius < 0.

        Returns:
            [*radius.shape, size, size], y down then x to the right, in radius' dtype.

        Raises:
            ValueError: If size is below 1, radius is not floating point, or the part lies outside
                the pupil.
        """
        if size < 1:
            raise ValueError(f"size must be at least 1 px, got {size}; use 1 for a point in focus")
        if not radius.is_floating_point():
            raise ValueError(
                f"radius must be a floating-point tensor in px, got {radius.dtype}; "
                "use radius.float()"
            )
        area = _area(self.outline, part)
        if area <= 0.0:
            raise ValueError(f"part must overlap the pupil, got {part}; see Aperture.parts")
        r = radius.double()
        r = torch.where(r.abs() < _LEAST_RADIUS, _LEAST_RADIUS, r)
        corners = torch.arange(size + 1, dtype=r.dtype, device=r.device) - size / 2
        u = corners / r[..., None]  # [..., size + 1], descending where r < 0
        shares = self.outline.areas(*part.clamp(u, u))
        if self.psf_type == "gaussian":
            shares = shares * _profile(u)
            shares = shares / shares.sum((-2, -1), keepdim=True)
        else:
            shares = shares / area
        return shares.to(radius.dtype)

    def share(self, part: Part) -> float:
        """The share of the pupil that lies in the part: the weight of this part in the whole.

        The kernels of parts that tile the pupil, averaged with these weights, are the kernel of
        the whole. LEFT and RIGHT weigh 1/2 each for a disc, for polygons with an even number of
        blades and for odd ones with a vertex at the top or bottom. Otherwise their areas differ
        (48.9 : 51.1 % for five blades at 0°): the centre is the mean of its parts by these weights,
        and the pair is made to have the centre as its plain mean, with the ratio of halves
        normalised each by its area.

        Returns:
            A number in [0, 1]. Where the pupil is gaussian, the share of its weight, to about 1e-6.
        """
        weigh = _weight if self.psf_type == "gaussian" else _area
        return weigh(self.outline, part) / weigh(self.outline, FULL)

    def share_between(self, part: Part, x: Tensor, y: Tensor) -> Tensor:
        """The share [...] of a part's area between x [..., 2] and y [..., 2], both ascending."""
        return self.outline.areas(*part.clamp(x, y))[..., 0, 0] / _area(self.outline, part)

    def parts(self, count: int) -> list[Part]:
        """Cut the pupil into parts, first those of the LEFT half, then those of the RIGHT.

        Two are the halves, four the halves halved again, each by area. Sixteen lie on a grid that a
        quarter turn leaves as it is; they differ in area, and those that hold next to nothing of a
        polygon are left out. The parts of a symmetric pupil are symmetric.

        Raises:
            ValueError: If count is not 1, 2, 4 or 16.
        """
        if count not in (1, 2, 4, 16):
            raise ValueError(f"count must be 1, 2, 4 or 16, got {count}; 4 is twice the halves")
        return list(_parts(self.outline, count))

    def centroid(self, part: Part) -> tuple[float, float]:
        """The mean lens point (u.x, u.y) of a part, to about 1e-4."""
        return _centroid(self, part)

    def first_moments(self, radius: float, part: Part) -> tuple[float, float]:
        """Mean place of the kernel of a part, in px (to the right, downwards)."""
        extent = math.ceil(abs(radius))
        kernel = self.kernel(torch.tensor(radius, dtype=torch.float64), 2 * extent + 1, part)
        offset = torch.arange(-extent, extent + 1, dtype=kernel.dtype)
        return float(kernel.sum(0) @ offset), float(kernel.sum(1) @ offset)


@lru_cache(maxsize=256)
def _centroid(aperture: Aperture, part: Part) -> tuple[float, float]:
    x, y = aperture.first_moments(_CENTROID_RADIUS, part)
    return x / _CENTROID_RADIUS, y / _CENTROID_RADIUS


@lru_cache(maxsize=256)
def _parts(outline: Outline, count: int) -> tuple[Part, ...]:
    if count == 1:
        return (FULL,)
    if count == 2:
        return LEFT, RIGHT
    if count == 4:
        cuts = [(half, _halving_height(outline, half)) for half in (LEFT, RIGHT)]
        return tuple(p for half, y in cuts for p in (replace(half, y1=y), replace(half, y0=y)))
    sides = list(pairwise(_CUTS))
    least = _LEAST_PART * _area(outline, FULL)
    parts = (Part(x0, x1, y0, y1) for x0, x1 in sides for y0, y1 in sides)
    return tuple(part for part in parts if _area(outline, part) > least)


def _halving_height(outline: Outline, part: Part) -> float:
    """The y of the level cut that halves a part's area, by bisection."""
    low, high, half = part.y0, part.y1, _area(outline, part) / 2
    for _ in range(50):
        middle = (low + high) / 2
        if abs(excess := _area(outline, replace(part, y1=middle)) - half) < 1e-14:
            return middle
        low, high = (middle, high) if excess < 0 else (low, middle)
    return (low + high) / 2


@lru_cache(maxsize=4096)
def _area(outline: Outline, part: Part) -> float:
    """Area of the part in units of the lens radius squared."""
    x = torch.tensor([part.x0, part.x1], dtype=torch.float64, device="cpu")
    y = torch.tensor([part.y0, part.y1], dtype=torch.float64, device="cpu")
    return float(outline.areas(x, y))


@lru_cache(maxsize=256)
def _weight(outline: Outline, part: Part) -> float:
    """Area of the part times the gaussian profile, in units of the lens radius squared."""
    u = torch.arange(-_WEIGHING_RADIUS, _WEIGHING_RADIUS + 1, dtype=torch.float64, device="cpu")
    u = u / _WEIGHING_RADIUS
    return float((outline.areas(*part.clamp(u, u)) * _profile(u)).sum())


def _profile(u: Tensor) -> Tensor:
    """exp(-|u|² / 2) at the middle of each pixel, [..., n] corners to [..., n - 1, n - 1].

    Corners are clamped to the unit square, which keeps it positive for any radius.
    """
    inside = u.clamp(-1, 1)
    middle = (inside[..., 1:] + inside[..., :-1]) / 2
    fall = torch.exp(-(middle**2) / 2)
    return fall[..., :, None] * fall[..., None, :]

"""The pupil, its kernels (sampled by exact area), its parts and their moments.

Lens points ``u`` live in the unit disc, x to the right and y down as in the image, seen from behind
the camera. A scene point at signed radius ``r`` is seen through ``u`` at the offset ``r u``: beyond
focus (r > 0) the blur has the pupil's own orientation, nearer than focus it is turned by 180°.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

from defocus_core.optics.cat_eye import Rim, fineness
from defocus_core.optics.outline import (
    CurvedPolygon,
    Disc,
    Obstructed,
    Outline,
    Polygon,
    PupilImage,
    Squeezed,
    inradius,
)
from defocus_core.optics.parts import FULL, Part, area_of, gaussian, middles, parts_of, weight_of
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.validation import Scalar, described, number, whole

PSF_TYPES: tuple[str, ...] = ("pillbox", "gaussian")
_MAX_BLADES = 10_000
# The ranges of the numbers that shape the pupil.
_RANGES = {
    "curvature": (0.0, 1.0, "0 is straight blades, 1 a disc"),
    "obstruction": (0.0, 0.95, "it is the opaque share of the radius"),
    "spherical": (-1.0, 1.0, "0 is a lens without spherical aberration"),
    "squeeze": (0.05, 40.0, "2 is ovals twice as tall as wide"),
}
# Smaller radii are drawn as this one: far below half a pixel the kernel no longer changes.
_MIN_RADIUS = 1e-6
# A blur that is wider than the grid by less than the first share still fits it; the light of wider
# blurs is summed over the second number of coarse pixels across the pupil.
_FITS, _COARSE = 1e-6, 64
# The least factor of spherical aberration on light: a small disc may have a single sample, which
# would otherwise be dark.
_MIN_LIGHT = 0.01
# Radius in px of the kernel that `_fraction_seen` sums, and of the smaller of two in `_centroid`.
_SUMMED_RADIUS = 48.0


@dataclass(frozen=True)
class Aperture:
    """The pupil: its outline inside the f-number's unit disc, and the weight across it.

    Attributes:
        blades: 0 for a disc, N >= 3 for a regular polygon inscribed in it.
        rotation: Angle of one vertex in degrees, counter-clockwise from +x as seen in the image,
            for points beyond focus.
        psf_type: "pillbox", constant inside the outline as a lens is, or "gaussian",
            exp(-|u|² / 2) inside the outline.
        curvature: Curvature of the blades' edges, 1 / radius in lens radii: 0 is straight, 1 is the
            disc.
        obstruction: Radius of an opaque disc in the middle, as a mirror lens has, 0 to 0.95 of the
            lens radius.
        spherical: First-order spherical aberration k, -1 to 1. Light at u is multiplied by
            1 + k (2 |u|² - 1) beyond focus, and by 1 - k (2 |u|² - 1) nearer than focus. A positive
            k gives a bright ring beyond focus and a bright middle nearer than focus.
        image: A picture of the pupil instead of blades.
        squeeze: Height of the pupil divided by its width, 0.05 to 40. The longer half axis is the
            CoC radius.

    Curvature, obstruction, spherical and squeeze may be tensors of one number, and gradients flow
    to them.

    Raises:
        ValueError: If an attribute is outside its range, there is a curvature without blades, there
            are both blades and an image, or the obstruction reaches the blades.
    """

    blades: int = 0
    rotation: float = 0.0
    psf_type: str = "pillbox"
    curvature: Scalar = 0.0
    obstruction: Scalar = 0.0
    spherical: Scalar = 0.0
    image: PupilImage | None = None
    squeeze: Scalar = 1.0

    def __post_init__(self) -> None:
        blades = whole("blades", self.blades, "write 0 for a round aperture", minimum=0)
        if blades in (1, 2) or blades > _MAX_BLADES:
            wanted = "0 or at least 3" if blades < 3 else f"{_MAX_BLADES} at most"
            problem = f"blades must be {wanted}, got {blades}"
            raise ValueError(f"{problem}; write 0 for a round aperture")
        if not math.isfinite(number("rotation", self.rotation, "it is an angle in degrees")):
            problem = f"rotation must be a finite angle in degrees, got {self.rotation}"
            raise ValueError(f"{problem}; write 0 for a vertex at +x")
        if self.psf_type not in PSF_TYPES:
            problem = f"psf_type must be one of {', '.join(PSF_TYPES)}, got {self.psf_type!r}"
            raise ValueError(f"{problem}; pillbox is the thin lens")
        for name, (minimum, maximum, meaning) in _RANGES.items():
            if not minimum <= number(name, getattr(self, name), meaning) <= maximum:
                limits = f"{minimum:g} to {maximum:g}, got {getattr(self, name)}"
                raise ValueError(f"{name} must be from {limits}; {meaning}")
        if self.image is not None and not isinstance(self.image, PupilImage):
            problem = f"image must be a PupilImage, got {described(self.image)}"
            raise ValueError(f"{problem}; make one of a picture [H, W]")
        if self.image is not None and blades:
            raise ValueError(f"blades must be 0 beside an image, got {blades}; keep one of them")
        if not blades and not _is(self.curvature, 0.0):
            problem = f"curvature must be 0 without blades, got {self.curvature}"
            raise ValueError(f"{problem}; give it blades, like 6")
        inner = inradius(blades, self._number("curvature")) if blades else 1.0
        if (ratio := self._number("obstruction")) >= inner:
            problem = f"obstruction must be below {inner:.4g}, where blades are, got {ratio:g}"
            raise ValueError(f"{problem}; more or rounder blades leave more open")

    def _number(self, name: str) -> float:
        return number(name, getattr(self, name))

    @cached_property
    def outline(self) -> Outline:
        """The outline that the attributes describe.

        A new shape of pupil is a new subclass of `Outline`, which is chosen here.
        """
        shape: Outline = Polygon(self.blades, self.rotation) if self.blades else Disc()
        if self.image is not None:
            shape = self.image
        elif _is(self.curvature, 1.0):
            shape = Disc()
        elif not _is(self.curvature, 0.0):
            shape = CurvedPolygon(self.blades, self.rotation, self.curvature)
        if not _is(self.obstruction, 0.0):
            shape = Obstructed(shape, self.obstruction)
        return shape if _is(self.squeeze, 1.0) else Squeezed(shape, *self.narrowing)

    @property
    def narrowing(self) -> tuple[Scalar, Scalar]:
        """How many times the pupil is narrower than the CoC along x and along y, each 1 or more."""
        tall = bool(self.squeeze >= 1)
        return (self.squeeze, 1.0) if tall else (1.0, 1 / self.squeeze)

    @property
    def requires_grad(self) -> bool:
        """Whether gradients flow to an attribute; what depends on them is then not cached."""
        values = (getattr(self, name) for name in _RANGES)
        return any(isinstance(value, Tensor) and value.requires_grad for value in values)

    @property
    def fixed(self) -> Aperture:
        """The same pupil with plain numbers in place of tensors, to serve as a key of caches."""
        learnt: dict[str, Any] = {
            name: float(value.detach())
            for name in _RANGES
            if isinstance(value := getattr(self, name), Tensor)
        }
        return replace(self, **learnt) if learnt else self

    def kernel(
        self, radius: Tensor, size: int, part: Part = FULL, view: Rim | None = None
    ) -> Tensor:
        """The blur of a point at the given signed radius, sampled by area.

        The value at a pixel is the share of the part's light that falls on this pixel. The sum is 1
        if the blur fits; what does not fit is cut off. A disc with |radius| <= 0.5 on an odd grid
        is a delta. Differentiable in radius.

        Args:
            radius: Signed CoC radius in px, any shape, floating point.
            size: Number of pixels on a side. The centre is at (size - 1) / 2 on both axes, for an
                even size the corner between the four middle pixels.
            part: The part of the pupil to draw, turned with the pupil where radius < 0.
            view: The rim that clips the pupil, seen from one point of the frame for each radius;
                None if nothing clips it.

        Returns:
            [*radius.shape, size, size], y down then x to the right, in radius' dtype.

        Raises:
            ValueError: If size is below 1, radius is not floating point, or the part lies outside
                the pupil.
        """
        if size < 1:
            raise ValueError(f"size must be at least 1 px, got {size}; use 1 for a point in focus")
        if not radius.is_floating_point():
            problem = f"radius must be a floating-point tensor in px, got {radius.dtype}"
            raise ValueError(f"{problem}; use radius.float()")
        if (area := self._of_outline(area_of, part)) <= 0.0:
            raise ValueError(f"part must overlap the pupil, got {part}; see Aperture.parts")
        r = radius.double()
        r = torch.where(r.abs() < _MIN_RADIUS, _MIN_RADIUS, r)
        fine = 1 if view is None else fineness(float(r.detach().abs().min()))
        corners = torch.arange(size * fine + 1, dtype=r.dtype, device=r.device) / fine - size / 2
        u = corners / r[..., None]  # [..., size + 1], descending where r < 0
        light = self._light(u, r, part, view)
        if fine > 1:
            light = light.reshape(*r.shape, size, fine, size, fine).sum((-3, -1))
        uneven = self.psf_type == "gaussian" or part.is_uneven or not _is(self.spherical, 0.0)
        if not (uneven or view):
            return (light / area).to(radius.dtype)
        whole = light.sum((-2, -1), keepdim=True)
        cut = (2 * r.detach().abs() > size * (1 + _FITS))[..., None, None]
        if bool(cut.any()):
            limits = torch.linspace(-1, 1, _COARSE + 1, dtype=r.dtype, device=r.device)
            beyond = self._light(limits * r.detach().sign()[..., None], r, part, view)
            whole = torch.where(cut, beyond.sum((-2, -1), keepdim=True), whole)
        dark = whole <= 0  # the area that a rim leaves open may be below rounding
        if bool(dark.any()):
            x, y = part.clamp(u[..., ::fine], u[..., ::fine])
            even = self.outline.areas(x, y) / area
            light = torch.where(dark, even, light / torch.where(dark, 1.0, whole))
        else:
            light = light / whole
        return light.to(radius.dtype)

    def _light(self, u: Tensor, r: Tensor, part: Part, view: Rim | None) -> Tensor:
        """Light [..., n - 1, n - 1], not normalised, of pixels with corners at lens points u.

        u is [..., n]. Spherical aberration depends on the sign of the signed radii r [...].
        """
        x, y = part.clamp(u, u)
        light = self.outline.areas(x, y)
        # a grey pixel of a picture is not cut by a border
        areas = light if self.image is None else torch.full_like(light, torch.inf)
        if self.psf_type == "gaussian":
            light = light * gaussian(u)
        if not _is(self.spherical, 0.0):
            light = light * self._aberration(u, r)
        if part.is_uneven:
            light = light * part.counted(u, self.narrowing)
        return light if view is None else light * view.left_open(areas, x, y, self.narrowing)

    def _of_outline(self, weigh: Any, part: Part) -> Scalar:
        """The area or the weight of a part: `weigh` is `area_of` or `weight_of`.

        It is cached unless gradients flow to the pupil.
        """
        outline = self.outline if self.requires_grad else self.fixed.outline
        weight: Scalar = (weigh.__wrapped__ if self.requires_grad else weigh)(outline, part)
        return weight

    def _aberration(self, u: Tensor, r: Tensor) -> Tensor:
        """The factor by which spherical aberration multiplies light, at the middle of each pixel.

        It is [..., n - 1, n - 1] for pixels with corners at lens points u [..., n]; r [...] are
        signed radii. A ray at height h ends at r (h + k h³); to first order the light changes with
        the square of h.
        """
        x, y = (middles(u) * times for times in self.narrowing)
        squared = (x[..., None, :] ** 2 + y[..., :, None] ** 2).clamp(max=1)
        light = 1 + self.spherical * r.detach().sign()[..., None, None] * (2 * squared - 1)
        return light.clamp(min=_MIN_LIGHT)

    def fraction(self, part: Part) -> Scalar:
        """The share of the pupil's area that lies in a part: its weight when parts are averaged.

        With these weights, the mean of the kernels of parts that tile the pupil is the kernel of
        the whole, and the mean of the left and right views is the centre view. LEFT and RIGHT of an
        asymmetric pupil differ (48.9 : 51.1 % for five blades at 0°). For a gaussian pupil it is
        the share of light instead, to about 1e-6. Returns a number, or a tensor if gradients flow
        to the pupil.
        """
        if part.sensitivity is not None:
            seen = _fraction_seen.__wrapped__ if self.requires_grad else _fraction_seen
            return seen(self if self.requires_grad else self.fixed, part)
        if part.lean:
            return (1 + part.lean * self.narrowing[0] * self.centroid(FULL)[0]) / 2
        weigh = weight_of if self.psf_type == "gaussian" else area_of
        return self._of_outline(weigh, part) / self._of_outline(weigh, FULL)

    def fraction_between(self, part: Part, x: Tensor, y: Tensor) -> Tensor:
        """The share [...] of a part's area that lies in rectangles of lens coordinates.

        x [..., 2] are the left and right sides of the rectangles, y [..., 2] the upper and lower
        ones.
        """
        area = self._of_outline(area_of, part)
        return self.outline.areas(*part.clamp(x, y))[..., 0, 0] / area

    def parts(self, count: int) -> list[Part]:
        """The parts into which the pupil is cut, those of the LEFT half before those of the RIGHT.

        Two parts are the halves; four are the halves halved again by area. Sixteen lie on a grid
        that a quarter turn maps to itself; parts with less than 0.1 % of the pupil's area are left
        out. With spherical aberration, 16 gives four parts, as the weights of outer parts would
        depend on the sign of r.

        Raises:
            ValueError: If count is not 1, 2, 4 or 16.
        """
        if count not in (1, 2, 4, 16):
            raise ValueError(f"count must be 1, 2, 4 or 16, got {count}; 4 is twice the halves")
        if count > 4 and not _is(self.spherical, 0.0):
            count = 4
        return list(parts_of(self.fixed.outline, count))

    def centroid(
        self, part: Part, *, nearer: bool = False, view: Rim | None = None
    ) -> tuple[Scalar, Scalar]:
        """The mean lens point (u.x, u.y) of the light of a part.

        The error is 1e-6 for a disc and up to 1e-4 for other pupils.

        Args:
            part: The part of the pupil.
            nearer: Whether the light is that of points nearer than focus.
            view: The rim that clips the pupil, as seen from n points of the frame; None if nothing
                clips it.

        Returns:
            Two numbers; tensors if gradients flow to the pupil; tensors [n] if there is a view.
        """
        if self.requires_grad or view is not None:
            return _centroid.__wrapped__(self, part, nearer=nearer, view=view)
        return _centroid(self.fixed, part, nearer=nearer)

    def first_moments(self, radius: float, part: Part) -> tuple[Scalar, Scalar]:
        """The centroid (x, y) of the kernel of a part, in px to the right and downwards."""
        size = 2 * math.ceil(abs(radius)) + 1
        x, y = _mean_place(self.kernel(torch.tensor(radius, dtype=torch.float64), size, part))
        return (x, y) if self.requires_grad else (float(x), float(y))


@lru_cache(maxsize=256)
def _centroid(
    aperture: Aperture, part: Part, *, nearer: bool = False, view: Rim | None = None
) -> tuple[Scalar, Scalar]:
    """`Aperture.centroid`, extrapolated from kernels of two radii.

    The error of a kernel's centroid falls with 1 / radius². Kernels have an even size, so that the
    line between the halves runs between pixels.
    """
    places = []
    first = _SUMMED_RADIUS / (1 if view is None else 2)  # a quarter of the time for many points
    for radius in (first, 2 * first):
        r = torch.tensor(-radius if nearer else radius, dtype=torch.float64)
        of_points = r if view is None else r.expand(view.points)
        kernel = aperture.kernel(of_points, 2 * int(radius), part, view)
        places.append([place / r for place in _mean_place(kernel)])
    x, y = (fine + (fine - coarse) / 3 for coarse, fine in zip(*places, strict=True))
    return (x, y) if aperture.requires_grad or view is not None else (float(x), float(y))


def _mean_place(kernel: Tensor) -> tuple[Tensor, Tensor]:
    """The centroids (x, y), in px from the middle, of kernels [..., size, size] that sum to 1."""
    offset = torch.arange(kernel.shape[-1], dtype=kernel.dtype) - (kernel.shape[-1] - 1) / 2
    return kernel.sum(-2) @ offset, kernel.sum(-1) @ offset


@lru_cache(maxsize=256)
def _fraction_seen(aperture: Aperture, part: Part) -> Scalar:
    """The share of the pupil's light that a photodiode gets, whose sensitivity `part` holds."""
    r, size = torch.tensor(_SUMMED_RADIUS, dtype=torch.float64), 2 * int(_SUMMED_RADIUS) + 1
    corners = torch.arange(size + 1, dtype=r.dtype) - size / 2
    seen = part.counted(corners / r, aperture.narrowing)
    fraction = (aperture.kernel(r, size) * seen).sum() / 2
    return fraction if aperture.requires_grad else float(fraction)


def _is(value: Scalar, number: float) -> bool:
    """Whether a value is a plain number, not a tensor, and equal to `number`."""
    return not isinstance(value, Tensor) and value == number

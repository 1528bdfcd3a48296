"""The thin lens before a sensor: field of view, focus, circle of confusion, depth of field.

Lengths are in mm, angles in radians. The image is that of the pinhole at the lens: it has no
distortion, and focusing does not change its scale. Distances may be negative, the optics habit for
object space, or positive, with the same meaning. Infinity is a depth and a focus distance like any
other. The circle of confusion is that of `optics.law`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Self

import torch
from torch import Tensor

from defocus_core.gone import remedy
from defocus_core.optics.law import coc_of, coc_per_disparity
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.validation import (
    Scalar,
    bad_depth,
    broadcast,
    device_named,
    distance_within,
    each_positive,
    floating,
    number,
    numbers,
    pair,
    positive,
)

_UNITS = "lengths are in mm, an f-number has no unit"
_SIDES = "sensor_size is (width, height) in mm, sensor_res in px"


def fnum_of_strength(strength: float, focus: float, foclen: float, pixel_size: float) -> float:
    """The f-number N of a lens of strength k = f² / (2 p N (1 - f d₀)).

    Args:
        strength: k, px of radius for a disparity of 1 per mm.
        focus: Disparity in focus d₀ per mm, less than 1 / foclen.
        foclen: Focal length f in mm.
        pixel_size: Pixel pitch p in mm.
    """
    return foclen**2 / (2 * pixel_size * strength * (1 - foclen * focus))


def far_point(foclen: Tensor, fnum: Tensor, coc: Tensor) -> Tensor:
    """The focus distance s = f + f² / (N c) in mm at which infinity has a CoC of c, also in mm."""
    return foclen + foclen * foclen / (fnum * coc)


def depth_of_field(foc_dist: Tensor, margin: Tensor, farthest: Tensor) -> tuple[Tensor, Tensor]:
    """(near, far) limits of the depth of field in mm, 1 / (1/s ± c / (A v)); far may be inf.

    Args:
        foc_dist: Focus distance s in mm.
        margin: c / (A v) in 1/mm: the acceptable CoC divided by the CoC of a disparity of 1 per mm.
        farthest: The `far_point` in mm; for a focus at or beyond it, far is inf, whatever the
            rounding error.
    """
    disparity = 1 / foc_dist
    finite = (foc_dist < farthest) & (disparity > margin)
    far = torch.where(finite, 1 / torch.where(finite, disparity - margin, 1.0), math.inf)
    return 1 / (disparity + margin), far


def field_of_view(side: float, foclen: Scalar) -> Scalar:
    """The field of view 2 atan(side / 2f) in radians, for a side of the sensor and f in mm."""
    half = side / 2 / foclen
    return 2 * (half.atan() if isinstance(half, Tensor) else math.atan(half))


def radii_of_each(lenses: Sequence[ThinLens], depth: Tensor) -> Tensor:
    """Signed CoC radii [B, H, W] in px, each map of depth with its own lens.

    Depth is [B, H, W] in mm, > 0, with B lenses. One operation computes all maps; `d_close`,
    `d_far` and `sharp_range` are ignored.
    """
    like, terms = torch.empty(1, dtype=depth.dtype, device="cpu"), []
    for lens in lenses:
        each, s = lens._terms(like)
        terms.append(torch.stack([each, 1 / s, like.new_tensor(2 * lens.pixel_size)]))
    per_disparity, focus, two_pixels = sent(torch.stack(terms, 1)[..., None, None], depth)
    radii: Tensor = coc_of(per_disparity, focus, depth) / two_pixels
    return radii


class ThinLens:
    """A thin lens in front of a sensor of square pixels.

    Every parameter may be a float or a tensor of one number, and gradients flow to it; `foclen`,
    `fnum` and the focus may also be [B], a lens for each picture of a batch of depths [B, …].
    Results have the dtype (at least float32) and the device of the tensor that is passed in;
    `dtype` and `device` apply to arguments that are plain numbers.

    Attributes:
        foclen: Focal length f in mm.
        fnum: F-number N; the aperture is f / N across.
        sensor_size: Sensor (width, height) in mm.
        sensor_res: Sensor (width, height) in px. A smaller image is a crop at the same pitch.
        foc_dist: Minus the focus distance s in mm; set by `refocus`, -20000 or -inf at first.
        d_far: Farther depths have the CoC of this one, in mm; -inf for no limit.
        d_close: Nearer depths have the CoC of this one, in mm; 0 for no limit.
        sharp_range: (nearest, farthest) distance in mm of a range that is given a CoC of 0; None
            for no range. Elsewhere the law is unchanged.
        obj_depth: Depth that the PSF maps show by default, in mm.
    """

    def __init__(
        self,
        foclen: Scalar,
        fnum: Scalar,
        sensor_size: tuple[float, float] = (8.0, 8.0),
        sensor_res: tuple[int, int] = (2000, 2000),
        device: torch.device | str | None = None,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Create a lens with its sensor, focused at 20 m, or at infinity if foclen is 20 m or more.

        Args:
            foclen: Focal length in mm, > 0, or one of each picture [B].
            fnum: F-number, > 0, or one of each picture [B].
            sensor_size: (width, height) in mm.
            sensor_res: (width, height) in px.
            device: Device of results for plain numbers; by default a CUDA device if there is one,
                else the CPU. Results for a tensor stay on the tensor's device.
            dtype: Floating-point type of results for plain numbers.

        Raises:
            ValueError: If a quantity is not positive and finite, the pitches of the two axes differ
                by more than 1 %, or dtype is not floating point.
        """
        for name, value in {"foclen": foclen, "fnum": fnum}.items():
            each_positive(name, value, _UNITS)
        self.foclen = foclen
        self.fnum = fnum
        self.set_sensor(sensor_size, sensor_res)
        self.device = device_named(device)
        self.dtype = floating(dtype)
        self.d_far = -math.inf
        self.d_close = 0.0
        self.sharp_range: tuple[float, float] | None = None
        self.obj_depth = -20000.0
        longest = float(torch.as_tensor(foclen).detach().max())
        self.refocus(-20000.0 if longest < 20000.0 else -math.inf)

    def __getattr__(self, name: str) -> Any:
        """Raise AttributeError; if the attribute was removed, its message names the replacement."""
        words = f"{type(self).__name__!r} object has no attribute {name!r}"
        instead = remedy("python", name, "DefocusLens")
        raise AttributeError("; ".join(filter(None, (words, instead))))

    def __repr__(self) -> str:
        names = ("foclen", "fnum", "sensor_size", "sensor_res", "foc_dist", "device", "dtype")
        values = (getattr(self, name) for name in names)
        plain = (v.detach().squeeze().tolist() if isinstance(v, Tensor) else v for v in values)
        shown = ", ".join(f"{name}={value}" for name, value in zip(names, plain, strict=True))
        return f"{type(self).__name__}({shown})"

    def to(self, device: torch.device | str) -> Self:
        """Set the device of results for plain numbers.

        Parameters in tensors stay what they are, so that gradients and optimisers keep them; they
        are copied to where they are needed.

        Returns:
            This lens.

        Raises:
            ValueError: If there is no such device.
        """
        self.device = device_named(device)
        return self

    def astype(self, dtype: torch.dtype) -> Self:
        """Set the floating-point type of results for plain numbers; returns this lens.

        Raises:
            ValueError: If it is not floating point.
        """
        self.dtype = floating(dtype)
        return self

    def set_sensor(self, sensor_size: tuple[float, float], sensor_res: tuple[int, int]) -> None:
        """Put another sensor behind the lens.

        Args:
            sensor_size: (width, height) in mm.
            sensor_res: (width, height) in px.

        Raises:
            ValueError: If a side is not positive and finite, or the pitches of the two axes differ
                by more than 1 %.
        """
        size, res = pair("sensor_size", sensor_size), pair("sensor_res", sensor_res)
        _pitch(size, res)
        self.sensor_size, self.sensor_res = size, res

    def set_sensor_res(self, sensor_res: tuple[int, int]) -> None:
        """Change the resolution of the sensor, and keep its diagonal in mm.

        The aspect of the sensor becomes that of the resolution, so that pixels are square.

        Args:
            sensor_res: (width, height) in px.

        Raises:
            ValueError: If a side is not positive and finite.
        """
        columns, rows = pair("sensor_res", sensor_res)
        pitch = math.hypot(*self.sensor_size) / math.hypot(
            positive("horizontal sensor_res", columns, _SIDES),
            positive("vertical sensor_res", rows, _SIDES),
        )
        self.set_sensor((columns * pitch, rows * pitch), sensor_res)

    @property
    def pixel_size(self) -> float:
        """The pitch in mm, sensor width in mm / width in px; the same on both axes.

        Raises:
            ValueError: As `set_sensor`, if the attributes were set to invalid values.
        """
        return _pitch(self.sensor_size, self.sensor_res)

    @property
    def r_sensor(self) -> float:
        """Half of the sensor's diagonal in mm."""
        return math.hypot(*self.sensor_size) / 2

    @property
    def hfov(self) -> Scalar:
        """Field of view across the sensor's width, 2 atan(w / 2f), in radians."""
        return field_of_view(self.sensor_size[0], self.foclen)

    @property
    def vfov(self) -> Scalar:
        """Field of view across the sensor's height, in radians."""
        return field_of_view(self.sensor_size[1], self.foclen)

    @property
    def dfov(self) -> Scalar:
        """Field of view across the sensor's diagonal, in radians."""
        return field_of_view(2 * self.r_sensor, self.foclen)

    def refocus(self, foc_dist: Scalar) -> None:
        """Focus at a distance of |foc_dist| mm, which may be infinite.

        Raises:
            ValueError: Unless foc_dist is one number, or one for each picture [B], and
                foclen < |foc_dist|.
        """
        if not (isinstance(foc_dist, Tensor) and foc_dist.dim() == 1):
            number("foc_dist", foc_dist)
        self._require_real_image("foc_dist", foc_dist)
        self._focus = foc_dist

    @property
    def foc_dist(self) -> Scalar:
        """Minus the focus distance in mm; not cached, as each backward pass needs a new graph."""
        return -(self._focus.abs() if isinstance(self._focus, Tensor) else abs(self._focus))

    @foc_dist.setter
    def foc_dist(self, foc_dist: Scalar) -> None:
        self.refocus(foc_dist)

    def signed_radius(self, depth: Scalar) -> Tensor:
        """The law: signed CoC radius r = c / (2 p) in px, the unit of the renderer.

        Args:
            depth: Positive planar depth in mm, any shape; inf allowed.

        Returns:
            Radii in px, depth's shape, negative nearer than focus.

        Raises:
            ValueError: If a depth is zero, negative or NaN, foclen is no longer less than
                |foc_dist|, foclen or fnum no longer positive, or d_close not nearer than d_far.
        """
        depth = self._tensor("depth", depth)
        if not bool((depth > 0).all()):
            raise bad_depth("depth", depth, depth > 0, "positive")
        self._require_real_image("foc_dist", self.foc_dist)
        z = self._limit(depth)
        per_disparity, s = self._terms(z)
        radius: Tensor = coc_of(per_disparity, 1 / s, z) / (2 * self.pixel_size)
        if self.sharp_range is None:
            return radius
        return radius.masked_fill(distance_within("sharp_range", self.sharp_range, z), 0.0)

    def radius_at_infinity(self) -> float:
        """Signed CoC radius in px at infinity, whatever `d_far` is."""
        return number("radius", self.radii_at_infinity(), "radii_at_infinity has all")

    def radii_at_infinity(self) -> Tensor:
        """Signed CoC radii in px at infinity, [B] or 0-dimensional, without gradients."""
        per_disparity, s = self._terms(torch.empty(1, dtype=floating(self.dtype), device="cpu"))
        return (per_disparity / s / (2 * self.pixel_size)).detach()

    def _terms(self, like: Tensor) -> tuple[Tensor, Tensor]:
        """The law's A v in mm² and s in mm, [] or [B, 1, …], with dtype and device of `like`."""
        s = self._parameter("foc_dist", like).abs()
        foclen, fnum = (self._parameter(name, like) for name in ("foclen", "fnum"))
        return coc_per_disparity(foclen, fnum, s), s

    def coc(self, depth: Scalar) -> Tensor:
        """Diameter of the circle of confusion in mm, unsigned.

        Args:
            depth: Distance in mm, of either sign, any shape; ±inf allowed.

        Returns:
            Diameters in mm, depth's shape.

        Raises:
            ValueError: As `signed_radius`.
        """
        # not that of a subclass, which may have another unit of depth
        radius = ThinLens.signed_radius(self, self._distance("depth", depth))
        return 2 * self.pixel_size * radius.abs()

    def hyperfocal(self, coc: Scalar) -> Tensor:
        """The nearest focus distance whose depth of field reaches infinity, f + f² / (N c), in mm.

        Args:
            coc: Acceptable circle of confusion, diameter in mm, > 0.

        Raises:
            ValueError: If coc is not positive.
        """
        c = self._acceptable(coc)
        if not bool((c > 0).all()):
            raise ValueError(f"coc must be positive, got {float(c.min())}; 0.03 mm suits 36×24 mm")
        return self._far_point(c)

    def dof(self, depth: Scalar, coc: Scalar | None = None) -> Tensor:
        """Depth of field in mm of this lens focused at a depth.

        Args:
            depth: Distance in mm, of either sign, any shape, beyond the focal length.
            coc: Acceptable circle of confusion, diameter in mm. None takes the CoC of each point as
                the lens is focused now.

        Returns:
            far - near in mm, infinite from the hyperfocal distance on.

        Raises:
            ValueError: If a depth is NaN or not beyond the focal length, or coc is negative or NaN.
        """
        near, far = self.dof_limits(depth, self.coc(depth) if coc is None else coc)
        endless = far.isinf()
        return torch.where(endless, math.inf, torch.where(endless, 0.0, far) - near)

    def dof_limits(self, foc_dist: Scalar, coc: Scalar) -> tuple[Tensor, Tensor]:
        """Where the CoC reaches ±coc when focused at foc_dist: the law solved for z.

        Args:
            foc_dist: Focus distance in mm, of either sign, any shape, beyond the focal length.
            coc: Acceptable circle of confusion, diameter in mm, >= 0.

        Returns:
            (near, far): positive distances in mm; far is inf from the hyperfocal distance on.

        Raises:
            ValueError: If foc_dist is NaN or not beyond foclen, or coc is negative or NaN.
        """
        s = self._distance("foc_dist", foc_dist)
        self._require_real_image("foc_dist", s)
        c = self._acceptable(coc)
        if not broadcast(c.shape, s.shape):
            raise ValueError(
                f"coc must be one diameter or one for each of {list(s.shape)} distances, got "
                f"{list(c.shape)}; 0.03 mm suits 36×24 mm"
            )
        foclen, fnum = (self._parameter(name, s) for name in ("foclen", "fnum"))
        margin = c.to(s) / coc_per_disparity(foclen, fnum, s)
        return depth_of_field(s, margin, self._far_point(c).to(s))

    def _far_point(self, c: Tensor) -> Tensor:
        return far_point(self._parameter("foclen", c), self._parameter("fnum", c), c)

    def _limit(self, z: Tensor) -> Tensor:
        """Distances z in mm, clamped to d_close and d_far."""
        none = "0 and -inf are no limits"
        close, far = (abs(number(name, getattr(self, name), none)) for name in ("d_close", "d_far"))
        if not (close < math.inf and close <= far and far > 0):
            raise ValueError(
                f"d_close must not be farther than d_far, got d_close={close:g} and "
                f"d_far={far:g} mm away; {none}"
            )
        minimum, maximum = (
            torch.as_tensor(limit, dtype=z.dtype, device=z.device).abs().reshape(())
            for limit in (self.d_close, self.d_far)
        )
        return z.clamp(minimum, maximum)

    def _parameter(self, name: str, other: Tensor) -> Tensor:
        """An attribute as a tensor, 0-dimensional or [B, 1, …], on the device of `other`.

        Its dtype and its number of dimensions are those of `other`, too.
        """
        value = getattr(self, name)
        if name != "foc_dist":  # `refocus` checks it, and allows infinity
            each_positive(name, value, _UNITS)
        value = torch.as_tensor(value, dtype=other.dtype, device=other.device)
        if value.numel() == 1:
            return value.reshape(())
        if other.dim() and len(other) not in (1, len(value)):
            problem = f"{name} must be one number, or one for each of {len(other)} pictures"
            raise ValueError(f"{problem}, got {len(value)}; expand repeats pictures, too")
        return value.reshape(-1, *[1] * (other.dim() - 1))

    def _tensor(self, name: str, value: Scalar) -> Tensor:
        return numbers(name, value, floating(self.dtype), device_named(self.device))

    def _distance(self, name: str, distance: Scalar) -> Tensor:
        z = self._tensor(name, distance).abs()
        if not bool((z > 0).all()):
            raise bad_depth(name, z, z > 0, "other than 0")
        return z

    def _require_real_image(self, name: str, distance: Scalar) -> None:
        if not isinstance(distance, Tensor):
            distance = torch.tensor(number(name, distance), dtype=torch.float64, device="cpu")
        distances = distance.detach().abs()
        foclen = self._parameter("foclen", distances).detach()
        if not bool((distances > foclen).all()):
            raise ValueError(
                f"{name} must be farther than foclen={float(foclen.max()):g} mm, got "
                f"{float(distances.min()):g} mm; distances are in mm and infinity is math.inf"
            )

    def _acceptable(self, coc: Scalar) -> Tensor:
        c = self._tensor("coc", coc)
        if not bool((c >= 0).all()):
            raise ValueError(f"coc must be a diameter in mm, 0 or more, got {float(c.min())}")
        return c


def _pitch(sensor_size: tuple[float, float], sensor_res: tuple[int, int]) -> float:
    """The width of a pixel in mm; pixels must be square to within 1 %."""
    size, res = pair("sensor_size", sensor_size), pair("sensor_res", sensor_res)
    sides = {"sensor width": size[0], "sensor height": size[1]}
    sides |= {"horizontal sensor_res": res[0], "vertical sensor_res": res[1]}
    width, height, columns, rows = (positive(name, side, _SIDES) for name, side in sides.items())
    across, down = width / columns, height / rows
    if abs(down / across - 1) > 0.01:
        raise ValueError(
            f"pixels must be square, got {across:.5g} mm across and {down:.5g} mm down from "
            f"sensor_size={sensor_size} and sensor_res={sensor_res}; "
            f"use a sensor height of {across * rows:.5g} mm"
        )
    return size[0] / res[0]

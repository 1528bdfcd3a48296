"""The pinhole camera: a focal length, a sensor of square pixels, and the field of view.

Lengths are in mm, angles in radians. The image is that of the pinhole at the lens: it has no
distortion, and focusing does not change its scale.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from defocus_core.tensors.source import Scalar
from defocus_core.tensors.validation import flag, floating, number, pair, positive, whole

_SIDES = "sensor_size is (width, height) in mm, sensor_res in px"
# Where points of a grid over the image lie that do not stand in the middles of its fields.
_NEAR_BORDER = 0.98


class PinholeCamera:
    """A focal length before a sensor of square pixels.

    Attributes:
        foclen: Focal length f in mm.
        sensor_size: Sensor (width, height) in mm.
        sensor_res: Sensor (width, height) in px. A smaller image is a crop at the same pitch.
        device: Where results for plain numbers live.
        dtype: Floating-point type of results for plain numbers.
    """

    foclen: Scalar
    sensor_size: tuple[float, float]
    sensor_res: tuple[int, int]
    device: torch.device
    dtype: torch.dtype

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
        """Change the pixels of the sensor, whose diagonal in mm stays as it is.

        The sensor takes the aspect of its pixels, so that these are square.

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
        """Sensor width in mm / width in px, on both axes, whichever of them changes.

        Raises:
            ValueError: As `set_sensor`, if they make no sense any more.
        """
        return _pitch(self.sensor_size, self.sensor_res)

    @property
    def hfov(self) -> Scalar:
        """Field of view across the sensor's width, 2 atan(w / 2f), in radians."""
        return self._field_of_view(self.sensor_size[0])

    @property
    def vfov(self) -> Scalar:
        """Field of view across the sensor's height, in radians."""
        return self._field_of_view(self.sensor_size[1])

    @property
    def dfov(self) -> Scalar:
        """Field of view across the sensor's diagonal, in radians."""
        return self._field_of_view(math.hypot(*self.sensor_size))

    def point_source_grid(
        self,
        depth: float,
        grid: tuple[int, int] = (9, 9),
        normalized: bool = True,
        quater: bool = False,
        center: bool = True,
    ) -> Tensor:
        """Points at one depth, evenly spread over the image, the uppermost and leftmost first.

        Args:
            depth: z of the points in mm, negative in front of the lens.
            grid: Numbers of points (across, down).
            normalized: Whether x and y are shares of half the sensor, -1 to 1, y upwards; else they
                are mm at that depth.
            quater: Whether only the upper right quarter is wanted.
            center: Whether the outermost points lie half of a field of n - 1 within the border;
                else they lie at 0.98. A single point lies in the middle.

        Returns:
            [down, across, 3]: x, y and z.

        Raises:
            ValueError: If the grid is not of at least one point across and down.
        """
        across, down = (whole("grid", n, "it is (across, down)") for n in pair("grid", grid))
        right, top = (_outermost(n, flag("center", center)) for n in (across, down))
        z, enlarged = number("depth", depth), (1.0, 1.0)
        if not flag("normalized", normalized):
            scale = abs(z) / number("foclen", self.foclen)
            enlarged = (scale * self.sensor_size[0] / 2, scale * self.sensor_size[1] / 2)
        dtype, device = floating(self.dtype), self.device
        x = enlarged[0] * torch.linspace(-right, right, across, dtype=dtype, device=device)
        y = enlarged[1] * torch.linspace(top, -top, down, dtype=dtype, device=device)
        y, x = torch.meshgrid(y, x, indexing="ij")
        points = torch.stack([x, y, torch.full_like(x, z)], -1)
        return points[: (down + 1) // 2, across // 2 :] if flag("quater", quater) else points

    def _field_of_view(self, side: float) -> Scalar:
        half = side / 2 / self.foclen
        return 2 * (half.atan() if isinstance(half, Tensor) else math.atan(half))


def _pitch(sensor_size: tuple[float, float], sensor_res: tuple[int, int]) -> float:
    """Width of a pixel in mm, of pixels that are square to 1 %."""
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


def _outermost(count: int, center: bool) -> float:
    """Where the last of several points stands between the middle, 0, and the border, 1."""
    if count == 1:
        return 0.0
    return 1 - 0.5 / (count - 1) if center else _NEAR_BORDER

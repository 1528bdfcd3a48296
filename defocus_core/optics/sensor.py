"""A sensor of square pixels, and their pitch."""

from __future__ import annotations

from defocus_core.runtime.validation import pair, positive

_SIDES = "sensor_size is (width, height) in mm, sensor_res in px"


def pixel_size(sensor_size: tuple[float, float], sensor_res: tuple[int, int]) -> float:
    """Width of a pixel in mm, for a sensor (width, height) in mm and in px.

    Raises:
        ValueError: If a side is not positive and finite, or the pitches of the two axes differ by
            more than 1 %.
    """
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

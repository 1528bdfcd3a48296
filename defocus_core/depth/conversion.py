"""Radii from disparity of unknown scale."""

from __future__ import annotations

from torch import Tensor


def radius_from_relative_disparity(
    disparity: Tensor, focus: float, max_radius: float, reach: float | None = None
) -> Tensor:
    """Signed radius of the circle of confusion by disparity of unknown scale and offset.

    The radius of a thin lens is linear in disparity: r = R (d_f − d) / max |d_f − d|.

    Args:
        disparity: d, any shape, greater nearer; of any scale, with any offset.
        focus: d_f, what is in focus.
        max_radius: R, of the most blurred pixel, px.
        reach: max |d_f − d|; None for that of `disparity`.

    Returns:
        Radii of the same shape in px, negative nearer than the focus; 0 where all are in focus.
    """
    apart = focus - disparity
    maximum = float(apart.detach().abs().amax()) if reach is None else reach
    return apart * (max_radius / maximum if maximum else 0.0)

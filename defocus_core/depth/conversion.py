"""Planar depth from disparity, from the logarithm of depth, and from the distance to the point."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def depth_from_disparity(
    disparity: Tensor, focal_baseline: float = 1.0, offset: float = 0.0
) -> Tensor:
    """Planar depth z = f b / (d + o) of stereo disparity.

    D. Scharstein et al.: High-resolution stereo datasets with subpixel-accurate ground truth, 2014;
    o is ``doffs`` there, the difference of the two principal points.

    Args:
        disparity: Any shape, px; with the default `focal_baseline`, in 1 / length.
        focal_baseline: Focal length in px times the baseline; its unit is that of the result.
        offset: Added to the disparity, px.

    Returns:
        Depth of the same shape, inf where d + o is 0, NaN where it is negative: no point in front
        of both cameras has such a disparity. The gradient is 0 there.

    Raises:
        ValueError: If `focal_baseline` is not positive and finite.
    """
    if not 0 < focal_baseline < math.inf:
        raise ValueError(f"focal_baseline must be positive and finite, got {focal_baseline}")
    shifted = disparity + offset
    in_front = shifted > 0
    depth = focal_baseline / torch.where(in_front, shifted, torch.ones_like(shifted))
    beyond = torch.where(shifted == 0, math.inf, math.nan).to(depth.dtype)
    return torch.where(in_front, depth, beyond)


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


def depth_from_logarithm(fraction: Tensor, near: float, far: float) -> Tensor:
    """Depth near^(1 − t) far^t that is even in its logarithm.

    R. Wang et al.: MoGe, 2025 (``utils/io.py`` of its code).

    Args:
        fraction: t, any shape, 0 at `near` and 1 at `far`.
        near: Depth at 0, positive.
        far: Depth at 1, positive, in the unit of `near`.

    Returns:
        Depth of the same shape, in the unit of `near`.

    Raises:
        ValueError: If `near` or `far` is not positive and finite.
    """
    if not (0 < near < math.inf and 0 < far < math.inf):
        raise ValueError(f"near and far must be positive and finite, got {near} and {far}")
    return torch.exp(math.log(near) + fraction * (math.log(far) - math.log(near)))


def planar_depth(
    distance: Tensor,
    focal_px: float,
    *,
    first: tuple[int, int] = (0, 0),
    size: tuple[int, int] | None = None,
) -> Tensor:
    """Depth along the optical axis z = d f / √(x² + y² + f²) of the distance d to the point.

    x and y are those of pixel centres from the middle of the frame, (i − (n − 1) / 2): M. Roberts
    et al.: Hypersim, 2021 (issue 9 of its code).

    Args:
        distance: [..., h, w], a window of a frame; any unit; inf stays inf.
        focal_px: Focal length of the picture in px.
        first: Row and column of the frame that are the first of `distance`; negative beyond it.
        size: Rows and columns of the frame; None if `distance` has all of them.

    Returns:
        Planar depth [..., h, w] in the unit of `distance`.

    Raises:
        ValueError: If `focal_px` is not positive and finite.
    """
    if not 0 < focal_px < math.inf:
        raise ValueError(f"focal_px must be positive and finite, got {focal_px}")
    (rows, columns), (top, left) = distance.shape[-2:], first
    height, width = size or (rows, columns)
    y = torch.arange(top, top + rows, device=distance.device)[:, None]
    x = torch.arange(left, left + columns, device=distance.device)[None]
    x, y = x.double() - (width - 1) / 2, y.double() - (height - 1) / 2
    cosine = focal_px / torch.sqrt(x.square() + y.square() + focal_px**2)
    return distance * cosine.to(distance.dtype)

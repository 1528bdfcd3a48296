"""The disparity of a picture: how far the centroids of left and right are apart at each pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.arrays import LazyArray
from defocus_core.picture.opening import aperture_in_pixels, cat_eye_of, dual_pixel_of
from defocus_core.picture.take import Take

# Cells along an axis of the frame between whose corners a pupil that changes is interpolated: what
# a cat's eye leaves open then errs by 0.1 %, by 0.6 % where the rim begins to clip.
_CELLS = 16


def disparity_map(take: Take) -> LazyArray:
    """Px [H, W] along x between left and right of what is shown, signed like its radius."""
    beyond = nearer = _per_radius(take)
    if take.lens.spherical:
        nearer = _per_radius(take, nearer=True)
    radii = take.shown

    def read(rows: slice) -> NDArray[Any]:
        radius = radii[rows]
        far, near = (_between(corners, rows, radii.shape) for corners in (beyond, nearer))
        values: NDArray[Any] = (radius * np.where(radius < 0, near, far)).astype(radii.dtype)
        return values

    return LazyArray(radii.shape, radii.dtype, read)


def _per_radius(take: Take, *, nearer: bool = False) -> NDArray[Any]:
    """Px between left and right for a CoC radius of a px at the corners of cells of the frame.

    One number where the whole frame sees the same pupil, of points beyond focus or nearer.
    """
    import torch

    pupil, longer = aperture_in_pixels(take.lens, take.inputs.color.pixel_aspect)
    pixel, (height, width) = dual_pixel_of(take.lens), take.shown.shape
    field = pixel.field or cat_eye_of(take.lens, take.size)
    if field is None:
        return np.full((1, 1), longer * float(pixel.disparity(pupil, nearer=nearer)))
    x = torch.linspace(0, width, _CELLS + 1, dtype=torch.float64)
    of_rows = [
        pixel.disparity(pupil, nearer=nearer, view=field.view(x, y.expand(len(x)), (height, width)))
        for y in torch.linspace(0, height, _CELLS + 1, dtype=torch.float64)
    ]
    corners: NDArray[Any] = longer * torch.stack(of_rows).numpy()
    return corners


def _between(corners: NDArray[Any], rows: slice, shape: tuple[int, ...]) -> NDArray[Any]:
    """Values at the corners of cells of a frame, interpolated at the pixels of some of its rows."""
    if corners.size == 1:
        return corners
    first, last, _ = rows.indices(shape[0])
    down = np.arange(first, last) + 0.5
    across = np.arange(shape[1]) + 0.5
    values: NDArray[Any] = _tents(down, shape[0]) @ corners @ _tents(across, shape[1]).T
    return values


def _tents(at: NDArray[Any], length: int) -> NDArray[Any]:
    """Weights [n, cells + 1] of the corners along an axis at n places in px."""
    cell = at * (_CELLS / length)
    weights: NDArray[Any] = np.clip(1 - np.abs(cell[:, None] - np.arange(_CELLS + 1)), 0, None)
    return weights

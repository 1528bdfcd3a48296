"""The aperture of a lens as the optics functions need it: shape, cat's eye, dual pixels."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from defocus_core.errors import InputError, UsageProblem, reason
from defocus_core.io.read_files import once, read_head
from defocus_core.request.lens import LensValues
from defocus_core.system.text import times

if TYPE_CHECKING:
    from defocus_core.optics.aperture import Aperture
    from defocus_core.optics.cat_eye import CatEye
    from defocus_core.optics.dual_pixel import DualPixel
    from defocus_core.optics.outline import PupilImage
    from defocus_core.optics.parts import Sensitivity

_MAX_SIDE = 4096  # px; larger sums of areas lose digits
_MAX_RADIUS = 2000  # px of a drawn blur
_TANGENT = math.hypot(36, 24) / 2 / 50  # tangent of the corner's field angle, beside a blur in px
_SHOWN = 256  # px on a side of a square of the drawing


def aperture_of(lens: LensValues) -> Aperture:
    """The shape of the aperture of a lens."""
    from defocus_core.optics.aperture import Aperture

    image = None if lens.aperture_image is None else pupil_image(lens.aperture_image)
    try:
        return Aperture(
            blades=lens.blades,
            rotation=lens.blade_rotation,
            curvature=lens.blade_curvature,
            obstruction=lens.obstruction,
            spherical=lens.spherical,
            image=image,
            squeeze=lens.squeeze,
        )
    except ValueError:
        problem = f"of {lens.obstruction:g} hides all that {lens.blades} blades leave open"
        remedy = "give a smaller one, or more or rounder blades"
        raise UsageProblem("contradiction", problem, remedy, field="obstruction") from None


def cat_eye_of(lens: LensValues, size: tuple[int, int], pixel_aspect: float = 1.0) -> CatEye | None:
    """The lens barrel that clips the aperture off-axis; None if the lens has none.

    `size` is (width, height) in px; `pixel_aspect` the width of a pixel over its height.
    """
    from defocus_core.optics.cat_eye import CatEye

    if lens.cat_eye is None:
        return None
    rim, distance = lens.cat_eye
    if 0 < lens.obstruction >= rim:
        problem = "lets no light pass beside the opaque middle of the aperture"
        remedy = f"give a rim larger than {lens.obstruction:g}, or a smaller ‹obstruction›"
        raise UsageProblem("contradiction", problem, remedy, field="cat-eye")
    width, height = size
    tangent = _TANGENT
    if not lens.is_shape:
        tangent = lens.sensor_width / 2 * math.hypot(1, height / width / pixel_aspect) / lens.foclen
    try:
        return CatEye(rim, distance * tangent, lens.vignetting, pixel_aspect)
    except ValueError as error:
        maximum = 0.895 * rim / tangent  # rounding to 3 digits stays below 0.9
        problem = f"hides the middle of the aperture in the corners: {reason(error)}"
        remedy = f"give a distance of {maximum:.3g} at most with this lens"
        raise UsageProblem("malformed", problem, remedy, field="cat-eye") from None


def aperture_in_pixels(lens: LensValues, pixel_aspect: float) -> tuple[Aperture, float]:
    """The aperture of a lens as it appears in pixels that need not be square.

    `pixel_aspect` is the width of a pixel over its height. Radii of the CoC are in widths of a
    pixel, so a blur covers more px vertically if pixels are wider than high.

    Returns:
        The aperture; and the longer half axis of a blur, as a multiple of its CoC radius.
    """
    pupil = aperture_of(lens)
    if pixel_aspect == 1:
        return pupil, 1.0
    squeeze = lens.squeeze * pixel_aspect
    longer = pixel_aspect if squeeze >= 1 else 1 / lens.squeeze
    return replace(pupil, squeeze=squeeze), longer


def dual_pixel_of(lens: LensValues) -> DualPixel:
    """The model of the two photodiodes in each pixel of the sensor."""
    from defocus_core.optics.dual_pixel import DualPixel

    measured = None if lens.dp_kernels is None else measured_pair(lens.dp_kernels)
    return DualPixel(lens.dp_model, lens.dp_crosstalk, measured)


@once
def measured_pair(path: Path) -> tuple[Sensitivity, Sensitivity]:
    """The sensitivities of the left and the right photodiode, from a file of measured kernels.

    The file has an array [2, H, W], the blur of a point beyond the focus, left and right.
    """
    import torch

    from defocus_core.io.array_files import read_array
    from defocus_core.optics.parts import sensitivities

    kernels = read_array(path)
    if kernels.ndim != 3 or len(kernels) != 2 or max(kernels.shape) > _MAX_SIDE:
        problem = f"holds {times(kernels.shape)} numbers, which are not kernels of two"
        remedy = "save left and right as 2 × height × width"
        raise InputError("wrong-size", problem, remedy, path=path)
    left, right = torch.from_numpy(np.array(kernels, "float64"))
    try:
        return sensitivities(left, right)
    except ValueError as error:
        problem = f"holds no kernels of two photodiodes: {reason(error)}"
        remedy = "measure both of a point beyond the focus"
        raise InputError("malformed", problem, remedy, path=path) from None


@once
def pupil_image(path: Path) -> PupilImage:
    """The transmission of an aperture from a picture file, as the mean of its linear colours."""
    import torch

    from defocus_core.io.array_files import array_type, read_array
    from defocus_core.io.images.color import read_color
    from defocus_core.io.images.describe import describe
    from defocus_core.optics.outline import PupilImage

    if array_type(read_head(path)) == "NPY":
        mapped = read_array(path)
        light = mapped[None] if mapped.ndim == 2 else np.moveaxis(mapped, -1, 0)
        _refuse_wide(path, light.shape)
        light = np.array(light, "float64")
    else:
        header = describe(path)
        _refuse_wide(path, (len(header.parts[0].channels), header.height, header.width))
        color = read_color(path)
        light = np.stack([plane[:] for plane in color.planes], dtype="float64")
        light = light[: len(color.channels) - ("A" in color.channels)]
    try:
        return PupilImage(torch.from_numpy(light.mean(axis=0)))
    except ValueError as error:
        problem = f"is not a picture of an aperture: {reason(error)}"
        remedy = "give a picture that is bright where it is open"
        raise InputError("malformed", problem, remedy, path=path) from None


def _refuse_wide(path: Path, shape: tuple[int, ...]) -> None:
    """Raise InputError unless `shape` is [channels, H, W], with H and W at most 4096."""
    if len(shape) != 3 or max(shape[1:]) > _MAX_SIDE:
        problem = f"is not a picture of an aperture: it has {times(shape)} numbers"
        remedy = f"give one picture of {_MAX_SIDE} px a side at most"
        raise InputError("malformed", problem, remedy, path=path)


def write_aperture(path: Path, lens: LensValues, radius: float) -> None:
    """Draw the aperture and the blur of a point, through the whole lens and each half, as PNG.

    `radius` is the signed radius of the blur in px. An EXR gets the three blurs only, as kernels.
    """
    import torch

    from defocus_core.io.exr.writing import write_exr
    from defocus_core.io.images.color_space import linear_to_srgb, quantised
    from defocus_core.io.images.encode import write_samples

    if path.suffix.lower() not in (".png", ".exr"):
        remedy = "end its name in .png or .exr"
        raise InputError("malformed", "is neither PNG nor EXR", remedy, path=path)
    if abs(radius) > _MAX_RADIUS:
        remedy = "give a smaller one"
        raise UsageProblem("out-of-range", f"is beyond {_MAX_RADIUS} px", remedy, field="radius")
    pupil = aperture_of(lens)
    r = torch.tensor(radius, dtype=torch.float64)
    pixel = dual_pixel_of(lens)
    kernels = pixel.kernels(pupil, r, 2 * math.ceil(abs(radius)) + 1).numpy()
    if path.suffix.lower() == ".exr":
        names = ("kernel", "left", "right")
        write_exr(path, dict(zip(names, kernels.astype("float32"), strict=True)), {})
        return
    opening = pupil.kernel(torch.tensor(_SHOWN / 2.0, dtype=torch.float64), _SHOWN).numpy()
    squares = []
    for light in (opening, *kernels):
        cells = np.arange(_SHOWN) * len(light) // _SHOWN
        squares.append(light[np.ix_(cells, cells)] / light.max())
    shown = linear_to_srgb(np.concatenate(squares, axis=1).astype("float32"))
    write_samples(path, quantised(shown[..., None], 8), "png", {})

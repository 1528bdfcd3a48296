"""Find the lens that relates a sharp picture to a defocused photograph of the same scene."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.errors import InputError, NotExplained
from defocus_core.io.images.color import Color, read_color, require_finite
from defocus_core.io.write_files import written_whole
from defocus_core.picture.pair import read
from defocus_core.picture.take import InputPair, radius_measures
from defocus_core.request.job import PictureFiles, Reading
from defocus_core.request.quantities import length_text
from defocus_core.system.process import cores, set_to_render

if TYPE_CHECKING:
    import torch

    from defocus_core.fitting.pair import Fit
    from defocus_core.optics.dual_pixel import DualPixel

_MM_PER_M = 1000.0
_EXPLAINED = 1 / 3  # least share of the difference of pictures that their lens explains
_MIN_BLUR = 1.5  # px of radius, below which strength and focus are uncertain


@dataclass(frozen=True)
class FitOptions:
    """Known parameters of the lens, and what to estimate besides focus and f-number."""

    foclen: float  # focal length in mm
    sensor_width: float  # in mm
    exposure: bool = False  # whether the pictures may differ by gains and falloff of light
    shift: bool = False  # whether the pictures may be shifted
    dual_pixel: bool = False  # whether to find the crosstalk of a pair
    # the model of the photodiodes, or the file of their kernels; None is smooth if crosstalk is to
    # be found, else ideal halves
    dp_model: str | Path | None = None


def fit_files(
    picture: PictureFiles,
    blurred: tuple[Path, ...],
    reading: Reading,
    options: FitOptions,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Find focus and f-number of the lens that blurred a picture; returns a record for JSON.

    `picture` is sharp and has depth; `blurred` is the blurred picture, or its left and its right
    dual-pixel view. `progress` is called with the numbers of renderings done and expected.
    """
    import torch

    from defocus_core.fitting.pair import fit

    set_to_render()
    focal = options.foclen / options.sensor_width if reading.needs_lens else None
    color, depth = read(InputPair(picture, reading, lens_focal=focal))
    if depth.is_radius:
        problem = "holds radii: there is no lens to be found"
        raise InputError("radii", problem, "give depth", path=depth.path)
    sharp, *observed = light_of(color), *(light_of(read_color(path), color) for path in blurred)
    count = min(map(len, (sharp, *observed)))
    disparity = 1 / torch.from_numpy(depth.metres[:].astype("float32"))
    try:
        found = fit(
            sharp[:count],
            disparity,
            tuple(each[:count] for each in observed),
            dual_pixel=_photodiodes(options),
            crosstalk=options.dual_pixel,
            exposure=options.exposure,
            shift=options.shift,
            depth_repair=reading.depth_repair,
            edge_width=reading.edge_width,
            threads=cores(),
            progress=progress,
        )
    except ValueError as error:
        problem, _, remedy = str(error).partition("; ")
        remedy = remedy or "give another pair"
        raise InputError("not-explained", problem, remedy, path=blurred[0]) from None
    if found.explained < _EXPLAINED:
        problem = f"a blur explains {max(found.explained, 0):.0%} of what the pictures differ by"
        remedy = "give a pair of one scene and one curve, and see ‹exposure› and ‹shift›"
        raise NotExplained("not-explained", problem, remedy, path=blurred[0])
    if found.focus * options.foclen >= _MM_PER_M:
        where, far = length_text(_MM_PER_M / found.focus), length_text(options.foclen)
        problem = f"the focus that was found, {where}, is not beyond the focal length {far}"
        remedy = "give a shorter ‹focal-length›, or a ‹depth-range› that lies farther away"
        raise InputError("focus-too-near", problem, remedy, path=blurred[0])
    radius = (found.strength * (found.focus - disparity)).numpy()
    record = {"picture": str(picture.color)} | _record(found, options, color.shape[1])
    doubts = ["left and right are exchanged"] if found.exchanged else []
    if np.abs(radius).max() < _MIN_BLUR:
        doubts.append("hardly anything is blurred")
    return record | radius_measures(radius, None) | {"doubts": doubts}


def _record(found: Fit, options: FitOptions, width: int) -> dict[str, Any]:
    """The result of a fit as a dictionary for JSON; `width` is that of the picture in px."""
    from defocus_core.optics.thin_lens import fnum_of_strength

    pitch = options.sensor_width / width
    strength, focus = found.strength * _MM_PER_M, found.focus / _MM_PER_M
    record: dict[str, Any] = {
        "focus_m": None if found.focus <= 0 else 1 / found.focus,
        "focus_dioptres": found.focus,
        "focus_error_dioptres": _finite(found.focus_error),
        "fnumber": fnum_of_strength(strength, focus, options.foclen, pitch),
        "fnumber_error": _finite(found.strength_error),
        "px_per_dioptre": found.strength,
        "focal_length_mm": options.foclen,
        "sensor_width_mm": options.sensor_width,
        "shift_px": list(found.shift),
        "magnification": found.magnification,
        "gains": list(found.gains),
        "explained": found.explained,
        "psnr": found.psnr,
    }
    if (sensor := found.dual_pixel) is not None:
        kernels = options.dp_model if isinstance(options.dp_model, Path) else None
        record |= {
            "dp_model": sensor.model if kernels is None else str(kernels.absolute()),
            "dp_crosstalk": float(sensor.crosstalk),
            "dp_crosstalk_error": _finite(found.crosstalk_error),
            "left_is_right": found.exchanged,
        }
    return record


def _photodiodes(options: FitOptions) -> DualPixel:
    from defocus_core.optics.dual_pixel import DualPixel
    from defocus_core.picture.opening import measured_pair

    if isinstance(options.dp_model, Path):
        return DualPixel(measured=measured_pair(options.dp_model))
    return DualPixel(options.dp_model or ("smooth" if options.dual_pixel else "split"))


def light_of(color: Color, like: Color | None = None) -> torch.Tensor:
    """The linear light of a picture without alpha, [C, H, W].

    With `like`, pixels must be finite, and the picture must have the same size as `like`.
    """
    import torch

    if like is not None:
        require_finite(color)
        if color.shape[:2] != like.shape[:2]:
            (height, width), (wide, high) = like.shape[:2], color.size
            problem = f"is {wide}x{high} px but {like.path} is {width}x{height} px"
            remedy = "give pictures of one size"
            raise InputError("wrong-size", problem, remedy, path=color.path)
    return torch.from_numpy(np.stack([plane[:] for plane in color.light]).astype(np.float32))


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def write_lens(path: Path, found: dict[str, Any]) -> None:
    """Write the lens in a record of `fit_files` as a lens file."""
    focus = found["focus_m"]
    lines = [
        "# Found by 'defocus fit'.",
        f'focal-length = "{length_text(found["focal_length_mm"], 9)}"',
        f'sensor-width = "{length_text(found["sensor_width_mm"], 9)}"',
        f"fnumber = {found['fnumber']:.6g}",
        f'focus = "{"inf" if focus is None else length_text(focus * _MM_PER_M, 7)}"',
    ]
    if found.get("dp_model", "split") != "split":
        lines.append(f"dp-model = {json.dumps(found['dp_model'])}")
    if found.get("dp_crosstalk"):
        lines.append(f"dp-crosstalk = {found['dp_crosstalk']:.4g}")
    with written_whole(path) as file:
        file.write(("\n".join(lines) + "\n").encode())


def words(found: dict[str, Any]) -> list[str]:
    """The record of `fit_files` as lines of text."""
    distance = "infinity" if found["focus_m"] is None else f"{found['focus_m']:.4g} m"
    focus_error, error = found["focus_error_dioptres"], found["fnumber_error"]
    of_focus = "unknown" if focus_error is None else f"{focus_error:.2g} 1/m"
    of_number = "unknown" if error is None else f"{error:.2%}"
    (across, down), gains = found["shift_px"], ", ".join(f"{gain:.4g}" for gain in found["gains"])
    lines = [
        f"focus {distance} ({found['focus_dioptres']:.4g} 1/m, standard error {of_focus})",
        f"f-number {found['fnumber']:.4g} (standard error {of_number}) for "
        f"{found['focal_length_mm']:g}mm and a sensor of {found['sensor_width_mm']:g}mm: "
        f"{found['px_per_dioptre']:.4g} px of radius for 1/m",
        f"residual {found['psnr']:.1f} dB, {found['explained']:.0%} explained by the blur",
        f"magnified {found['magnification']:.5f} times, {across:.2f} px to the right, "
        f"{down:.2f} px down; gains {gains}",
    ]
    if "dp_model" in found:
        lines.append(f"photodiodes {found['dp_model']}, crosstalk {found['dp_crosstalk']:.3f}")
    return lines + [f"not sure: {doubt}" for doubt in found["doubts"]]

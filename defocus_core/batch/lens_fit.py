"""The lens of a real pair: files in, a lens file and a record out."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.allowed_values import DUAL_PIXEL_MODELS
from defocus_core.errors import InputError
from defocus_core.io.arrays import sample_plane
from defocus_core.io.images.color import Color, read_color, require_finite
from defocus_core.io.safe_files import written_whole
from defocus_core.picture.pair import read
from defocus_core.picture.take import InputPair, radius_measures
from defocus_core.request.job import Picture, Reading
from defocus_core.request.quantities import length_text
from defocus_core.system.process import cores, set_to_render

if TYPE_CHECKING:
    import torch

    from defocus_core.fitting.pair import Fit
    from defocus_core.optics.dual_pixel import DualPixel

_MM_PER_M = 1000.0


@dataclass(frozen=True)
class Pair:
    """A sharp picture with its depth, and what it looks like blurred; right of a dual pixel."""

    picture: Picture
    blurred: Path
    right: Path | None = None


@dataclass(frozen=True)
class FitOptions:
    """What is known of the lens, and what is to be found besides focus and f-number."""

    foclen: float  # focal length in mm
    sensor_width: float  # in mm
    blades: tuple[int, ...] = (0,)  # numbers of blades to choose from; their rotation is found, too
    exposure: bool = False  # whether the pictures may differ by a factor for each channel
    gamma: bool = False  # whether the power is to be found by which the files are linear light
    shift: bool = False  # whether the pictures may lie apart by a few px
    dual_pixel: bool = False  # whether the crosstalk of a pair is to be found, and its model
    # Whether left and right may have a factor each, a plane over the frame
    side_shading: bool = False
    focus: float | None = None  # the distance in focus in mm, if it is known
    fnumber: float | None = None  # the f-number, if it is known
    # The model of the photodiodes, or the file of their kernels, if it is known
    dp_model: str | Path | None = None
    dp_crosstalk: float | None = None  # their crosstalk, if it is known

    def strength(self, focus: float, width: int) -> float:
        """Px of radius for 1/m, of a focus in 1/m and the f-number that is known."""
        assert self.fnumber is not None
        focus = min(focus, (1 - 1e-6) * _MM_PER_M / self.foclen)  # where a search may try others
        return self.counterpart(self.fnumber, focus, width) / _MM_PER_M

    def counterpart(self, number: float, focus: float, width: int) -> float:
        """The f-number of px of radius for 1/mm, or the reverse, of a focus in 1/m."""
        from defocus_core.optics.thin_lens import fnum_of_strength

        pitch = self.sensor_width / width
        return fnum_of_strength(number, focus / _MM_PER_M, self.foclen, pitch)


def _photodiodes(options: FitOptions) -> list[DualPixel]:
    from defocus_core.optics.dual_pixel import DualPixel
    from defocus_core.picture.opening import measured_pair

    fraction = options.dp_crosstalk or 0.0
    if isinstance(options.dp_model, Path):
        return [DualPixel(crosstalk=fraction, measured=measured_pair(options.dp_model))]
    sought = options.dual_pixel and options.dp_model is None
    models = DUAL_PIXEL_MODELS if sought else (options.dp_model or DUAL_PIXEL_MODELS[0],)
    return [DualPixel(model, fraction) for model in models]


def fit_pair(
    pair: Pair,
    reading: Reading,
    options: FitOptions,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """The record of the lens of a pair, in plain values."""
    import torch

    from defocus_core.fitting.pair import fit
    from defocus_core.optics.aperture import Aperture

    set_to_render()
    focal = options.foclen / options.sensor_width if reading.needs_lens else None
    color, depth = read(InputPair(pair.picture, reading, lens_focal=focal))
    if depth.is_radius:
        raise InputError(
            "radii", "holds radii: there is no lens to be found", "give depth", path=depth.path
        )
    observed = [_read_beside(color, path) for path in filter(None, (pair.blurred, pair.right))]
    sharp = _light(color)
    count = min(len(each) for each in (sharp, *observed))
    disparity = 1 / torch.from_numpy(depth.metres[:].astype("float32"))
    try:
        fitted = fit(
            sharp[:count],
            disparity,
            tuple(each[:count] for each in observed),
            apertures=[Aperture(blades) for blades in options.blades],
            rotation=True,
            dual_pixels=_photodiodes(options),
            crosstalk=options.dual_pixel and options.dp_crosstalk is None,
            focus=None if options.focus is None else _MM_PER_M / options.focus,
            strength=partial(options.strength, width=color.shape[1]) if options.fnumber else None,
            exposure=options.exposure,
            side_shading=options.side_shading,
            gamma=options.gamma,
            shift=options.shift,
            depth_repair=reading.depth_repair,
            edge_width=reading.edge_width,
            threads=cores(),
            progress=progress,
        )
    except ValueError as error:
        problem, _, remedy = str(error).partition("; ")
        raise InputError(
            "not-explained", problem, remedy or "give another pair", path=pair.blurred
        ) from None
    if fitted.focus * options.foclen >= _MM_PER_M:
        where, far = length_text(_MM_PER_M / fitted.focus), length_text(options.foclen)
        problem = f"the focus that was found, {where}, is not beyond the focal length {far}"
        remedy = "give a shorter ‹focal-length›, or a ‹depth-range› that lies farther away"
        raise InputError("focus-too-near", problem, remedy, path=pair.blurred)
    radius = sample_plane((fitted.strength * (fitted.focus - disparity)).numpy())
    return {
        "picture": str(pair.picture.color),
        **_record(fitted, options, color.shape[1]),
        **radius_measures(radius, None if depth.empty is None else sample_plane(depth.empty)),
    }


def _read_beside(color: Color, path: Path) -> torch.Tensor:
    """The light of a picture of the size of another."""
    other = read_color(path)
    require_finite(other)
    if other.shape[:2] != color.shape[:2]:
        (height, width), (wide, high) = color.shape[:2], other.size
        problem = f"is {wide}x{high} px but {color.path} is {width}x{height} px"
        raise InputError("wrong-size", problem, "give pictures of one size", path=path)
    return _light(other)


def _light(color: Color) -> torch.Tensor:
    """Linear light [C, H, W] without alpha."""
    import torch

    return torch.from_numpy(np.stack([plane[:] for plane in color.light]).astype(np.float32))


def _record(fitted: Fit, options: FitOptions, width: int) -> dict[str, Any]:
    """Focus, f-number and whatever else a fit found."""
    blades = fitted.aperture.blades
    return {
        "focus_m": None if fitted.focus <= 0 else 1 / fitted.focus,
        "focus_dioptres": fitted.focus,
        "focus_error_dioptres": _finite(fitted.focus_error),
        "fnumber": options.counterpart(fitted.strength * _MM_PER_M, fitted.focus, width),
        "fnumber_error": _finite(fitted.strength_error),
        "px_per_dioptre": fitted.strength,
        "focal_length_mm": options.foclen,
        "sensor_width_mm": options.sensor_width,
        "blades": blades,
        # The least angle of a vertex that is not negative
        "blade_rotation_deg": fitted.aperture.rotation % (360 / blades) if blades else 0.0,
        "gamma": fitted.gamma,
        "gamma_error": _finite(fitted.gamma_error),
        "shift_px": list(fitted.shift),
        "magnification": fitted.magnification,
        "gains": list(fitted.gains),
        **_sensor_record(fitted, options),
        "explained": fitted.explained,
        "psnr": dict(zip(("all", "edges", "elsewhere"), map(_finite, fitted.psnr), strict=True)),
        "doubts": list(fitted.doubts),
        "refusals": [refusal._asdict() for refusal in fitted.refusals],
    }


def _sensor_record(fitted: Fit, options: FitOptions) -> dict[str, Any]:
    """The photodiodes of a pair; empty of one picture."""
    sensor = fitted.dual_pixel
    if sensor is None:
        return {}
    kernels = options.dp_model if isinstance(options.dp_model, Path) else None
    return {
        "dp_model": sensor.model if kernels is None else str(kernels.absolute()),
        "dp_crosstalk": float(sensor.crosstalk),
        "dp_crosstalk_error": _finite(fitted.crosstalk_error),
        "left_is_right": fitted.exchanged,
        "side_shading": [list(plane) for plane in fitted.shading],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def write_lens(path: Path, found: dict[str, Any]) -> None:
    """Write what was found as a lens file."""
    focus = found["focus_m"]
    lines = [
        "# Found by 'defocus fit'.",
        f'focal-length = "{length_text(found["focal_length_mm"], 9)}"',
        f'sensor-width = "{length_text(found["sensor_width_mm"], 9)}"',
        f"fnumber = {found['fnumber']:.6g}",
        f'focus = "{"inf" if focus is None else length_text(focus * _MM_PER_M, 7)}"',
    ]
    if found["blades"]:
        lines.append(f"blades = {found['blades']}")
        lines.append(f"blade-rotation = {found['blade_rotation_deg']:.4g}")
    if found.get("dp_model", "split") != "split":
        lines.append(f"dp-model = {json.dumps(found['dp_model'])}")
    if found.get("dp_crosstalk"):
        lines.append(f"dp-crosstalk = {found['dp_crosstalk']:.4g}")
    with written_whole(path) as file:
        file.write(("\n".join(lines) + "\n").encode())


def _error(value: float | None, times: float = 1, unit: str = "") -> str:
    """The standard error of a number, after it; nothing if the number was given."""
    if value == 0:
        return ""
    return ", error unknown" if value is None else f" ± {float(f'{times * value:.2g}'):g}{unit}"


def words(found: dict[str, Any]) -> list[str]:
    """What was found, a line each."""
    focus, error = found["focus_dioptres"], found["focus_error_dioptres"]
    distance = "infinity" if found["focus_m"] is None else f"{found['focus_m']:.4g} m"
    psnr = found["psnr"]
    shown = ", ".join(f"{name} {db:.1f} dB" for name, db in psnr.items() if db is not None)
    lines = [
        f"focus {distance} ({focus:.4g}{_error(error)} 1/m)",
        f"f-number {found['fnumber']:.4g}{_error(found['fnumber_error'], 100, ' %')} for "
        f"{found['focal_length_mm']:g}mm and a sensor of {found['sensor_width_mm']:g}mm: "
        f"{found['px_per_dioptre']:.4g} px of radius for 1/m",
        f"residual: {shown}",
    ]
    if found["blades"]:
        lines.append(f"{found['blades']} blades turned {found['blade_rotation_deg']:.3g} degrees")
    if found["gamma"] != 1:
        error = _error(found["gamma_error"], 100, " %")
        lines.append(f"gamma {found['gamma']:.3f}{error}: light is what is read to it")
    if any(found["shift_px"]):
        across, down = found["shift_px"]
        lines.append(
            f"blurred picture {across:.2f} px to the right, {down:.2f} px down, "
            f"magnified {found['magnification']:.5f} times"
        )
    if "dp_model" in found:
        crosstalk, error = found["dp_crosstalk"], _error(found["dp_crosstalk_error"])
        of_model = crosstalk == 0 and not error  # what the model is known to have
        lines.append(
            f"photodiodes {found['dp_model']}"
            + ("" if of_model else f", crosstalk {crosstalk:.3f}{error}")
        )
    for side, (middle, across, down) in zip(
        ("left", "right"), found.get("side_shading", ()), strict=False
    ):
        lines.append(
            f"shading of {side}: {middle:.3f}, {across:+.3f} to the right, {down:+.3f} downwards"
        )
    if any(gain != 1 for gain in found["gains"]):
        lines.append("exposure: factors " + ", ".join(f"{gain:.4g}" for gain in found["gains"]))
    return [*lines, *(f"not sure: {doubt}" for doubt in found["doubts"])]


def pairs_of(pictures: Sequence[Picture], blurred: Path, right: Path | None) -> list[Pair]:
    """The pairs of pictures and their blurred files; those of a folder by their stems."""
    return [Pair(p, _partner(p, blurred), right and _partner(p, right)) for p in pictures]


def _partner(picture: Picture, place: Path) -> Path:
    if not place.is_dir():
        return place
    matches = sorted(path for path in place.iterdir() if path.stem == picture.stem)
    if len(matches) != 1:
        problem = f"holds {len(matches)} files named {picture.stem}"
        raise InputError(
            "ambiguous", problem, "name blurred pictures as the sharp ones", path=place
        )
    return matches[0]

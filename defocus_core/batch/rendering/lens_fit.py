"""The lens of a real pair: files in, a lens file and a record out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.batch.elements.reading import read
from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.batch.lenses.quantities import length_text
from defocus_core.batch.rendering.measures import radius_measures
from defocus_core.errors import InputError
from defocus_core.io.arrays import evenly
from defocus_core.io.images.color import read_color, require_finite
from defocus_core.io.images.color_planes import Color
from defocus_core.io.safe_files import written_whole

if TYPE_CHECKING:
    import torch

    from defocus_core.fitting.pair import Fit
    from defocus_core.optics.aperture import Aperture as Pupil

_MM_PER_M = 1000.0


@dataclass(frozen=True)
class Pair:
    """A sharp picture with its depth, and what it looks like blurred; right of a dual pixel."""

    picture: Picture
    blurred: Path
    right: Path | None = None


@dataclass(frozen=True)
class FitOptions:
    """What is known of the lens, and what is to be found besides focus and f-number.

    Attributes:
        foclen: focal length in mm.
        sensor_width: in mm.
        blades: numbers of blades to choose from; their rotation is found, too.
        exposure: whether the pictures may differ by a factor for each channel.
        gamma: whether the power is to be found by which the files are linear light.
        shift: whether the pictures may lie apart by a few px.
    """

    foclen: float
    sensor_width: float
    blades: tuple[int, ...] = (0,)
    exposure: bool = False
    gamma: bool = False
    shift: bool = False


def fit_pair(
    pair: Pair,
    reading: Reading,
    options: FitOptions,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """The record of the lens of a pair, in plain values.

    Args:
        pair: the files.
        reading: how the depth is read.
        options: what is known.
        progress: called with (renderings done, about how many in all).

    Raises:
        InputError: a file cannot be read, or the pictures do not belong together.
    """
    import torch

    from defocus_core.fitting.pair import fit
    from defocus_core.optics.aperture import Aperture

    focal = options.foclen / options.sensor_width if reading.needs_lens else None
    color, depth = read(pair.picture, reading, lens_focal=focal)
    if depth.is_radius:
        raise InputError(
            "radii", "holds radii: there is no lens to be found", "give depth", path=depth.path
        )
    seen = []
    for path in filter(None, (pair.blurred, pair.right)):
        other = read_color(path)
        require_finite(other)
        if other.shape[:2] != color.shape[:2]:
            (height, width), (wide, high) = color.shape[:2], other.size
            problem = f"is {wide}x{high} px but {color.path} is {width}x{height} px"
            raise InputError("wrong-size", problem, "give pictures of one size", path=path)
        seen.append(_light(other))
    sharp = _light(color)
    count = min(len(each) for each in (sharp, *seen))
    disparity = 1 / torch.from_numpy(depth.metres[:].astype("float32"))
    try:
        found = fit(
            sharp[:count],
            disparity,
            seen[0][:count] if len(seen) == 1 else (seen[0][:count], seen[1][:count]),
            apertures=[Aperture(blades) for blades in options.blades],
            rotation=True,
            exposure=options.exposure,
            gamma=options.gamma,
            shift=options.shift,
            depth_repair=reading.depth_repair,
            edge_width=reading.edge_width,
            progress=progress,
        )
    except ValueError as error:
        problem, _, remedy = str(error).partition("; ")
        raise InputError(
            "wrong-size", problem, remedy or "give another pair", path=pair.blurred
        ) from None
    radius = evenly((found.strength * (found.focus - disparity)).numpy())
    return {
        "picture": str(pair.picture.color),
        **_record(found, options, color.shape[1]),
        **radius_measures(radius, None if depth.nothing is None else evenly(depth.nothing)),
    }


def _light(color: Color) -> torch.Tensor:
    """Linear light [C, H, W] without alpha."""
    import torch

    return torch.from_numpy(np.stack([plane[:] for plane in color.light]).astype(np.float32))


def _record(found: Fit, options: FitOptions, width: int) -> dict[str, Any]:
    """Focus and f-number of a fit, by r = f² / (2 p N (1 - f / s)) · (1/s - 1/z) (`thin_lens`)."""
    pitch = options.sensor_width / width
    strength = found.strength * _MM_PER_M  # px for a disparity of 1 per mm
    focus = found.focus / _MM_PER_M  # per mm
    shape = max(1 - options.foclen * focus, 1e-6)
    return {
        "focus_m": None if found.focus <= 0 else 1 / found.focus,
        "focus_dioptres": found.focus,
        "focus_error_dioptres": _finite(found.focus_error),
        "fnumber": options.foclen**2 / (2 * pitch * strength * shape),
        "fnumber_error": _finite(found.strength_error),
        "px_per_dioptre": found.strength,
        "focal_length_mm": options.foclen,
        "sensor_width_mm": options.sensor_width,
        "blades": found.aperture.blades,
        "blade_rotation_deg": _rotation(found.aperture),
        "gamma": found.gamma,
        "gamma_error": _finite(found.gamma_error),
        "shift_px": list(found.shift),
        "gains": list(found.gains),
        "psnr": dict(zip(("all", "edges", "elsewhere"), map(_finite, found.psnr), strict=True)),
        "doubts": list(found.doubts),
    }


def _rotation(aperture: Pupil) -> float:
    """The angle of a vertex in degrees, the least that is not negative."""
    return aperture.rotation % (360 / aperture.blades) if aperture.blades else 0.0


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def write_lens(path: Path, record: dict[str, Any]) -> None:
    """Write what was found as a lens file.

    Raises:
        InputError: the file cannot be written.
    """
    focus = record["focus_m"]
    lines = [
        "# Found by 'defocus fit'.",
        f'focal-length = "{length_text(record["focal_length_mm"], 9)}"',
        f'sensor-width = "{length_text(record["sensor_width_mm"], 9)}"',
        f"fnumber = {record['fnumber']:.6g}",
        f'focus = "{"inf" if focus is None else length_text(focus * _MM_PER_M, 7)}"',
    ]
    if record["blades"]:
        lines.append(f"blades = {record['blades']}")
        lines.append(f"blade-rotation = {record['blade_rotation_deg']:.4g}")
    with written_whole(path) as file:
        file.write(("\n".join(lines) + "\n").encode())


def _error(value: float | None, times: float = 1) -> str:
    return "?" if value is None else f"{times * value:.2g}"


def words(record: dict[str, Any]) -> list[str]:
    """What was found, a line each."""
    focus, error = record["focus_dioptres"], record["focus_error_dioptres"]
    distance = "infinity" if record["focus_m"] is None else f"{record['focus_m']:.4g} m"
    psnr = record["psnr"]
    shown = ", ".join(f"{name} {db:.1f} dB" for name, db in psnr.items() if db is not None)
    lines = [
        f"focus {distance} ({focus:.4g} ± {_error(error)} 1/m)",
        f"f-number {record['fnumber']:.4g} ± {_error(record['fnumber_error'], 100)} % for "
        f"{record['focal_length_mm']:g}mm and a sensor of {record['sensor_width_mm']:g}mm: "
        f"{record['px_per_dioptre']:.4g} px of radius for 1/m",
        f"residual: {shown}",
    ]
    if record["blades"]:
        lines.append(f"{record['blades']} blades turned {record['blade_rotation_deg']:.3g} degrees")
    if record["gamma"] != 1:
        error = _error(record["gamma_error"], 100)
        lines.append(f"gamma {record['gamma']:.3f} ± {error} %: light is what is read to it")
    if any(record["shift_px"]):
        across, down = record["shift_px"]
        lines.append(f"blurred picture {across:.2f} px to the right, {down:.2f} px down")
    if any(gain != 1 for gain in record["gains"]):
        lines.append("exposure: factors " + ", ".join(f"{gain:.4g}" for gain in record["gains"]))
    return [*lines, *(f"not sure: {doubt}" for doubt in record["doubts"])]


def pairs_of(pictures: Sequence[Picture], blurred: Path, right: Path | None) -> list[Pair]:
    """The pairs of pictures and their blurred files; those of a folder by their stems.

    Raises:
        InputError: a picture has no blurred file.
    """
    return [Pair(p, _partner(p, blurred), right and _partner(p, right)) for p in pictures]


def _partner(picture: Picture, place: Path) -> Path:
    if not place.is_dir():
        return place
    found = sorted(path for path in place.iterdir() if path.stem == picture.stem)
    if len(found) != 1:
        problem = f"holds {len(found)} files named {picture.stem}"
        raise InputError(
            "ambiguous", problem, "name blurred pictures as the sharp ones", path=place
        )
    return found[0]

"""The lens that gives a picture the radii of another set: files in, a record out."""

from __future__ import annotations

from typing import Any

from defocus_core.batch.depth.matching import matched
from defocus_core.batch.depth.radii import MM_PER_M, signed_radius
from defocus_core.batch.elements.reading import read
from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.batch.jobs.random_lenses import Sampling
from defocus_core.batch.lenses.lens import Lens
from defocus_core.batch.lenses.radius_set import MEASURES
from defocus_core.batch.rendering.measures import radius_measures
from defocus_core.errors import InputError
from defocus_core.io.arrays import evenly


def match_picture(
    picture: Picture, reading: Reading, foclen: float, sensor_width: float, sampling: Sampling
) -> dict[str, Any]:
    """The record of a lens for a picture whose radii are those of a rank of a set.

    Args:
        picture: the files.
        reading: how the depth is read.
        foclen: focal length in mm.
        sensor_width: in mm.
        sampling: the set, and the seed.

    Raises:
        InputError: a file cannot be read.
    """
    focal = foclen / sensor_width if reading.needs_lens else None
    _, depth = read(picture, reading, lens_focal=focal)
    if depth.is_radius:
        raise InputError(
            "radii", "holds radii: there is no lens to be found", "give depth", path=depth.path
        )
    asked = sampling.radii(picture.stem, 0)
    lens = Lens(foclen, float("nan"), None, sensor_width=sensor_width, radii_px=asked)
    lens = matched(lens, depth)
    assert lens.foc_dist is not None
    assert asked is not None
    nothing = None if depth.nothing is None else evenly(depth.nothing)
    radii = radius_measures(signed_radius(lens, evenly(depth.metres), depth.size), nothing)
    focus = lens.foc_dist / MM_PER_M
    return {
        "picture": str(picture.color),
        "focus_m": None if focus == float("inf") else focus,
        "focus_dioptres": 1 / focus,
        "fnumber": lens.fnum,
        "focal_length_mm": foclen,
        "sensor_width_mm": sensor_width,
        "blades": 0,
        "asked": dict(zip(MEASURES, asked, strict=True)),
        **radii,
    }


def match_words(record: dict[str, Any]) -> list[str]:
    """The lens found, a line each."""
    distance = "infinity" if record["focus_m"] is None else f"{record['focus_m']:.4g} m"
    names = zip(MEASURES, ("mean", "median", "99th percentile"), strict=True)
    radii = (f"{name} {record[key]:.3g} for {record['asked'][key]:.3g}" for key, name in names)
    return [
        f"focus {distance}, f-number {record['fnumber']:.4g} for {record['focal_length_mm']:g}mm "
        f"and a sensor of {record['sensor_width_mm']:g}mm",
        f"radii in px, and those asked for: {', '.join(radii)}",
    ]

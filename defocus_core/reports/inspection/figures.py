"""Figures of the colour and the depth of a file, as ``defocus info`` tells them."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.batch.jobs.job import Reading
from defocus_core.batch.lenses.lens import Lens, lens_record
from defocus_core.errors import InputError
from defocus_core.io.arrays import Keeping, bands
from defocus_core.io.depth_formats.depth import Depth, read_depth
from defocus_core.io.exr.windows import Overscan
from defocus_core.io.images.color import LARGEST_FLOAT, Color, count_beyond, read_color
from defocus_core.picture.radii import radii_of, signed_radius
from defocus_core.picture.repair_words import repair_record, repair_words
from defocus_core.picture.steps.alpha import element_depth
from defocus_core.picture.steps.focusing import with_blur_reach, with_focus
from defocus_core.picture.steps.implausible import of_radii

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair


def read_picture(path: Path, reading: Reading, keeping: Keeping, overscan: Overscan) -> Color:
    """The colour of a file."""
    return read_color(
        path,
        layer=reading.color_layer,
        part=reading.part,
        view=reading.view,
        keeping=keeping,
        overscan=overscan,
        original=True,
        carried=False,
    )


def color_figures(color: Color) -> dict[str, Any]:
    """Its channels, the pixels that are not finite, and those that alpha leaves out, in part too.

    Pixels beyond the picture shown count.
    """
    nonfinite, _ = count_beyond(color, LARGEST_FLOAT)
    record = {"channels": list(color.channels), "nonfinite_pixels": nonfinite}
    if color.alpha is not None:
        strips = [np.asarray(color.alpha[rows]) for rows in bands(color.shape)]
        record["nothing_pixels"] = sum(int(np.count_nonzero(strip == 0)) for strip in strips)
        within = ((strip > 0) & (strip < 1) for strip in strips)
        record["partial_pixels"] = sum(int(np.count_nonzero(strip)) for strip in within)
    return record


def depth_figures(
    path: Path, reading: Reading, keeping: Keeping, lens: Lens | None, color: Color | None
) -> tuple[str, dict[str, Any]]:
    """How the depth would be read, and its figures; ranges are None without valid pixels.

    `lens`: what to say the blur of; None for none; `color`: the colour of the same file; None if it
    has none.
    """
    depth = _read(path, reading, keeping, lens, color)
    height, width = depth.metres.shape
    sky = valid = nothing = 0
    limits: list[float] = []  # of valid depth, sky included
    finite_ends: list[float] = []
    for rows in bands((height, width)):
        usable = depth.valid(rows)
        if depth.empty is not None:
            usable = usable & ~depth.empty[rows]
            nothing += int(np.count_nonzero(depth.empty[rows]))
        metres = depth.metres[rows][usable]
        finite = metres[np.isfinite(metres)]
        sky, valid = sky + metres.size - finite.size, valid + metres.size
        limits += ends_of(metres)
        finite_ends += ends_of(finite)
    invalid = height * width - valid - nothing
    coc_px, repair = None, None
    warnings: tuple[str, ...] = ()
    if lens is not None and limits:
        lens = with_blur_reach(with_focus(lens, depth), (depth,))
        # The radius grows with depth all the way: the extreme depths have the extreme radii.
        extremes = np.array([min(limits), max(limits)], np.float32)
        coc_px = _ends_px(lens, extremes, depth, keeping)
        if not invalid:
            repair, warnings = _repair(depth, lens, reading, keeping)
    reach = [min(finite_ends), max(finite_ends)] if finite_ends else None
    return depth.note, {
        "range_m": None if depth.is_radius else reach,
        "range": reach if depth.is_radius else None,
        "sky_pixels": sky,
        "invalid_pixels": invalid,
        "nothing_pixels": nothing,
        "lens": lens_record(lens) if lens else None,
        "coc_px": coc_px,
        "repair": repair_words(repair),
        "depth_repair": repair_record(repair),
        "warnings": list(warnings),
    }


def _read(
    path: Path, reading: Reading, keeping: Keeping, lens: Lens | None, color: Color | None
) -> Depth:
    """The depth of a file, with nothing where the alpha of its colour is 0."""
    lens_focal = None if lens is None else lens.foclen / lens.sensor_width
    if color is None:
        return read_depth(path, reading, keeping=keeping, lens_focal=lens_focal)
    depth = read_depth(
        path,
        reading,
        keeping=keeping,
        lens_focal=lens_focal,
        overscan=color.overscan,
        alpha=color.alpha,
    )
    same = depth.metres.shape == color.shape[:2]
    return element_depth(depth, color, keeping) if same else depth


def _repair(
    depth: Depth, lens: Lens, reading: Reading, keeping: Keeping
) -> tuple[DepthRepair | None, tuple[str, ...]]:
    """How the depth would be repaired, and warnings of a depth that hardly suits the lens."""
    with suppress(InputError):  # too near to be rendered, as the radius shows
        radii, declared = radii_of(lens, depth, keeping), reading.says_scale
        warnings = of_radii(depth, radii.px, radii.limits, lens, declared=declared)
        return radii.diagnose(reading), tuple(warnings)
    return None, ()


def _ends_px(lens: Lens, extremes: NDArray[Any], depth: Depth, keeping: Keeping) -> list[float]:
    """The ends of the radii of depths with these extremes."""
    if depth.is_radius:
        return list(radii_of(lens, depth, keeping).limits)
    return [float(r) for r in signed_radius(lens, extremes, depth.size)]


def ends_of(values: NDArray[Any]) -> list[float]:
    """Least and greatest; nothing of none."""
    return [float(values.min()), float(values.max())] if values.size else []

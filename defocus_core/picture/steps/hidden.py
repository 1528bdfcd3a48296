"""What is known of the hidden layer: by files of it, or because other frames have seen it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from defocus_core.errors import InputError
from defocus_core.io.arrays import bands, times
from defocus_core.io.images.primaries import refuse_other_primaries
from defocus_core.picture.pair import read as read_pair
from defocus_core.picture.radii import radii_of
from defocus_core.picture.scene import map_windows, windows
from defocus_core.picture.take import InputPair, Surfaces, Take

if TYPE_CHECKING:
    from defocus_core.renderer.inpainting.hidden_layers import KnownLayer


def read(take: Take) -> Take:
    """The take with the files of its hidden layer."""
    hidden, color = take.job.picture.hidden, take.inputs.color
    wanted = InputPair.of(take.job, take.inputs.holding.keeping)
    assert hidden is not None
    behind, depth = read_pair(replace(wanted, picture=hidden))
    if behind.shape != color.shape:
        size, needed = (
            f"{width}x{height} px of {channels} channels"
            for height, width, channels in (behind.shape, color.shape)
        )
        problem = f"is {size} but the picture is {needed}"
        raise InputError("wrong-size", problem, "give ‹hidden› of the same kind", path=hidden.color)
    refuse_other_primaries(behind.path, behind.attributes, color.attributes, "the picture")
    warnings = (f"hidden: {warning}" for warning in behind.warnings)
    return take.reading(hidden=(behind, depth), warnings=(*take.inputs.warnings, *warnings))


def scene(surfaces: Surfaces) -> Surfaces:
    """The surfaces with what is hidden: as files have it, and else as other frames saw it."""
    take = surfaces.take
    behind = None if take.inputs.hidden is None else _of_files(surfaces)
    if take.seen is None:
        return replace(surfaces, hidden=behind)
    color, radius, mask = (each.to(take.device) for each in take.seen)
    radius = radius * take.longer_axis
    if behind is not None:
        given = behind[2][:]
        color, radius = behind[0][:].where(given, color), behind[1][:].where(given, radius)
        mask = given | mask
    return replace(surfaces, hidden=(color, radius, mask))


def _of_files(surfaces: Surfaces) -> KnownLayer:
    """The hidden layer of files: it is unknown where depth is inf and colour 0."""
    take = surfaces.take
    assert take.inputs.hidden is not None
    color, depth = take.inputs.hidden
    keeping = take.inputs.holding.keeping
    known = keeping.new(depth.metres.shape, np.bool_)
    for rows in bands(depth.metres.shape):
        shown = np.logical_or.reduce([plane[rows] != 0 for plane in color.planes])
        known[rows] = np.isfinite(depth.metres[rows]) | shown
    px = times(radii_of(take.lens, depth, keeping).px, take.longer_axis)
    return (
        windows(color.planes, take.device),
        map_windows(px, take.device),
        map_windows(known, take.device),
    )

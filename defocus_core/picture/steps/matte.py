"""The matte of a picture: the coverage of its subject, whose edges are those of the depth."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.errors import UsageProblem
from defocus_core.io.images.matte import read_matte
from defocus_core.picture.scene import Surfaces
from defocus_core.picture.sources import map_windows
from defocus_core.picture.take import Take


def read(take: Take) -> Take:
    """The take with its matte, if it is rendered."""
    picture, color = take.job.picture, take.inputs.color
    if picture.over is not None:
        problem = "stands beside ‹over›, whose element has its own alpha"
        raise UsageProblem("contradiction", problem, "leave it out", field="matte")
    if not take.job.outputs.need_rendering:
        return take
    assert picture.matte is not None
    return take.reading(matte=read_matte(picture.matte.color, color.size, color.overscan))


def scene(surfaces: Surfaces) -> Surfaces:
    """The surface with its coverage."""
    take = surfaces.take
    return replace(surfaces, matte=map_windows(take.inputs.matte, take.device))

"""A picture that compiled loops render alone, without torch, whose import takes a second."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from defocus_core.io.arrays import block_of, times
from defocus_core.picture.memory_budget import capacity_mb
from defocus_core.picture.scene import settings_of
from defocus_core.picture.steps.table import PASSES, SCENE
from defocus_core.picture.take import Pass, Surfaces, Take
from defocus_core.system import memory

if TYPE_CHECKING:
    from defocus_core.tensors.views import ViewTensors


def views_alone(take: Take) -> tuple[ViewTensors, float] | None:
    """The views of a picture, as arrays, and a bound of their memory in MB.

    None where torch must render: several surfaces, or depth that may need repair.
    """
    from defocus_core.renderer.compiled.carried import CHANNELS, bytes_of_loops, carries_settings
    from defocus_core.tensors.box import Box
    from defocus_core.tensors.views import ViewTensors

    color, reading = take.inputs.color, take.job.reading
    if take.device != "cpu" or len(color.planes) != CHANNELS or not _is_plain(take):
        return None
    infinity = None if take.radii.infinity is None else take.longer_axis * take.radii.infinity
    settings = replace(settings_of(take), depth_repair=reading.depth_repair, infinity=infinity)
    height, width = take.shown.shape
    bound = bytes_of_loops((height, width), settings, edges=True) / memory.MB
    fits = take.inputs.arrays_mb + bound <= capacity_mb(take.job.machine)
    if not (fits and carries_settings(settings)):
        return None
    from defocus_core.renderer.compiled.arrays import rendered_alone
    from defocus_core.renderer.compiled.once import compile_once

    compile_once()
    px = np.ascontiguousarray(times(take.radii.px, take.longer_axis), np.float32)
    views = rendered_alone(block_of(color.planes), px, settings)
    if views is None:
        return None
    arrays: Any = [*views.images], views.trust
    return ViewTensors(arrays[0], arrays[1], views.stats, Box(0, 0, height, width)), bound


def _is_plain(take: Take) -> bool:
    """Whether a picture is one surface in one pass, whose repair no other frame decides."""
    from defocus_core.depth.diagnosis import DepthRepair

    color, reading = take.inputs.color, take.job.reading
    if color.is_cut or reading.edge_width is not None or take.decided is not None:
        return False
    surfaces = Surfaces(take, (color,), (take.radii,), (), (), DepthRepair())
    steps = {step.name for step in SCENE if step.applies(surfaces)}
    whole = Pass(take, cast(Any, None), cast(Any, None), (), ())
    return steps <= {"scene:repair_surfaces"} and not any(p.applies((whole,)) for p in PASSES)

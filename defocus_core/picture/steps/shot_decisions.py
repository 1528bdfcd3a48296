"""Decisions for all frames of a shot: how depth is repaired, and where the focus lies.

They are made from a sample of its frames, so that no frame decides for itself and flickers. Every
process finds them anew, from the same files to the same result.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from statistics import median
from typing import TYPE_CHECKING

from defocus_core.batch.jobs.job import FrameLens, Job, Shot
from defocus_core.batch.lenses.lens import Lens
from defocus_core.errors import DefocusError
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.images.color_planes import Color
from defocus_core.io.shots.frame_patterns import in_words
from defocus_core.picture.inputs import Inputs
from defocus_core.picture.memory_budget import holding
from defocus_core.picture.pair import read
from defocus_core.picture.radii import Radii, radii_of
from defocus_core.picture.steps.focusing import focused, scaled

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair

_KEPT = 1 << 12  # foci of frames
_FOCI: dict[object, float] = {}
_REPAIRS: dict[object, DepthRepair] = {}


def shot_focused(job: Job, depth: Depth, *, deep: bool = False) -> Lens:
    """The lens of a job with its focus distance, decided with other frames if its shot says so."""
    shot, lens = job.shot, job.lens
    frames = () if shot is None or deep else shot.focus or shot.sample
    if not frames or lens.draw is not None or not is_found(lens):
        return focused(lens, depth)
    foc_dist = _mean_focus(frames, job)
    focused_lens = dataclasses.replace(
        lens, foc_dist=foc_dist, focus_at=None, focus_percentile=None
    )
    within = focused(focused_lens, depth)
    return dataclasses.replace(
        within, focus_at=lens.focus_at, focus_percentile=lens.focus_percentile
    )


def is_found(lens: Lens) -> bool:
    """Whether the depth decides where the focus of a lens lies."""
    by_depth = lens.focus_at is not None or lens.focus_percentile is not None
    return by_depth and lens.blur is None  # its numbers may be of another scale in each frame


def _mean_focus(frames: Sequence[FrameLens], job: Job) -> float:
    """The mean focus in mm of frames, in disparity, of those that have something to focus on."""
    distances, failed = [], []
    for frame in frames:
        try:
            distances.append(_own_focus(frame, job))
        except DefocusError as error:
            failed.append(error)
    if not distances:
        raise failed[0]
    disparity = [1 / each for each in distances]
    whole = job.shot is not None and not job.shot.focus  # a frame that is unlike others counts less
    mean = median(disparity) if whole else sum(disparity) / len(disparity)
    return 1 / mean if mean else float("inf")


def _own_focus(frame: FrameLens, job: Job) -> float:
    key = (frame, job.reading)
    if key not in _FOCI:
        while len(_FOCI) >= _KEPT:
            _FOCI.pop(next(iter(_FOCI)))
        _, depth = _read(frame, job)
        foc_dist = focused(dataclasses.replace(frame.lens, max_coc=None), depth).foc_dist
        _FOCI[key] = float("inf") if foc_dist is None else foc_dist
    return _FOCI[key]


def _read(frame: FrameLens, job: Job) -> tuple[Color, Depth]:
    """Colour and depth of a frame, read as those of a job."""
    focal = dataclasses.replace(job, lens=frame.lens).lens_focal
    return read(frame.picture, job.reading, holding(job).keeping, focal)


def shot_repair(job: Job, inputs: Inputs, radii: Radii) -> DepthRepair | None:
    """The repair of depth that the shot of a job has decided on; None if each frame decides."""
    from defocus_core.sequences.shot_repair import agreed_repair, repair_through

    shot = job.shot
    if shot is None or not shot.sample or job.reading.depth_repair == "off":
        return None
    if not job.outputs.need_rendering or inputs.is_layered:
        return None
    key = (shot.sample, job.reading)
    if key not in _REPAIRS:
        _REPAIRS.clear()
        each = [_repair_of(frame, job) for frame in shot.sample]
        _REPAIRS[key] = agreed_repair([r for r, _ in each], [scale for _, scale in each])
    return repair_through(_REPAIRS[key], radii.scale, radii.infinity)


def _repair_of(frame: FrameLens, job: Job) -> tuple[DepthRepair, float]:
    """The repair that a frame needs, and the scale of its lens."""
    color, depth = _read(frame, job)
    of_frame = dataclasses.replace(job, picture=frame.picture, lens=frame.lens)
    lens = scaled(shot_focused(of_frame, depth), (depth,))
    radii = radii_of(lens, depth, holding(job).keeping)
    _, repair = radii.repaired(color, job.reading)
    return repair, radii.scale


@lru_cache(maxsize=8)
def decided_words(shot: Shot | None, repair: DepthRepair | None) -> str:
    """The frames that decided on a repair, in words; empty if nothing is repaired."""
    from defocus_core.depth.diagnosis import DepthRepair

    if shot is None or repair is None or repair == DepthRepair():
        return ""
    numbers = [int(each.picture.frame or 0) for each in shot.sample]
    return f"as {in_words(numbers)} of the shot decide"

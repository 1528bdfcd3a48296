"""Frames of a shot: what they decide together.

How depth is repaired and where the focus lies are decided by a sample of the frames, so that no
frame decides for itself and flickers. Every process finds them anew, from the same files to the
same result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from statistics import median
from typing import TYPE_CHECKING

from defocus_core.errors import DefocusError
from defocus_core.io.arrays import Keeping
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.shots.frame_patterns import in_words
from defocus_core.picture.focus import with_blur_reach, with_focus
from defocus_core.picture.memory_budget import holding
from defocus_core.picture.pair import read
from defocus_core.picture.radii import radii_of
from defocus_core.picture.scene import map_windows, windows
from defocus_core.picture.take import InputPair, Take
from defocus_core.request.job import FrameLens, Job, Reading, Shot
from defocus_core.request.lens import Lens

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair


_KEPT = 1 << 12  # foci of frames
_REPAIRS: dict[object, DepthRepair] = {}


def lens(take: Take) -> Take:
    """The take with the focus that the frames of its shot decide together, if they do."""
    return replace(take, lens=_with_shared_focus(take.job, take.inputs.depth))


def radii(take: Take) -> Take:
    """The take with the repair that the frames of its shot decide on, if they do."""
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.sequences.shot_repair import agreed_repair, repair_through

    job, own = take.job, take.radii
    assert job.shot is not None
    key = (job.shot.sample, job.reading)
    if key not in _REPAIRS:
        _REPAIRS.clear()
        each = [_repair_of(frame, job) for frame in job.shot.sample]
        _REPAIRS[key] = agreed_repair([r for r, _ in each], [scale for _, scale in each])
    decided = repair_through(_REPAIRS[key], own.scale, own.infinity)
    note = "" if decided == DepthRepair() else _words(job.shot)
    return replace(take, decided=decided, shot_note=note)


def _with_shared_focus(job: Job, depth: Depth) -> Lens:
    """The lens of a job with its focus distance."""
    shot, lens = job.shot, job.lens
    frames = () if shot is None else shot.focus or shot.sample
    by_depth = lens.focus_at is not None or lens.focus_percentile is not None
    # Numbers of a blur in px may be of another scale in each frame
    if not frames or lens.draw is not None or lens.blur is not None or not by_depth:
        return with_focus(lens, depth)
    found = replace(lens, foc_dist=_mean_focus(frames, job), focus_at=None, focus_percentile=None)
    within = with_focus(found, depth)
    return replace(within, focus_at=lens.focus_at, focus_percentile=lens.focus_percentile)


def _mean_focus(frames: Sequence[FrameLens], job: Job) -> float:
    """The mean focus in mm of frames, in disparity, of those that have something to focus on."""
    distances, failed = [], []
    for frame in frames:
        try:
            distances.append(_own_focus(frame, job.reading, *_keeping_and_focal(frame, job)))
        except DefocusError as error:
            failed.append(error)
    if not distances:
        raise failed[0]
    disparity = [1 / each for each in distances]
    of_sample = job.shot is not None and not job.shot.focus
    # of a sample a frame that is unlike others counts less
    mean = median(disparity) if of_sample else sum(disparity) / len(disparity)
    return 1 / mean if mean else float("inf")


@lru_cache(maxsize=_KEPT)
def _own_focus(
    frame: FrameLens, reading: Reading, keeping: Keeping, lens_focal: float | None
) -> float:
    """The focus in mm that the depth of a frame decides."""
    _, depth = read(InputPair(frame.picture, reading, keeping, lens_focal))
    foc_dist = with_focus(replace(frame.lens, max_coc=None), depth).foc_dist
    return float("inf") if foc_dist is None else foc_dist


def _keeping_and_focal(frame: FrameLens, job: Job) -> tuple[Keeping, float | None]:
    """Where the arrays of a frame are kept, and the focal length in widths of its sensor."""
    return holding(job).keeping, replace(job, lens=frame.lens).lens_focal


def _repair_of(frame: FrameLens, job: Job) -> tuple[DepthRepair, float]:
    """The repair that a frame needs, and the scale of its lens."""
    import torch

    from defocus_core.depth.repair import repair_depth

    color, depth = read(InputPair(frame.picture, job.reading, *_keeping_and_focal(frame, job)))
    of_frame = replace(job, picture=frame.picture, lens=frame.lens)
    lens = with_blur_reach(_with_shared_focus(of_frame, depth), (depth,))
    own = radii_of(lens, depth, holding(job).keeping)
    _, repair = repair_depth(
        map_windows(own.px, "cpu"),
        windows(color.planes, "cpu"),
        own.infinity,
        torch.get_num_threads(),
        depth_repair=job.reading.depth_repair,
        edge_width=job.reading.edge_width,
    )
    return repair, own.scale


@lru_cache(maxsize=8)
def _words(shot: Shot) -> str:
    """The frames that decided on a repair, in words."""
    numbers = [int(each.picture.frame or 0) for each in shot.sample]
    return f"as {in_words(numbers)} of the shot decide"

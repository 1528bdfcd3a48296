"""Steps for frames of a shot, which share focus and repair of depth so that they do not flicker.

Each process decides both again from the same frames, and so with the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from statistics import median
from typing import TYPE_CHECKING, TypeVar

from defocus_core.errors import DefocusError
from defocus_core.io.shots.frame_patterns import in_words
from defocus_core.picture.focus import with_blur_reach, with_focus
from defocus_core.picture.pair import read
from defocus_core.picture.radii import radii_of
from defocus_core.picture.scene import map_on, picture_on
from defocus_core.picture.take import InputPair, Take
from defocus_core.request.job import FrameLens, Job, Reading

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair

T = TypeVar("T")
_Finding = Callable[[FrameLens, Reading, float | None], T]
_KEPT = 1 << 12  # cached findings of frames, which later frames share


def lens(take: Take) -> Take:
    """Set the focus, which the frames of a shot share if it is found from depth."""
    job, lens, depth = take.job, take.job.lens, take.inputs.depth
    assert job.shot is not None
    frames = job.shot.sample if job.shot.shares_focus else ()
    by_depth = lens.focus_at is not None or lens.focus_percentile is not None
    # numbers beside a blur in px may differ in scale from frame to frame
    if not frames or lens.draw is not None or lens.blur is not None or not by_depth:
        return replace(take, lens=with_focus(lens, depth))
    disparity = [1 / foc_dist for foc_dist in _of_each(frames, job, _focus_of)]
    middle = median(disparity)  # an outlier has less weight
    foc_dist = 1 / middle if middle else float("inf")
    within = replace(lens, foc_dist=foc_dist, focus_at=None, focus_percentile=None)
    focused = replace(lens, foc_dist=with_focus(within, depth).foc_dist)
    return replace(take, lens=focused)


def radii(take: Take) -> Take:
    """Set the repair of depth that the frames of a shot share."""
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.depth.shot_repair import agreed_repair, repair_through

    job, own = take.job, take.radii
    assert job.shot is not None
    of_sample = _of_each(job.shot.sample, job, _repair_of)
    decided = agreed_repair(
        [repair_through(repair, own.scale / scale, own.infinity) for repair, scale in of_sample]
    )
    numbers = [int(each.picture.frame or 0) for each in job.shot.sample]
    note = "" if decided == DepthRepair() else f"as {in_words(numbers)} of the shot decide"
    return replace(take, decided=decided, shot_note=note)


def _of_each(frames: Sequence[FrameLens], job: Job, find: _Finding[T]) -> list[T]:
    """The results of `find` for the frames, without frames for which it raises an error.

    If it does so for all frames, the first error is raised.
    """
    found, failed = [], []
    for frame in frames:
        lens_focal = replace(job, lens=frame.lens).lens_focal
        try:
            found.append(find(frame, job.reading, lens_focal))
        except DefocusError as error:
            failed.append(error)
    if not found:
        raise failed[0]
    return found


@lru_cache(maxsize=_KEPT)
def _focus_of(frame: FrameLens, reading: Reading, lens_focal: float | None) -> float:
    """The focus distance in mm that is found from the depth of a frame."""
    _, depth = read(InputPair(frame.picture, reading, lens_focal))
    foc_dist = with_focus(frame.lens, depth).foc_dist
    return float("inf") if foc_dist is None else foc_dist


@lru_cache(maxsize=_KEPT)
def _repair_of(
    frame: FrameLens, reading: Reading, lens_focal: float | None
) -> tuple[DepthRepair, float]:
    """The repair that the depth of a frame needs; and radius in px per disparity of 1/mm."""
    import torch

    from defocus_core.depth.repair import repair_depth

    color, depth = read(InputPair(frame.picture, reading, lens_focal))
    own = radii_of(with_blur_reach(with_focus(frame.lens, depth), (depth,)), depth)
    _, repair = repair_depth(
        map_on(own.px, "cpu"),
        picture_on(color.planes, "cpu"),
        own.infinity,
        torch.get_num_threads(),
        depth_repair=reading.depth_repair,
        edge_width=reading.edge_width,
    )
    return repair, own.scale

"""Shots: frames of a frame pattern, which share the repair of depth and a focus found from depth.

Both are decided from the first, the middle and the last frame that exist, even if other frames are
rendered. So a frame looks the same whether it is rendered alone or with the others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

from defocus_core.errors import UsageProblem
from defocus_core.request.job import FrameLens, Job, PictureFiles, Shot
from defocus_core.request.lens import LensValues
from defocus_core.request.resolver import Layer, fields_of


def with_shot(
    jobs: Sequence[Job],
    every: Sequence[PictureFiles],
    lens_of: Callable[[PictureFiles, str], LensValues],
    options: Layer,
    *,
    moving: bool,
) -> list[Job]:
    """Set `shot` of jobs: the frames that decide depth repair and focus for the whole shot.

    Args:
        jobs: The jobs, in any order.
        every: All existing frames of the shot, ascending; empty without a shot.
        lens_of: Function of a frame and the suffix of a lens; gives this lens for the frame.
        options: Options of the table ``[shot]``.
        moving: Whether keyframes move the pixel in focus, so that the focus is not shared.
    """
    if not every:
        for given in options.values():
            problem = "is for the frames of a shot, but no path numbers them"
            remedy = "give patterns like 'shot.####.exr'"
            raise UsageProblem("idle-option", problem, remedy, path=given.place)
        return list(jobs)
    frames = {picture.frame for picture in every}
    steady = fields_of(options).get("steady") is not False

    @cache
    def sample(suffix: str) -> tuple[FrameLens, ...]:
        three = dict.fromkeys((0, len(every) // 2, len(every) - 1))
        return tuple(FrameLens(every[k], lens_of(every[k], suffix)) for k in three)

    def shot(job: Job) -> Shot | None:
        if job.picture.frame not in frames or not steady:  # a picture of a list
            return None
        lens = job.lens
        is_found = lens.focus_at is not None or lens.focus_percentile is not None
        if job.reading.depth_repair == "off" and (moving or not is_found):
            return None
        return Shot(sample(job.suffix), shares_focus=not moving)

    return [replace(job, shot=shot(job)) for job in jobs]

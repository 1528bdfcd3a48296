"""Depth over time: how the disparities of a frame are spread, and where its focus lies."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from typing import Any, NamedTuple, TypeGuard

from defocus_core.batch.journal.journal import Record

_MM = 1000.0  # of a metre


class FrameDepth(NamedTuple):
    """The depth of a frame of a shot; disparities are in 1/m, 0 for infinitely far."""

    shot: str  # name of the sample, with # for the number of the frame
    frame: int
    focus: float  # disparity of the plane in focus
    # Ascending disparities, between each two of which as many pixels lie
    quantiles: tuple[float, ...]


def depth_of_frame(record: Record) -> FrameDepth | None:
    """The depth of a frame, from the record of a job that was done; None if it is of no shot."""
    over_time = (record.get("measures") or {}).get("depth_over_time")
    focus = record["lens"]["focus_mm"]
    if not isinstance(over_time, dict) or not (focus == "inf" or (focus and focus > 0)):
        return None
    frame, quantiles = over_time.get("frame"), over_time.get("disparity")
    if not isinstance(frame, int) or not _are_quantiles(quantiles):
        return None
    last = rf"(.*)(?<!\d)0*{frame}(?!\d)"  # the shot may hold the same number: sh010.0010
    shot = re.sub(last, r"\1#", record["sample_id"], count=1)
    return FrameDepth(shot, frame, 0.0 if focus == "inf" else _MM / focus, tuple(quantiles))


def _are_quantiles(values: Any) -> TypeGuard[list[float]]:
    """Whether these are ascending disparities: a journal may come from anywhere."""
    if not isinstance(values, list) or len(values) < 2:
        return False
    numbers = all(isinstance(each, int | float) and math.isfinite(each) for each in values)
    return numbers and all(0 <= a <= b for a, b in pairwise(values))

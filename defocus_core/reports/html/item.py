"""The records of a report: items, their layers, and what they are made of."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple, TypeGuard

from defocus_core.batch.journal.journal import Record

# Kinds of layer: light is shown as a screen shows it, with an exposure; a signed map is orange
# below 0 and blue above; a share is from 0 to 1; another map is grey from its least to its greatest
# value.
LIGHT, SIGNED, SHARE, PLAIN = "light", "signed", "share", "plain"
HEAT = "heat"  # a difference: its thumbnail has colours already
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


@dataclass(frozen=True)
class StoredHalves:
    """Values of a layer as half floats, packed."""

    data: bytes  # as `defocus_core.reports.html.layers` packs them
    corner: tuple[int, int]  # column and row of the first pixel in the layer
    size: tuple[int, int]  # width and height in px
    scale: float = 1.0  # factor from a half to the value of the file
    # Key of the layer whose bits were subtracted; empty if the left neighbour's were
    base: str = ""


@dataclass(frozen=True)
class Layer:
    """A picture or a map of an item."""

    key: str  # name within the item, like ``a``, ``b`` or ``coc``
    title: str  # as people read it
    kind: str  # one of the kinds of this module
    channels: tuple[str, ...]  # names of its one or three channels
    size: tuple[int, int]  # width and height in px
    # Exponent of the power law that decodes it, 1 for linear, None for sRGB
    gamma: float | None = 1.0
    # The values of black and white in the thumbnail of a map
    value_range: tuple[float, float] = (0.0, 1.0)
    type: str = ""  # number type of the file, like half
    thumbnail: bytes = b""  # the bytes of a JPEG or PNG; empty if there is none
    halves: StoredHalves | None = None  # none if they are not wanted


@dataclass(frozen=True)
class Item:
    """A row of the report."""

    name: str  # of the pair, sample or shot
    status: str
    passes: bool  # whether all is well
    words: str = ""  # what is to be said in a line
    facts: Sequence[tuple[str, str]] = ()  # a term and what is to be said of it
    metrics: Mapping[str, float] = field(default_factory=dict)
    facets: Mapping[str, str] = field(default_factory=dict)  # what items are grouped by, like lens
    commands: Sequence[tuple[str, str]] = ()  # a title and a command line
    layers: Sequence[Layer] = ()  # the first two are shown at first, if there are two
    wiggle: tuple[str, ...] = ()  # keys of the left and the right view; empty if there are none
    full: float = 1.0  # the difference of the hottest colour
    place: tuple[int, int] | None = None  # column and row of the worst pixel
    depth: FrameDepth | None = None  # of a frame of a shot, to be drawn over time


@dataclass(frozen=True)
class Column:
    """A column of numbers: the name of a metric, its title, unit, and whether high is better."""

    name: str
    title: str
    unit: str = ""
    high: bool = False


@dataclass(frozen=True)
class ReportTable:
    """A table of words: its title, the heading of each column, and the cells of each row."""

    title: str
    heading: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Report:
    """A report."""

    title: str
    words: Sequence[str]  # what it is of, a line each
    items: Sequence[Item]  # the most important first
    columns: Sequence[Column]  # the numbers that the table shows
    # What sums the items up: of each the title, the heading and the rows
    tables: Sequence[ReportTable] = ()

"""The records of a report: items, their layers, and what they are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from defocus_core.reports.html.depth_over_time import FrameDepth

# Kinds of layer: light is shown as a screen shows it, with an exposure; a signed map is orange
# below 0 and blue above; a share is from 0 to 1; another map is grey from its least to its greatest
# value.
LIGHT, SIGNED, SHARE, PLAIN = "light", "signed", "share", "plain"
HEAT = "heat"  # a difference: its thumbnail has colours already


@dataclass(frozen=True)
class StoredHalves:
    """Values of a layer as half floats, packed.

    Attributes:
        data: as `defocus_core.reports.html.halves` packs them.
        corner: column and row of the first pixel in the layer.
        size: width and height in px.
        scale: factor from a half to the value of the file.
        base: key of the layer whose bits were subtracted; empty if the left neighbour's were.
    """

    data: bytes
    corner: tuple[int, int]
    size: tuple[int, int]
    scale: float = 1.0
    base: str = ""


@dataclass(frozen=True)
class Layer:
    """A picture or a map of an item.

    Attributes:
        key: name within the item, like ``a``, ``b`` or ``coc``.
        title: as people read it.
        kind: one of the kinds of this module.
        channels: names of its one or three channels.
        size: width and height in px.
        gamma: exponent of the power law that decodes it, 1 for linear, None for sRGB.
        value_range: the values of black and white in the thumbnail of a map.
        type: number type of the file, like half.
        thumbnail: the bytes of a JPEG or PNG; empty if there is none.
        halves: None if they are not wanted.
    """

    key: str
    title: str
    kind: str
    channels: tuple[str, ...]
    size: tuple[int, int]
    gamma: float | None = 1.0
    value_range: tuple[float, float] = (0.0, 1.0)
    type: str = ""
    thumbnail: bytes = b""
    halves: StoredHalves | None = None


@dataclass(frozen=True)
class Item:
    """A row of the report.

    Attributes:
        name: of the pair, sample or shot.
        status: a word.
        passes: whether all is well.
        words: what is to be said in a line.
        facts: a term and what is to be said of it.
        metrics: numbers by name.
        facets: what items are grouped by, like lens.
        commands: a title and a command line.
        layers: the first two are shown at first, if there are two.
        wiggle: keys of the left and the right view; empty if there are none.
        full: the difference of the hottest colour.
        place: column and row of the worst pixel.
        depth: of a frame of a shot, to be drawn over time.
    """

    name: str
    status: str
    passes: bool
    words: str = ""
    facts: Sequence[tuple[str, str]] = ()
    metrics: Mapping[str, float] = field(default_factory=dict)
    facets: Mapping[str, str] = field(default_factory=dict)
    commands: Sequence[tuple[str, str]] = ()
    layers: Sequence[Layer] = ()
    wiggle: tuple[str, ...] = ()
    full: float = 1.0
    place: tuple[int, int] | None = None
    depth: FrameDepth | None = None


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
    """A report.

    Attributes:
        title: its heading.
        words: what it is of, a line each.
        items: the most important first.
        columns: the numbers that the table shows.
        tables: what sums the items up: of each the title, the heading and the rows.
    """

    title: str
    words: Sequence[str]
    items: Sequence[Item]
    columns: Sequence[Column]
    tables: Sequence[ReportTable] = ()

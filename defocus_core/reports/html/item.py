"""The records of a report: items, their layers, and what they are made of.

The names of their fields are those that the script and the template of the report know.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

# Kinds of layer: light is shown as a screen shows it, with an exposure; a signed map is orange
# below 0 and blue above; a share is from 0 to 1; another map is grey from its least to its greatest
# value.
LIGHT, SIGNED, SHARE, PLAIN = "light", "signed", "share", "plain"
HEAT = "heat"  # a difference: its thumbnail has colours already


@dataclass(frozen=True)
class StoredValues:
    """Values of a layer in numbers of 16 bits, packed: halves, or steps between two ends."""

    payload: bytes  # as `defocus_core.reports.html.layers` packs them
    box: tuple[int, int, int, int]  # column, row, width and height in px of what they are of
    size: tuple[int, int]  # how many they are across and down
    scale: float = 1.0  # factor from a half to the value of the file
    ends: tuple[float, float] | None = None  # the values of steps 0 and 65535; none of halves
    inverse: bool = False  # whether people read 1 / value, as metres of a disparity
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
    ends: tuple[float, float] = (0.0, 1.0)
    thumbnail: bytes = b""  # the bytes of a JPEG or PNG; empty if there is none
    values: StoredValues | None = None  # none if they are not wanted
    unit: str = ""  # of its values


@dataclass(frozen=True)
class Item:
    """A row of the report."""

    name: str  # of the pair
    status: str
    passes: bool  # whether all is well
    words: str = ""  # what is to be said in a line
    facts: Sequence[tuple[str, str]] = ()  # a term and what is to be said of it
    metrics: Mapping[str, float] = field(default_factory=dict)
    commands: Sequence[tuple[str, str]] = ()  # a title and a command line
    ticked: str = ""  # what it adds to the command that accepts; empty if it cannot be accepted
    layers: Sequence[Layer] = ()  # the first two are shown at first, if there are two
    full: float = 1.0  # the difference of the hottest colour
    place: tuple[int, int] | None = None  # column and row of the worst pixel


@dataclass(frozen=True)
class Column:
    """A column of numbers: the name of a metric, its title, unit, and whether high is better."""

    name: str
    title: str
    unit: str = ""
    high: bool = False


@dataclass(frozen=True)
class Report:
    """A report."""

    title: str
    words: Sequence[str]  # what it is of, a line each
    items: Sequence[Item]  # the most important first
    columns: Sequence[Column]  # the numbers that the table shows
    accept: str = ""  # how the command begins that accepts the items that are ticked

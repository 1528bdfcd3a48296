"""The records of an HTML report: items, their layers, and the values of layers.

The script and the template of the report use the names of their fields.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

# Kinds of layer: light is shown as on a screen, with an exposure; a signed map is orange below 0
# and blue above; a share is from 0 to 1; other maps are grey from their least to their greatest
# value.
LIGHT, SIGNED, SHARE, PLAIN = "light", "signed", "share", "plain"
HEAT = "heat"  # a difference, whose thumbnail has colours


@dataclass(frozen=True)
class StoredValues:
    """Packed values of a layer, of 16 bits: half floats, or steps between two ends."""

    payload: bytes  # packed by `defocus_core.reports.html.layers`
    box: tuple[int, int, int, int]  # column, row, width and height in px of the window
    size: tuple[int, int]  # number of values across and down
    scale: float = 1.0  # factor from a half to the value of the file
    ends: tuple[float, float] | None = None  # the values of steps 0 and 65535; None for halves
    inverse: bool = False  # whether people read 1 / value, as metres of a disparity
    # Key of the layer whose bits were subtracted; empty if the left neighbour's were
    base: str = ""


@dataclass(frozen=True)
class Layer:
    """A picture or a map of an item."""

    key: str  # name of the layer in the item, like ``a``, ``b`` or ``coc``
    title: str  # name for people
    kind: str  # one of the kinds of this module
    channels: tuple[str, ...]  # names of its one or three channels
    size: tuple[int, int]  # width and height in px
    # Exponent of the power law that decodes it, 1 for linear, None for sRGB
    gamma: float | None = 1.0
    # The values of black and white in the thumbnail of a map
    ends: tuple[float, float] = (0.0, 1.0)
    thumbnail: bytes = b""  # the bytes of a JPEG or PNG, or empty
    values: StoredValues | None = None  # None if they are not kept
    unit: str = ""  # of its values


@dataclass(frozen=True)
class Item:
    """A row of the report."""

    name: str  # of the pair
    status: str
    passes: bool  # whether all is well
    words: str = ""  # the result in a line
    facts: Sequence[tuple[str, str]] = ()  # terms and their texts
    metrics: Mapping[str, float] = field(default_factory=dict)
    commands: Sequence[tuple[str, str]] = ()  # titles and command lines
    ticked: str = ""  # its argument of the command that accepts; empty if it cannot be accepted
    layers: Sequence[Layer] = ()  # the first two are shown first
    full: float = 1.0  # the difference at the hottest colour
    place: tuple[int, int] | None = None  # column and row of the worst pixel

"""What goes into a file of bounded size: thumbnails and values of the items, by their rank.

Thumbnails of the first two layers and their difference come first, up to a half of the room; then
the values of the items in their order, each with all its layers; then the other thumbnails.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from defocus_core.reports.html.item import Item, Layer
from defocus_core.reports.html.layers import DIFFERENCE

ROOM = 38_500_000  # characters of items; the file is to have less than 40 MB
_FRAME = 1500  # characters of an item beside its texts: names of layers, elements of the table
_THUMBNAILS = 30_000  # characters of the thumbnails of an item


def length(data: bytes) -> int:
    """Characters of base64."""
    return -(-len(data) // 3) * 4


def values_room(items: int) -> int:
    """The room that so many items leave for values, as a guess before they are drawn."""
    return ROOM - min(ROOM // 2, items * _THUMBNAILS)


def _thumbnails(item: Item, *, first: bool) -> int:
    own = (each for each in item.layers if _is_first(item, each) == first)
    return sum(length(each.thumbnail) for each in own)


def _is_first(item: Item, layer: Layer) -> bool:
    """Whether a layer is one of the two that are shown at first, or their difference."""
    return layer.key == DIFFERENCE or layer in item.layers[:2]


def _values(item: Item) -> int:
    return sum(length(each.halves.data) for each in item.layers if each.halves)


class ByteBudget:
    """Room that is spent on items in their order."""

    def __init__(self, room: int) -> None:
        self.room = room

    def spend(self, costs: Iterable[int]) -> set[int]:
        """Numbers of the items that fit; one that does not lets smaller ones come after it."""
        fitting = set()
        for number, cost in enumerate(costs):
            if 0 < cost <= self.room:
                self.room -= cost
                fitting.add(number)
        return fitting


def fitted(items: Sequence[Item]) -> list[Item]:
    """The items without the payloads that there is no room for."""
    room = ROOM - sum(map(_text, items))
    budget = ByteBudget(room // 2)
    shown = budget.spend(_thumbnails(item, first=True) for item in items)
    budget.room += room - room // 2
    valued = budget.spend(_values(item) + bool(_values(item)) * _rest(item) for item in items)
    beside = budget.spend(0 if n in valued else _rest(item) for n, item in enumerate(items))
    beside |= valued

    return [
        replace(
            item,
            layers=_present(item, first=n in shown, others=n in beside, values=n in valued),
        )
        for n, item in enumerate(items)
    ]


def _text(item: Item) -> int:
    """Characters of the texts of an item, of which its name and words stand there twice."""
    texts = [*(text for pair in (*item.facts, *item.commands) for text in pair)]
    return _FRAME + 2 * len(item.name + item.words) + sum(map(len, texts))


def _rest(item: Item) -> int:
    return _thumbnails(item, first=False)


def _present(item: Item, *, first: bool, others: bool, values: bool) -> list[Layer]:
    """The layers that have something to show."""
    layers = []
    for layer in item.layers:
        stays = first if _is_first(item, layer) else others
        thumbnail = layer.thumbnail if stays else b""
        layers.append(replace(layer, thumbnail=thumbnail, halves=layer.halves if values else None))
    return [layer for layer in layers if layer.thumbnail or layer.halves]

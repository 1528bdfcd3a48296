"""What there is no room for is left out, the last first."""

from defocus_core.reports.html import page
from defocus_core.reports.html.item import LIGHT, Item, Layer, StoredValues


def item(name, thumbnail, values):
    halves = StoredValues(b"v" * values, (0, 0, 1, 1), (1, 1)) if values else None
    layers = [
        Layer(key, key, LIGHT, ("R", "G", "B"), (9, 9), thumbnail=b"t" * thumbnail, values=halves)
        for key in ("a", "b", "left")
    ]
    return Item(name, "different", passes=False, layers=layers)


ROOM = 4000


def fitted(items):
    """What fits into `ROOM` characters beside the texts."""
    return page.fitted(items, ROOM + sum(map(page.text_room, items)))


def spent(items):
    return sum(
        page.length(layer.thumbnail) + page.length(layer.values.payload if layer.values else b"")
        for each in items
        for layer in each.layers
    )


def valued(items):
    return [any(layer.values for layer in each.layers) for each in items]


def test_thumbnails_take_no_more_than_a_half():
    kept = fitted([item(str(n), 150, 300) for n in range(40)])
    assert valued(kept)[0]
    assert spent(kept) <= ROOM
    assert kept[-1].layers == []  # in the table alone


def test_a_table_of_very_many_items_takes_room_from_pictures():
    items = [item(str(n), 3000, 0) for n in range(2000)]
    room = page.ROOM // 10
    kept = page.fitted(items, room)
    assert spent(kept) < room - sum(map(page.text_room, items))
    assert kept[0].layers
    assert not kept[-1].layers

"""What there is no room for is left out, the last first."""

from __future__ import annotations

import pytest

from defocus_core.reports.html import page
from defocus_core.reports.html.item import LIGHT, Item, Layer, StoredHalves


def item(name, thumbnail, values):
    halves = StoredHalves(b"v" * values, (0, 0), (1, 1)) if values else None
    layers = [
        Layer(key, key, LIGHT, ("R", "G", "B"), (9, 9), thumbnail=b"t" * thumbnail, halves=halves)
        for key in ("a", "b", "left")
    ]
    return Item(name, "different", passes=False, layers=layers)


@pytest.fixture
def room(monkeypatch):
    monkeypatch.setattr(page, "ROOM", 4000)
    monkeypatch.setattr(page, "_FRAME", 0)
    return 4000


def spent(items):
    return sum(
        page.length(layer.thumbnail) + page.length(layer.halves.data if layer.halves else b"")
        for each in items
        for layer in each.layers
    )


def valued(items):
    return [any(layer.halves for layer in each.layers) for each in items]


def test_all_is_kept_where_there_is_room():
    items = [item("x", 300, 3000), item("y", 300, 0)]
    assert page.fitted(items) == items


def test_the_first_items_keep_their_values(room):
    fitted = page.fitted([item(name, 60, 300) for name in "vwxyz"])
    assert valued(fitted) == [True, True, False, False, False]
    assert all(len(each.layers) == 3 for each in fitted[:2])
    assert spent(fitted) <= room


def test_thumbnails_take_no_more_than_a_half(room):
    fitted = page.fitted([item(str(n), 150, 300) for n in range(40)])
    assert valued(fitted)[0]
    assert spent(fitted) <= room
    assert fitted[-1].layers == []  # in the table alone


def test_a_table_of_very_many_items_takes_room_from_pictures():
    items = [item(str(n), 3000, 0) for n in range(20_000)]
    fitted = page.fitted(items)
    assert spent(fitted) < page.ROOM - 20_000 * page._FRAME
    assert fitted[0].layers
    assert not fitted[-1].layers


def test_a_large_item_lets_smaller_ones_come_after_it(room):
    assert valued(page.fitted([item("large", 10, 3000), item("small", 10, 30)])) == [False, True]

"""Rows of the table of lens options: what they write, they read."""

import pytest

from defocus_core.request.parameters import LENS_OPTIONS, RECORDED

ROWS = LENS_OPTIONS.values()
name_of = {"ids": lambda row: row.name}


@pytest.mark.parametrize("row", ROWS, **name_of)
def test_a_value_is_read_as_it_was_written(row):
    value = row.parse(row.example)
    assert row.parse(row.text(value)) == value
    assert row.parse(row.shown(value)) == value
    assert row.parse(row.with_unit(row.example)) == value


@pytest.mark.parametrize("row", RECORDED.values(), **name_of)
def test_all_digits_are_written_where_nobody_says_how_many(row):
    value = 7 if row.name == "blades" else 7.123456789012
    assert row.parse(row.text(value)) == value
    assert row.text(value) != row.shown(value) or row.name == "blades"

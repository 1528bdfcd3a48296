"""Rows of the table of lens options: what they write, they read."""

from dataclasses import fields

import pytest

from defocus_core.request.lens import LensValues
from defocus_core.request.parameters import LENS_OPTIONS, RECORDED

ROWS = LENS_OPTIONS.values()
name_of = {"ids": lambda row: row.name}


@pytest.mark.parametrize("row", ROWS, **name_of)
def test_a_value_is_read_as_it_was_written(row):
    value = row.parse(row.example)
    assert row.parse(row.text(value)) == value
    assert row.parse(row.shown(value)) == value
    assert row.parse(row.with_unit(row.example)) == value


@pytest.mark.parametrize("row", ROWS, **name_of)
def test_an_option_has_a_field_of_a_lens_or_says_the_same_as_one_that_has(row):
    known = {field.name for field in fields(LensValues)}
    assert row.field in known or row.instead_of in LENS_OPTIONS
    assert row.file_field in {"", *known}
    assert row.needs in {"", *LENS_OPTIONS}


@pytest.mark.parametrize("row", RECORDED.values(), **name_of)
def test_all_digits_are_written_where_nobody_says_how_many(row):
    value = 7 if row.name == "blades" else 7.123456789012
    assert row.parse(row.text(value)) == value
    assert row.text(value) != row.shown(value) or row.name == "blades"

"""Quantities are read with their unit, and only with it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from defocus_core.batch.lenses import quantities
from defocus_core.batch.lenses.quantities import QuantityError


@pytest.mark.parametrize(
    ("text", "mm"),
    [
        ("50mm", 50.0),
        ("2.5cm", 25.0),
        ("2m", 2000.0),
        ("2.3m", 2300.0),
        ("1in", 25.4),
        ("6ft", 1828.8),
        (" 1.2 m ", 1200.0),
        (".5M", 500.0),
        ("1e-1m", 100.0),
    ],
)
def test_a_length_is_its_number_times_its_unit_in_mm(text: str, mm: float) -> None:
    assert quantities.length(text) == mm


def test_a_length_without_unit_is_refused_with_an_example() -> None:
    with pytest.raises(QuantityError) as raised:
        quantities.length("2")
    assert str(raised.value) == "'2' has no unit; write it with a unit, like 2m or 50mm"


def test_a_size_without_unit_is_refused_with_an_example() -> None:
    for text in ("400", "2e9", "0"):
        with pytest.raises(QuantityError) as raised:
            quantities.byte_count(text)
        assert str(raised.value) == f"'{text}' has no unit; write it with a unit, like 2GB"


@pytest.mark.parametrize(
    "text", ["", "m", "two metres", "1.2.3m", "2yd", "0mm", "-2m", "nan", "inf"]
)
def test_what_is_no_positive_length_is_refused(text: str) -> None:
    with pytest.raises(QuantityError):
        quantities.length(text)


def test_focus_may_be_at_infinity() -> None:
    assert quantities.focus("inf") == math.inf
    assert quantities.focus("2m") == 2000.0


@pytest.mark.parametrize(("text", "number"), [("1.4", 1.4), ("f/1.4", 1.4), ("F/8", 8.0)])
def test_f_numbers_have_no_unit(text: str, number: float) -> None:
    assert quantities.fnumber(text) == number


@pytest.mark.parametrize("text", ["0", "-1", "1.4mm", "bright", "nan"])
def test_what_is_no_f_number_is_refused(text: str) -> None:
    with pytest.raises(QuantityError):
        quantities.fnumber(text)


@pytest.mark.parametrize(("text", "degrees"), [("15", 15.0), ("15deg", 15.0), ("-7.5°", -7.5)])
def test_angles_are_degrees_said_or_not(text: str, degrees: float) -> None:
    assert quantities.angle(text) == degrees


@pytest.mark.parametrize("text", ["361", "-1e300deg"])
def test_angles_are_no_more_than_a_turn(text: str) -> None:
    with pytest.raises(QuantityError, match="more than a turn"):
        quantities.angle(text)


@pytest.mark.parametrize("text", ["0.3rad", "x"])
def test_angles_in_other_units_are_refused(text: str) -> None:
    with pytest.raises(QuantityError, match="15deg"):
        quantities.angle(text)


@pytest.mark.parametrize(("text", "count"), [("0", 0), ("3", 3), ("9", 9)])
def test_a_lens_has_no_blades_or_at_least_three(text: str, count: int) -> None:
    assert quantities.blades(text) == count


@pytest.mark.parametrize("text", ["1", "2", "-3", "6.5", "six"])
def test_other_numbers_of_blades_are_refused(text: str) -> None:
    with pytest.raises(QuantityError):
        quantities.blades(text)


def test_a_pixel_is_two_whole_numbers() -> None:
    assert quantities.pixel("240, 135") == (240, 135)
    for text in ("240", "1.5,2", "a,b", "1,2,3"):
        with pytest.raises(QuantityError):
            quantities.pixel(text)


@given(st.floats(1e-3, 1e7))
def test_a_length_written_out_is_read_back(mm: float) -> None:
    assert quantities.length(quantities.length_text(mm, 9)) == pytest.approx(mm, rel=1e-8)


@pytest.mark.parametrize("text", ["1e300mm", "1e31mm", "1e-40m"])
def test_lengths_whose_square_is_no_number_are_refused(text: str) -> None:
    with pytest.raises(QuantityError, match="is no length from 1e-30 to 1e30 mm"):
        quantities.length(text)

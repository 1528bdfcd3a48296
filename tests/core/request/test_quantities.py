"""Quantities are read with their unit, and only with it."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from defocus_core.request import quantities

READ = (
    (quantities.length, {"50mm": 50, "2.5cm": 25, "2m": 2000, "2.3m": 2300, "1in": 25.4}),
    (quantities.length, {"6ft": 1828.8, " 1.2 m ": 1200, ".5M": 500, "1e-1m": 100}),
    (quantities.focus, {"inf": math.inf, "2m": 2000}),
    (quantities.fnumber, {"1.4": 1.4, "f/1.4": 1.4, "F/8": 8}),
    (quantities.angle, {"15": 15, "15deg": 15, "-7.5°": -7.5}),
    (quantities.blades, {"0": 0, "3": 3, "9": 9}),
    (quantities.pixel, {"240, 135": (240, 135)}),
    (quantities.byte_count, {"1GB": 10**9, "1.5 MiB": 3 * 2**19, "4096B": 4096, "2kb": 2000}),
)
# The parser, what it refuses, and what it says of that.
REFUSED = (
    (quantities.length, ["2"], "'2' has no unit; write it with a unit, like 2m or 50mm"),
    (quantities.length, ["", "m", "two metres", "1.2.3m", "nan", "inf"], "is not a length"),
    (quantities.length, ["2yd"], "has an unknown unit"),
    (quantities.length, ["0mm", "-2m"], "is not positive"),
    (quantities.length, ["1e300mm", "1e31mm", "1e-40m"], "is not "),
    (quantities.fnumber, ["0", "-1", "1.4mm", "bright", "nan"], "1.4"),
    (quantities.angle, ["361", "-1e300deg"], "give -360 to 360"),
    (quantities.angle, ["0.3rad", "x"], "15deg"),
    (quantities.blades, ["1", "2"], "make no aperture"),
    (quantities.blades, ["6.5", "six", "-3"], "is not a whole number"),
    (quantities.scale, ["0", "1/0", "1e300/1e-300", "1e-300/1e300"], "is 0 or not finite"),
    (quantities.pixel, ["240", "1.5,2", "a,b", "1,2,3"], "is not a pixel"),
    (quantities.byte_count, ["400", "2e9", "0"], "has no unit; write it with a unit, like 2GB"),
    (quantities.byte_count, ["0B", "-1GB", "1XB", "much", "0.2B"], "like 2GB"),
)


@pytest.mark.parametrize(("parse", "values"), READ)
def test_a_quantity_is_its_number_times_its_unit(parse, values):
    assert {text: parse(text) for text in values} == values


@pytest.mark.parametrize(("parse", "texts", "words"), REFUSED)
def test_what_is_no_such_quantity_is_refused_with_an_example(parse, texts, words):
    for text in texts:
        with pytest.raises(quantities.QuantityError) as raised:
            parse(text)
        assert words in str(raised.value)


@given(st.floats(1e-3, 1e7))
def test_a_length_written_out_is_read_back(mm):
    assert quantities.length(quantities.length_text(mm, 9)) == pytest.approx(mm, rel=1e-8)

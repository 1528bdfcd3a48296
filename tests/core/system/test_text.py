"""Texts for people: durations and shares."""

import pytest

from defocus_core.system.text import duration, percent


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.04, "0.0 s"),
        (2.34, "2.3 s"),
        (42.4, "42 s"),
        (200.0, "3 min 20 s"),
        (7500.0, "2 h 5 min"),
    ],
)
def test_durations_are_told_as_people_do(seconds, words):
    assert duration(seconds) == words


@pytest.mark.parametrize(
    ("share", "words"), [(1.0, "100 %"), (0.995, "100 %"), (0.031, "3.1 %"), (0.0004, "0.04 %")]
)
def test_shares_are_told_in_percent(share, words):
    assert percent(share) == words

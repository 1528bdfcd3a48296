"""Least squares without negative coefficients."""

import pytest

from defocus_cli.fitting import nonnegative


def test_coefficients_that_explain_everything_are_found() -> None:
    rows = [[1.0, 2.0, 0.0], [3.0, 1.0, 0.0], [1e3, 5.0, 0.0], [2.0, 2e2, 0.0]]
    goals = [2e-3 * a + 0.5 * b for a, b, _ in rows]
    assert nonnegative(rows, goals) == pytest.approx([2e-3, 0.5, 0.0])


def test_no_coefficient_is_negative() -> None:
    found = nonnegative([[1.0, 1.0], [1.0, 2.0], [1.0, 3.0]], [3.0, 2.0, 1.0])
    assert found[1] == 0.0
    assert found[0] > 1.0


def test_relative_errors_count() -> None:
    found = nonnegative([[1.0], [100.0]], [1.0, 300.0])
    # the minimum of (x - 1)² + (x / 3 - 1)²
    assert found == pytest.approx([1.2])


def test_what_rows_leave_open_is_as_usual_at_the_speed_they_tell() -> None:
    rows = [[1.0, 1.0, 0.0], [2.0, 2.0, 0.0]]  # only the sum of the first two is told
    found = nonnegative(rows, [6.0, 12.0], usual=[1.0, 2.0, 5.0], trust=0.2)
    assert found == pytest.approx([2.0, 4.0, 10.0])


def test_rows_count_more_than_what_is_usual() -> None:
    found = nonnegative([[1.0, 0.0], [0.0, 1.0]], [4.0, 1.0], usual=[1.0, 1.0], trust=0.1)
    assert found == pytest.approx([4.0, 1.0], rel=0.05)

"""Least squares with coefficients that cannot be negative, for a handful of them."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

_ROUNDS = 4_000
_STILL = 1e-8


def nonnegative(
    rows: Sequence[Sequence[float]],
    goals: Sequence[float],
    usual: Sequence[float] = (),
    trust: float = 0.0,
) -> list[float]:
    """The x >= 0 that brings rows · x nearest to the goals, by relative error.

    Coordinate descent on the normal equations; a column of zeros has the coefficient 0.

    Args:
        rows: One for each goal, of one length.
        goals: All positive.
        usual: What x is proportional to elsewhere, positive: it decides what rows leave open.
        trust: The weight of that, a row having 1.
    """
    shares = [[value / goal for value in row] for row, goal in zip(rows, goals, strict=True)]
    targets = [1.0] * len(shares)
    if usual:
        speed = median(_dot(row, usual) for row in shares)
        for i, value in enumerate(usual):
            shares.append([trust * speed / value if i == k else 0.0 for k in range(len(usual))])
        targets += [trust] * len(usual)
    columns = list(zip(*shares, strict=True))
    scales = [sum(value * value for value in column) ** 0.5 for column in columns]
    unit = [
        [value / scale for value in column] if scale else list(column)
        for column, scale in zip(columns, scales, strict=True)
    ]
    products = [[_dot(one, other) for other in unit] for one in unit]
    wanted = [_dot(column, targets) for column in unit]
    x = [0.0] * len(unit)
    for _ in range(_ROUNDS):
        moved = 0.0
        for i, row in enumerate(products):
            if scales[i]:
                found = max(0.0, x[i] + (wanted[i] - _dot(row, x)))
                moved, x[i] = max(moved, abs(found - x[i])), found
        if moved < _STILL:
            break
    return [value / scale if scale else 0.0 for value, scale in zip(x, scales, strict=True)]


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))

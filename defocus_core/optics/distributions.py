"""Distributions from which options of a lens are drawn, and reproducible draws.

A draw depends on its keys and the name of the option alone, not on other options, other pictures,
the machine or the process. Numbers are rounded to six digits, so that machines whose logarithms
round differently draw the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any

# Greatest number of lenses that are drawn for a picture to find a suitable one.
ATTEMPTS = 100

# The number at a fraction in [0, 1) of the range from low to high.
_RANGES: dict[str, Callable[[float, float, float], float]] = {
    "uniform": lambda low, high, fraction: low + (high - low) * fraction,
    "loguniform": lambda low, high, fraction: low * (high / low) ** fraction,
    "disparity": lambda low, high, fraction: 1 / ((1 - fraction) / low + fraction / high),
    "percentile": lambda low, high, fraction: low + (high - low) * fraction,
}
KINDS = (*_RANGES, "choice")


@dataclass(frozen=True)
class Distribution:
    """The distribution from which the value of a lens option is drawn.

    Attributes:
        kind: "uniform"; "loguniform", uniform in the logarithm; "disparity", uniform in 1/distance;
            "percentile", a percentile of the depth, uniform within 0 to 100; or "choice", every
            value equally likely.
        values: The low and the high end of the range, or the values to choose from. Equal ends fix
            the value; the high end of "disparity" may be inf.
    """

    kind: str
    values: tuple[Any, ...]

    def __post_init__(self) -> None:
        """Check the kind and the values."""
        if self.kind not in KINDS:
            problem = f"a distribution must be one of {', '.join(KINDS)}, got '{self.kind}'"
            raise ValueError(f"{problem}; name one of them")
        object.__setattr__(self, "values", tuple(self.values))
        if self.kind == "choice":
            if not self.values:
                raise ValueError("choice must have values to choose from; give one at least")
            return
        try:
            low, high = map(float, self.values)
        except (TypeError, ValueError):
            limits = f"got {len(self.values)}: {self.values}; give (low, high)"
            raise ValueError(f"{self.kind} must have two numbers as ends, {limits}") from None
        if math.isinf(low) or (math.isinf(high) and self.kind != "disparity"):
            raise ValueError(f"{self.kind} must have finite ends; only disparity reaches infinity")
        if low <= 0 and self.kind in ("loguniform", "disparity"):
            raise ValueError(f"{self.kind} must have ends above 0, got {low:g}; give a higher one")
        if not low <= high:
            ends = f"got {low:g} and {high:g}; give the lower one first"
            raise ValueError(f"{self.kind} must begin at the lower end, {ends}")
        if self.kind == "percentile" and not 0 <= low <= high <= 100:
            ends = f"got {low:g} and {high:g}; like (5, 95)"
            raise ValueError(f"percentile must lie between 0 and 100, {ends}")

    def quantile(self, fraction: float) -> Any:
        """The quantile of the distribution at a fraction in [0, 1)."""
        if self.kind == "choice":
            return self.values[int(fraction * len(self.values))]
        low, high = self.values
        value = float(f"{_RANGES[self.kind](low, high, fraction):.6g}")
        return min(max(value, low), high)


def drawn(options: Mapping[str, Any], *keys: object) -> dict[str, Any]:
    """The value of each option: drawn if it is a `Distribution`, else as given.

    A draw depends on the keys, such as a seed and the name of a picture, and on the option's name.
    """
    return {
        name: option.quantile(_fraction(*keys, name))
        if isinstance(option, Distribution)
        else option
        for name, option in options.items()
    }


def _fraction(*keys: object) -> float:
    """A pseudo-random number in [0, 1) that depends on the keys alone."""
    text = "\0".join(map(str, keys))
    digest = blake2b(text.encode("utf-8", "surrogateescape"), digest_size=8).digest()
    return (int.from_bytes(digest) >> 11) / 2**53


def percentile_rank(percent: float, total: int) -> int:
    """The rank, 1 to `total`, of a percentile (0 to 100) among `total` numbers, rounded up."""
    return min(max(math.ceil(total * (percent / 100)), 1), total)

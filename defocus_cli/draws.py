"""Random lenses that can be drawn again: the same for a seed, a picture's name and an index.

What an option is drawn from is written ``uniform(a, b)``, ``loguniform(a, b)``, ``disparity(a, b)``
(a focus uniform in 1/distance), ``percentile(a, b)`` (a focus uniform in the percentile of the
depth) or ``choice(a, b, …)``. Values have six digits, so that every machine draws the same ones.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b
from typing import Any

from defocus_cli.lens_options import parsed
from defocus_cli.quantities import Percentile, QuantityError, percentage

RANGES = ("uniform", "loguniform", "disparity", "percentile")
KINDS = (*RANGES, "choice")
_CALL = re.compile(r"\s*([a-z]\w*)\s*\((.*)\)\s*", re.I | re.S)
_NOT_RANGED = ("blades", "focus-at")


@dataclass(frozen=True)
class Draw:
    """Which of the random lenses this is.

    Attributes:
        seed: what the user chose.
        picture: the picture's name.
        index: which of the draws for it.
        options: all options of the lens as texts, those that are drawn and those that are not.
        attempt: how many draws did not suit the picture before this one.
    """

    seed: int
    picture: str
    index: int
    options: tuple[tuple[str, str], ...]
    attempt: int = 0

    def values(self) -> dict[str, Any]:
        """Options of the lens, parsed; each drawn by itself, whatever else is drawn."""
        values = {}
        for name, text in self.options:
            drawn = distribution(name, text)
            values[name] = parsed(name, text) if drawn is None else drawn.at(self._share(name))
        return values

    def _share(self, name: str) -> float:
        """A number in [0, 1) that is as good as random."""
        key = f"{self.seed}\0{self.picture}\0{self.index}\0{self.attempt}\0{name}"
        digest = blake2b(key.encode("utf-8", "surrogateescape"), digest_size=8).digest()
        return (int.from_bytes(digest) >> 11) / 2**53


@dataclass(frozen=True)
class Distribution:
    """What an option is drawn from: the ends of a range, or all the values to choose from."""

    kind: str
    values: tuple[Any, ...]

    @property
    def extremes(self) -> tuple[Any, Any]:
        """The least and the greatest value, percentiles aside."""
        plain = [value for value in self.values if not isinstance(value, Percentile)]
        return (min(plain), max(plain)) if plain and self.kind != "percentile" else (None, None)

    def at(self, share: float) -> Any:
        """The value at a share in [0, 1) of the distribution."""
        if self.kind == "choice":
            return self.values[int(share * len(self.values))]
        low, high = self.values
        if self.kind == "loguniform":
            value = low * (high / low) ** share
        elif self.kind == "disparity":
            value = 1 / ((1 - share) / low + share / high)
        else:
            value = low + (high - low) * share
        value = min(max(float(f"{value:.6g}"), low), high)
        return Percentile(value) if self.kind == "percentile" else value


@lru_cache(maxsize=4096)
def distribution(name: str, text: str) -> Distribution | None:
    """What the option ``name`` is drawn from; None if the text is a plain value.

    Raises:
        QuantityError: the text makes no sense.
    """
    found = _CALL.fullmatch(text)
    if not found:
        return None
    kind, words = found[1].lower(), found[2].split(",")
    if kind == "percentile" and len(words) == 1:
        return None
    if kind not in KINDS:
        known = ", ".join(f"{kind}(…)" for kind in KINDS)
        raise QuantityError(f"'{kind}' is no way to draw", f"use one of {known}")
    if kind == "choice":
        return Distribution(kind, tuple(parsed(name, word.strip()) for word in words))
    if name in _NOT_RANGED:
        raise QuantityError(f"{name} is not drawn from a range", "write choice(…)")
    if kind in ("disparity", "percentile") and name != "focus":
        raise QuantityError(f"{kind} is for the focus only", "write uniform(…) or loguniform(…)")
    if len(words) != 2:
        problem = f"{kind} has {len(words)} ends"
        raise QuantityError(problem, f"give it two, like {_example(kind, name)}")
    return Distribution(kind, _ends(kind, name, words))


def _ends(kind: str, name: str, words: list[str]) -> tuple[float, float]:
    if kind == "percentile":
        low, high = (percentage(word) for word in words)
    else:
        low, high = (parsed(name, word.strip()) for word in words)
    if any(isinstance(end, Percentile) for end in (low, high)):
        raise QuantityError("a percentile is no end of a range", "write percentile(5, 95)")
    if math.isinf(low) or (math.isinf(high) and kind != "disparity"):
        raise QuantityError(f"{kind} cannot reach infinity", "write disparity(2m, inf)")
    if kind == "loguniform" and low <= 0:
        raise QuantityError("loguniform needs ends above 0", "write uniform(…)")
    if not low < high:
        problem = f"{words[0].strip()} is not less than {words[1].strip()}"
        raise QuantityError(problem, "write the smaller end first")
    return low, high


def _example(kind: str, name: str) -> str:
    ends = "5, 95" if kind == "percentile" else "1m, 4m" if name == "focus" else "…, …"
    return f"{kind}({ends})"

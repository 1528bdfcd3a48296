"""Random lenses of a jobs file: their number and their distributions, from ``[sample]``.

``n`` lenses for each picture and each lens of the sweep, numbered in their names: ``_s000``. What
is drawn depends on ``seed`` and that name alone, not on other pictures, values or draws. What an
option is drawn from is written ``uniform(a, b)``, ``loguniform(a, b)``, ``disparity(a, b)`` (a
focus uniform in 1/distance), ``percentile(a, b)`` (a focus uniform in the percentile of the depth)
or ``choice(a, b, …)``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

from defocus_core.batch.jobs.lens_from_options import lens_of, parsed, refuse_contradiction
from defocus_core.batch.jobs.toml_file import Table
from defocus_core.batch.lenses.lens import Draw, Lens
from defocus_core.batch.lenses.parameters import LENS_OPTIONS
from defocus_core.batch.lenses.quantities import (
    Percentile,
    QuantityError,
    percentage,
    read_at,
    text_of,
)
from defocus_core.errors import Place, UsageProblem, reason

if TYPE_CHECKING:
    from defocus_core.optics.distributions import Distribution

KEYS = ("n", "seed", "max-coc", *LENS_OPTIONS)
_CALL = re.compile(r"\s*([a-z]\w*)\s*\((.*)\)\s*", re.I | re.S)


def drawn_lens(draw: Draw, source: Place, max_coc: float | None) -> Lens:
    """The lens of a draw.

    `max_coc`: largest CoC radius in px that it may have in its picture.
    """
    from defocus_core.optics.distributions import drawn

    options = {name: distribution(name, text) or parsed(name, text) for name, text in draw.options}
    values = drawn(options, draw.seed, draw.picture, draw.index, draw.attempt)
    if getattr(options.get("focus"), "kind", "") == "percentile":
        values["focus"] = Percentile(values["focus"])
    return replace(lens_of(values, source), max_coc=max_coc, draw=draw)


@dataclass(frozen=True)
class Sampling:
    """How many lenses are drawn for a picture, and what each option is drawn from, as texts."""

    count: int = 0
    seed: int = 0
    options: Mapping[str, str] = field(default_factory=dict)


def read_sampling(table: Table) -> Sampling:
    """The sampling of ``[sample]``; a count of 0 if there is no such table."""
    if not table.values:
        return Sampling()
    table.refuse_unknown(KEYS)
    count, seed = table.whole("n", 1), table.whole("seed", 0)
    if count is None or seed is None:
        key = "n" if count is None else "seed"
        raise UsageProblem(
            "missing-option", "is missing", f"write {key} = 7 below [sample]", path=table.place(key)
        )
    options = {name: text_of(table.values[name]) for name in LENS_OPTIONS if name in table.values}
    refuse_contradiction(options, table.place())
    for name, text in options.items():
        if read_at(table.place(name), distribution, name, text) is None:
            remedy = "put it below [lens], or write it like uniform(a, b) or choice(a, b)"
            raise UsageProblem(
                "malformed", f"'{text}' is no distribution", remedy, path=table.place(name)
            )
    if not options:
        remedy = 'write fnumber = "loguniform(1.4, 16)" below [sample]'
        raise UsageProblem(
            "idle-option", "draws no option of the lens", remedy, path=table.file, field="[sample]"
        )
    return Sampling(count, seed, options)


@lru_cache(maxsize=4096)
def distribution(name: str, text: str) -> Distribution | None:
    """The distribution that an option is drawn from; None if the text is a plain value."""
    call = _CALL.fullmatch(text)
    if not call:
        return None
    kind, words = call[1].lower(), [word.strip() for word in call[2].split(",")]
    if kind == "percentile" and len(words) == 1:
        return None
    from defocus_core.optics.distributions import Distribution

    if kind != "choice" and not LENS_OPTIONS[name].is_ranged:
        raise QuantityError(f"{name} is not drawn from a range", "write choice(…)")
    if kind in ("disparity", "percentile") and name != "focus":
        raise QuantityError(f"{kind} is for the focus only", "write uniform(…) or loguniform(…)")
    values = tuple(percentage(w) if kind == "percentile" else parsed(name, w) for w in words)
    if kind != "choice" and any(isinstance(value, Percentile) for value in values):
        raise QuantityError("a percentile is no end of a range", "write percentile(5, 95)")
    try:
        return Distribution(kind, values)
    except ValueError as error:
        raise QuantityError(f"'{text}' is no distribution: {reason(error)}", "") from None

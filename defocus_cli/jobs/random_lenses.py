"""Random lenses of a jobs file: their number and their distributions, from ``[sample]``.

``n`` lenses for each picture and each lens of the sweep, numbered in their names: ``_s000``. What
is drawn depends on ``seed``, the picture's name and that number alone, not on other pictures or
draws. What an option is drawn from is written ``uniform(a, b)``, ``loguniform(a, b)``,
``disparity(a, b)`` (a focus uniform in 1/distance), ``percentile(a, b)`` (a focus uniform in the
percentile of the depth) or ``choice(a, b, …)``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

from defocus_cli.jobs.lens_options import PARSERS, lens_of, parsed, refuse_contradiction
from defocus_cli.jobs.toml_file import Table
from defocus_cli.lenses.lens import Draw, Lens
from defocus_cli.lenses.quantities import Percentile, QuantityError, percentage, read_at, text_of
from defocus_cli.system.errors import UsageProblem, reason

if TYPE_CHECKING:
    from defocus_core import Distribution

KEYS = ("n", "seed", "max-coc", *PARSERS)
_CALL = re.compile(r"\s*([a-z]\w*)\s*\((.*)\)\s*", re.I | re.S)
_NOT_RANGED = (
    *("blades", "focus-at", "aperture-image", "sharp-range"),
    *("dp-model", "cat-eye", "axial-color", "vignetting", "noise", "noise-seed", "highlights"),
)


def drawn_lens(draw: Draw, source: str, max_coc: float | None) -> Lens:
    """The lens of a draw.

    Args:
        draw: its seed, picture, number and options.
        source: how errors about the focus begin.
        max_coc: largest CoC radius in px that it may have in its picture.
    """
    from defocus_core import drawn

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
    """The sampling of ``[sample]``; a count of 0 if there is no such table.

    Raises:
        UsageProblem: a key is unknown or missing, or a distribution makes no sense.
    """
    if not table.values:
        return Sampling()
    table.refuse_unknown(KEYS)
    count, seed = table.whole("n", 1), table.whole("seed", 0)
    if count is None or seed is None:
        key = "n" if count is None else "seed"
        raise UsageProblem(table.place(key), "is missing", f"write {key} = 7 below [sample]")
    options = {name: text_of(table.values[name]) for name in PARSERS if name in table.values}
    refuse_contradiction(options, f"{table.file}: [sample] ")
    for name, text in options.items():
        if read_at(table.place(name), distribution, name, text) is None:
            remedy = "put it below [lens], or write it like uniform(a, b) or choice(a, b)"
            raise UsageProblem(table.place(name), f"'{text}' is nothing to draw from", remedy)
    if not options:
        remedy = 'write fnumber = "loguniform(1.4, 16)" below [sample]'
        raise UsageProblem(f"{table.file}: [sample]", "draws no option of the lens", remedy)
    return Sampling(count, seed, options)


@lru_cache(maxsize=4096)
def distribution(name: str, text: str) -> Distribution | None:
    """The distribution that an option is drawn from; None if the text is a plain value.

    Raises:
        QuantityError: the text makes no sense.
    """
    call = _CALL.fullmatch(text)
    if not call:
        return None
    kind, words = call[1].lower(), [word.strip() for word in call[2].split(",")]
    if kind == "percentile" and len(words) == 1:
        return None
    from defocus_core import Distribution

    if kind != "choice" and name in _NOT_RANGED:
        raise QuantityError(f"{name} is not drawn from a range", "write choice(…)")
    if kind in ("disparity", "percentile") and name != "focus":
        raise QuantityError(f"{kind} is for the focus only", "write uniform(…) or loguniform(…)")
    values = tuple(percentage(w) if kind == "percentile" else parsed(name, w) for w in words)
    if kind != "choice" and any(isinstance(value, Percentile) for value in values):
        raise QuantityError("a percentile is no end of a range", "write percentile(5, 95)")
    try:
        return Distribution(kind, values)
    except ValueError as error:
        raise QuantityError(f"'{text}' is nothing to draw from: {reason(error)}", "") from None

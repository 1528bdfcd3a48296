"""Random lenses of a jobs file: ``[sample]`` says how many for each picture, and drawn from what.

``n`` lenses for each picture and each lens of the sweep, numbered in their names: ``_s000``. What
is drawn depends on ``seed``, the picture's name and that number alone, not on other pictures or
draws.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from defocus_cli.draws import distribution
from defocus_cli.errors import UsageProblem
from defocus_cli.lens_options import PARSERS, refuse_both, text_of
from defocus_cli.quantities import QuantityError
from defocus_cli.toml_file import Table

KEYS = ("n", "seed", "max-coc", *PARSERS)
MOST_DRAWS = 1_000_000


@dataclass(frozen=True)
class Sampling:
    """How many lenses are drawn for a picture, and what each option is drawn from, as texts."""

    count: int = 0
    seed: int = 0
    options: Mapping[str, str] = field(default_factory=dict)


def read_sampling(table: Table) -> Sampling:
    """What ``[sample]`` asks for; a count of 0 if there is no such table.

    Raises:
        UsageProblem: a key is unknown or missing, or a distribution makes no sense.
    """
    if not table.values:
        return Sampling()
    table.refuse_unknown(KEYS)
    count, seed = table.whole("n", 1), table.whole("seed", 0)
    for key, value in (("n", count), ("seed", seed)):
        if value is None:
            raise UsageProblem(table.place(key), "is missing", f"write {key} = 7 below [sample]")
    assert count is not None
    assert seed is not None
    if count > MOST_DRAWS:
        raise UsageProblem(table.place("n"), f"{count} is too many", f"at most {MOST_DRAWS}")
    options = {name: text_of(table.values[name]) for name in PARSERS if name in table.values}
    refuse_both(options, f"{table.file}: [sample] ")
    for name, text in options.items():
        _require_distribution(name, text, table.place(name))
    if not options:
        remedy = 'write fnumber = "loguniform(1.4, 16)" below [sample]'
        raise UsageProblem(f"{table.file}: [sample]", "draws no option of the lens", remedy)
    return Sampling(count, seed, options)


def _require_distribution(name: str, text: str, where: str) -> None:
    try:
        found = distribution(name, text)
    except QuantityError as error:
        raise UsageProblem(where, error.problem, error.remedy) from None
    if found is None:
        remedy = "put it below [lens], or write it like uniform(a, b) or choice(a, b)"
        raise UsageProblem(where, f"'{text}' is nothing to draw from", remedy)

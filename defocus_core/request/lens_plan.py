"""The lenses of each picture: ``[lens]``, the picture's own options, the sweep and the draws.

An option is set in one place, as it would be ignored in another. Only a picture's own options win
over ``[lens]``, and ``[lens]`` over its lens file.

``[sweep]`` gives an option a list of values, or a range like ``0.5m..8m @ 12 in disparity``;
several options make a grid. ``lenses`` lists sets of options that belong together. The name of a
lens holds what is swept and nothing else, so that it stays when a list grows.

``[sample]`` draws ``n`` lenses for each picture and each lens of the sweep, numbered in their
names: ``_s000``. What is drawn depends on ``seed`` and that name alone. An option is drawn from
``uniform(a, b)``, ``loguniform(a, b)``, ``disparity(a, b)`` (a focus uniform in 1/distance),
``percentile(a, b)`` (a focus uniform in the percentile of the depth) or ``choice(a, b, …)``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import groupby, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_core.errors import Place, UsageProblem, reason
from defocus_core.request.inputs import Entry
from defocus_core.request.lens import Draw, Lens
from defocus_core.request.lens_from_options import (
    based,
    checked,
    lens_of,
    lens_path,
    merged,
    parsed,
    read_lens_file,
    refuse_contradiction,
    refuse_lens_file,
    refuse_optics,
    refuse_unusable,
    shape_of,
)
from defocus_core.request.parameters import LENS_OPTIONS, METADATA, SCALES, alternatives
from defocus_core.request.quantities import (
    Percentile,
    QuantityError,
    percentage,
    pixel_count,
    read_at,
    short,
    text_of,
)
from defocus_core.request.toml_file import Table, refuse_unknown

if TYPE_CHECKING:
    from defocus_core.optics.distributions import Distribution


KEYS = (*LENS_OPTIONS, "file", "max-coc", METADATA)


@dataclass(frozen=True)
class LensPlan:
    """The lenses that take each picture."""

    source: Place
    options: Mapping[str, str]  # options of all lenses, as texts
    points: Sequence[Point]  # the lenses of the sweep
    sampling: Sampling  # the options that are drawn, for each point
    max_coc: float | None  # largest CoC radius in px that a lens may have; None for any
    # Options that are swept or drawn, and the name of the table that says so
    taken: Mapping[str, str]
    # The depth files hold radii, so that a lens is the shape of its opening alone
    radii: bool = False

    @property
    def count(self) -> int:
        """How many lenses take each picture."""
        return len(self.points) * max(self.sampling.count, 1)

    @property
    def suffixes(self) -> list[str]:
        """What each lens adds to the name of a sample."""
        draws = [f"_s{index:03}" for index in range(self.sampling.count)] or [""]
        return [point.suffix + draw for point in self.points for draw in draws]

    def lenses(self, entry: Entry, numbers: Iterable[int]) -> Iterator[tuple[str, Lens]]:
        """The suffix of each lens for the name of the sample, and the lens.

        `numbers`: which of the lenses, ascending from 0.
        """
        own = entry.options
        _refuse_taken(own, self.taken, entry.where)
        shared = merged(merged(self.options, self.sampling.options), own)
        source = entry.where if own else self.source
        if self.radii:
            refuse_optics(own, source)
        draws, stem = self.sampling.count, entry.picture.stem
        for which, mine in groupby(numbers, lambda number: number // max(draws, 1)):
            point = self.points[which]
            texts = tuple(merged(shared, point.options).items())
            if not draws:
                yield point.suffix, _lens(texts, source, self.max_coc, radii=self.radii)
                continue
            _check_lens(dict(texts), source, radii=self.radii)
            for index in (number % draws for number in mine):
                draw = Draw(self.sampling.seed, stem + point.suffix, index, texts)
                yield f"{point.suffix}_s{index:03}", drawn_lens(draw, source, self.max_coc)


def read_plan(lens: Table, sweep: Table, sample: Table, *, radii: bool = False) -> LensPlan:
    """The lenses that ``[lens]``, ``[sweep]`` and ``[sample]`` ask for.

    `lens`: ``[lens]``; `sweep`: ``[sweep]``; `sample`: ``[sample]``.
    """
    lens.refuse_unknown(KEYS)
    entry_options = {
        name: based(name, checked(name, lens.values[name], lens.place(name)), lens.file)
        for name in LENS_OPTIONS
        if name in lens.values
    }
    refuse_contradiction(entry_options, lens.place())
    points, sampling = read_sweep(sweep), read_sampling(sample)
    taken = {
        same: sweep.name
        for point in points
        for name in point.options
        for same in alternatives(name)
    }
    _refuse_taken(sampling.options, taken, sample.place())
    taken |= {same: sample.name for name in sampling.options for same in alternatives(name)}
    _refuse_taken(entry_options, taken, lens.place())
    file = lens_file_of(lens)
    stored = {} if file is None else read_lens_file(file)
    swept = [name for point in points for name in point.options]
    in_pixels = "blur" in {*stored, *entry_options, *swept, *sampling.options}
    if radii:
        refuse_optics(entry_options, lens.place())
        refuse_optics(swept, sweep.place())
        refuse_optics(sampling.options, sample.place())
    if in_pixels:
        refuse_lens_file(stored, file, lens.place("file"))
    elif radii:
        stored = shape_of(stored)
    return LensPlan(
        source=Place(lens.file),
        options=merged(stored, entry_options),
        points=points,
        sampling=sampling,
        max_coc=_max_coc(lens, sample),
        taken=taken,
        radii=radii,
    )


@lru_cache(maxsize=4096)
def _lens(
    options: tuple[tuple[str, str], ...], source: Place, max_coc: float | None, *, radii: bool
) -> Lens:
    """The lens of options as texts, which pictures share."""
    _check_lens(dict(options), source, radii=radii)
    values = {name: parsed(name, text) for name, text in options}
    return replace(lens_of(values, source), max_coc=max_coc)


def lens_file_of(lens: Table) -> Path | None:
    """The lens file that ``[lens]`` names, relative to the jobs file, or one that ships."""
    name = lens.text("file")
    return None if name is None else lens.file.parent / lens_path(Path(name), lens.place("file"))


def _max_coc(lens: Table, sample: Table) -> float | None:
    if "max-coc" in sample.values:
        _refuse_taken(lens.values, {"max-coc": sample.name}, lens.place())
    table = sample if "max-coc" in sample.values else lens
    return table.parsed("max-coc", pixel_count)


def _check_lens(options: Mapping[str, str], source: Place, *, radii: bool) -> None:
    """Refuse a lens that cannot be, of options as texts, which may be drawn."""
    if "blur" in options:
        refuse_optics(options, source, in_pixels=True)
    values: dict[str, Sequence[Any]] = {}
    for name, text in options.items():
        drawn = distribution(name, text)
        by_depth = drawn is not None and drawn.kind == "percentile"
        values[name] = () if by_depth else (parsed(name, text),) if drawn is None else drawn.values
    refuse_unusable(values, dict.fromkeys(options, source), source, radii)


def _refuse_taken(options: Iterable[str], taken: Mapping[str, str], source: Place) -> None:
    """Refuse options that another table of the jobs file sets, too."""
    for name in options:
        if name in taken:
            raise UsageProblem(
                "contradiction", f"is in [{taken[name]}], too", "remove one", path=source.at(name)
            )


MAX_LENSES = 100_000
_RANGE = re.compile(r"(.+?)\.\.(.+?)@\s*(\d{1,6})\s*(?:in\s+(\w+)\s*)?")
_RANGE_EXAMPLE = "write it like 0.5m..8m @ 12 in disparity"


@dataclass(frozen=True)
class Point:
    """One lens of a sweep: the suffix of its samples, and its swept options as texts."""

    suffix: str
    options: Mapping[str, str]


def read_sweep(table: Table) -> list[Point]:
    """The lenses of ``[sweep]``, the first option slowest; one without options if empty."""
    table.refuse_unknown((*LENS_OPTIONS, "lenses"))
    axes = [_sets(table)] if "lenses" in table.values else []
    for name in LENS_OPTIONS:
        if name in table.values:
            texts = _values(name, table.values[name], table.place(name), table.file)
            _refuse_many(math.prod(map(len, axes)) * len(texts), table.place())
            axes.append([{name: text} for text in texts])
    return _points(table, axes)


def _refuse_many(count: int, where: Place) -> None:
    if count > MAX_LENSES:
        problem = f"makes {count} lenses for each picture"
        raise UsageProblem("out-of-range", problem, f"ask for at most {MAX_LENSES}", path=where)


def _points(table: Table, axes: Sequence[Sequence[Mapping[str, str]]]) -> list[Point]:
    points: dict[str, Point] = {}
    for combination in product(*axes):
        options: dict[str, str] = {}
        for part in combination:
            twice = next((name for name in part if name in options), None)
            if twice is not None:
                problem = "is in lenses, too"
                raise UsageProblem(
                    "contradiction", problem, "sweep it in one place", path=table.place(twice)
                )
            options |= part
        refuse_contradiction(options, table.place())
        rows = (row for name, row in LENS_OPTIONS.items() if name in options)
        suffix = "".join(f"_{row.file_tag(parsed(row.name, options[row.name]))}" for row in rows)
        if suffix in points:
            problem = f"has two lenses named '{suffix[1:]}'"
            raise UsageProblem(
                "contradiction", problem, "remove one of them", path=table.file, field="[sweep]"
            )
        points[suffix] = Point(suffix, options)
    return list(points.values())


def _values(name: str, value: object, where: Place, file: Path) -> list[str]:
    """Texts of the values of one option."""
    if isinstance(value, str) and ".." in value:
        return _range(name, value, where)
    if not isinstance(value, list) or not value:
        remedy = f"write a list, or a range: {_RANGE_EXAMPLE.removeprefix('write it ')}"
        raise UsageProblem("malformed", f"{value!r} is no list of values", remedy, path=where)
    _refuse_many(len(value), where)
    return [based(name, checked(name, one, where), file) for one in value]


def _sets(table: Table) -> list[dict[str, str]]:
    sets, where = table.values["lenses"], table.place("lenses")
    if not isinstance(sets, list) or not sets or not all(isinstance(one, dict) for one in sets):
        remedy = 'write lenses = [{focus = "1m", fnumber = 2}, {focus = "2m", fnumber = 4}]'
        raise UsageProblem("malformed", "is no list of lenses", remedy, path=where)
    _refuse_many(len(sets), where)
    refuse_unknown((name for one in sets for name in one), tuple(LENS_OPTIONS), where, "a lens")
    return [
        {
            name: based(name, checked(name, value, where.at(f"lenses: {name}")), table.file)
            for name, value in one.items()
        }
        for one in sets
    ]


def _range(name: str, text: str, where: Place) -> list[str]:
    """Texts of the values of a range; its ends are as they are written, values between rounded."""
    match = _RANGE.fullmatch(read_at(where, short, text).strip())
    if not match:
        raise UsageProblem("malformed", f"'{text}' is no range", _RANGE_EXAMPLE, path=where)
    low, high = (_end(name, match[side].strip(), where) for side in (1, 2))
    row = LENS_OPTIONS[name]
    fit = ("disparity", "depth", "log") if row.even_in == "disparity" else ("steps", "log")
    count, scale = int(match[3]), match[4] or fit[0]
    for wrong, problem, remedy in (
        (scale not in fit, f"{name} has no steps in {scale}", f"write in {' or in '.join(fit)}"),
        (count < 2, f"{count} is no number of steps", "give 2 or more, both ends count"),
        (
            scale != "disparity" and math.inf in (low, high),
            f"cannot reach inf in {scale}",
            "write in disparity",
        ),
        (scale == "log" and min(low, high) <= 0, "needs ends above 0 in log", "write in steps"),
    ):
        if wrong:
            raise UsageProblem("malformed", problem, remedy, path=where)
    _refuse_many(count, where)
    to, back = SCALES[scale]
    fractions = (index / (count - 1) for index in range(1, count - 1))
    between = [back((1 - fraction) * to(low) + fraction * to(high)) for fraction in fractions]
    values = [low, *(float(f"{value:.6g}") for value in between), high]
    return [checked(name, row.text(value), where) for value in values]


def _end(name: str, text: str, where: Place) -> float:
    value: Any = parsed(name, checked(name, text, where))
    if isinstance(value, Percentile | tuple | Path | str):
        raise UsageProblem(
            "malformed", f"'{text}' is no end of a range", "write a list of values", path=where
        )
    return float(value)


_SAMPLE_KEYS = ("n", "seed", "max-coc", *LENS_OPTIONS)
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
    table.refuse_unknown(_SAMPLE_KEYS)
    count, seed = table.integer("n", 1), table.integer("seed", 0)
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

"""The lenses of each picture: ``[lens]``, the picture's own options, the sweep and the draws.

An option is set in one place, as it would be ignored in another. Only a picture's own options win
over ``[lens]``, and ``[lens]`` over its lens file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any

from defocus_core.batch.jobs.inputs import Entry
from defocus_core.batch.jobs.lens_from_options import (
    based,
    checked,
    lens_of,
    merged,
    parsed,
    read_lens_file,
    refuse_contradiction,
    refuse_idle,
    refuse_lens_file,
    refuse_missing,
    refuse_near_focus,
    refuse_optics,
    refuse_unfocused,
    shape_of,
)
from defocus_core.batch.jobs.random_lenses import (
    Sampling,
    distribution,
    drawn_lens,
    read_sampling,
)
from defocus_core.batch.jobs.sweep import Point, read_sweep
from defocus_core.batch.jobs.toml_file import Table
from defocus_core.batch.lenses.lens import Draw, Lens
from defocus_core.batch.lenses.parameters import LENS_OPTIONS, METADATA, alternatives
from defocus_core.batch.lenses.quantities import Percentile, pixel_count
from defocus_core.batch.lenses.shipped_lenses import lens_path
from defocus_core.errors import Place, UsageProblem

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
    """Refuse a lens without a required option, with a useless one, or that may focus too near."""
    if "blur" in options:
        refuse_optics(options, source, in_pixels=True)
        refuse_unfocused(options, source)
    elif not radii:
        refuse_missing(options, source)
        nearest = min(_distances(options, "focus"), default=math.inf)
        longest = max(_distances(options, "focal-length"))
        refuse_near_focus(nearest, longest, source.at("focus"))
    for name in options:
        refuse_idle(LENS_OPTIONS[name], lambda of: any(_extremes(options, of)), source)


def _distances(options: Mapping[str, str], name: str) -> list[float]:
    """The lengths that an option can get in mm, or the ends of their range."""
    return [each for each in _extremes(options, name) if not isinstance(each, Percentile)]


def _extremes(options: Mapping[str, str], name: str) -> tuple[Any, ...]:
    """The values that an option can get, or the ends of their range; none if the depth decides."""
    if name not in options:
        return ()
    drawn = distribution(name, options[name])
    if drawn is not None and drawn.kind == "percentile":
        return ()
    return (parsed(name, options[name]),) if drawn is None else drawn.values


def _refuse_taken(options: Iterable[str], taken: Mapping[str, str], source: Place) -> None:
    """Refuse options that another table of the jobs file sets, too."""
    for name in options:
        if name in taken:
            raise UsageProblem(
                "contradiction", f"is in [{taken[name]}], too", "remove one", path=source.at(name)
            )

"""The lenses that take a picture: ``[lens]``, the picture's own options, sweep and draws.

An option stands in one place, or it would be ignored in another; only a picture's own options win
over ``[lens]``, and ``[lens]`` over the lens file that it names.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from defocus_cli.jobs.inputs import Entry
from defocus_cli.jobs.job import Lens
from defocus_cli.jobs.lens_file import lens_of, read_lens_file, refuse_near_focus
from defocus_cli.jobs.lens_options import (
    ALTERNATIVES,
    EXAMPLES,
    PARSERS,
    merged,
    parsed,
    refuse_both,
    refuse_idle_turn,
    text_of,
    written,
)
from defocus_cli.jobs.quantities import Percentile, QuantityError, pixel_count
from defocus_cli.jobs.random_lenses import Draw, Sampling, distribution, read_sampling
from defocus_cli.jobs.sweep import Point, read_sweep
from defocus_cli.jobs.toml_file import Table
from defocus_cli.system.errors import UsageProblem

KEYS = (*PARSERS, "file", "max-coc")
Named = tuple[str, Lens]


@dataclass(frozen=True)
class LensPlan:
    """What the lenses of all pictures have in common."""

    place: str  # of [lens], for errors
    options: Mapping[str, str]
    points: tuple[Point, ...]
    sampling: Sampling
    max_coc: float | None
    taken: Mapping[str, str]  # options that are swept or drawn, and the table that says so

    @property
    def count(self) -> int:
        """How many lenses take each picture."""
        return len(self.points) * max(self.sampling.count, 1)

    def check(self, entry: Entry) -> None:
        """Refuse a picture's own options if they make no sense, or are swept or drawn.

        Raises:
            UsageProblem: naming the picture's place.
        """
        for name, text in entry.options.items():
            _parsed(name, text, f"{entry.where}: {name}")
            if name in self.taken:
                problem = f"is in [{self.taken[name]}], too"
                raise UsageProblem(f"{entry.where}: {name}", problem, "remove one of them")
        refuse_both(entry.options, f"{entry.where}: ")

    def lenses(self, entry: Entry) -> Iterator[Named]:
        """What each lens adds to the picture's name, and the lens.

        Raises:
            UsageProblem: an option is missing, or the focus is too near.
        """
        shared = merged(merged(self.options, self.sampling.options), entry.options)
        for point in self.points:
            options = merged(shared, point.options)
            place = entry.where if entry.options else self.place
            _check_lens(options, place)
            if self.sampling.count:
                yield from self._drawn(entry.picture.stem, point.suffix, options, place)
            else:
                values = {name: parsed(name, text) for name, text in options.items()}
                lens = lens_of(values, _source(place))
                yield point.suffix, dataclasses.replace(lens, max_coc=self.max_coc)

    def _drawn(
        self, picture: str, suffix: str, options: Mapping[str, str], place: str
    ) -> Iterator[Named]:
        """Lenses that were drawn, and from what: the depth may ask for another draw."""
        texts = tuple(options.items())
        for index in range(self.sampling.count):
            draw = Draw(self.sampling.seed, picture, index, texts)
            lens = lens_of(draw.values(), _source(place))
            lens = dataclasses.replace(lens, max_coc=self.max_coc, draw=draw)
            yield f"{suffix}_s{index:03}", lens


def read_plan(lens: Table, sweep: Table, sample: Table) -> LensPlan:
    """What ``[lens]``, ``[sweep]`` and ``[sample]`` ask for.

    Raises:
        InputError: the lens file cannot be read.
        UsageProblem: a key is unknown, a value makes no sense or two contradict each other.
    """
    lens.refuse_unknown(KEYS)
    own = {name: text_of(lens.values[name]) for name in PARSERS if name in lens.values}
    refuse_both(own, f"{lens.file}: [lens] ")
    for name, text in own.items():
        _parsed(name, text, lens.place(name))
    points, sampling = tuple(read_sweep(sweep)), read_sampling(sample)
    taken: dict[str, str] = {}
    swept = {name for point in points for name in point.options}
    for table, names in ((sweep, swept), (sample, sampling.options), (lens, own)):
        for name in names:
            if name in taken:
                problem = f"is in [{taken[name]}], too"
                raise UsageProblem(table.place(name), problem, "remove one of them")
        if table is not lens:
            taken |= {same: table.name for name in names for same in _same(name)}
    return LensPlan(
        place=f"{lens.file}: [lens]",
        options=merged(_from_lens_file(lens), own),
        points=points,
        sampling=sampling,
        max_coc=_max_coc(lens, sample),
        taken=taken,
    )


def _from_lens_file(lens: Table) -> dict[str, str]:
    name = lens.text("file")
    if name is None:
        return {}
    stored = read_lens_file(lens.file.parent / name)
    return {option: written(option, value) for option, value in stored.items()}


def _max_coc(lens: Table, sample: Table) -> float | None:
    given = [table for table in (lens, sample) if "max-coc" in table.values]
    if len(given) > 1:
        raise UsageProblem(lens.place("max-coc"), "is in [sample], too", "remove one of them")
    for table in given:
        try:
            return pixel_count(text_of(table.values["max-coc"]))
        except QuantityError as error:
            raise UsageProblem(table.place("max-coc"), error.problem, error.remedy) from None
    return None


def _check_lens(options: Mapping[str, str], place: str) -> None:
    """Refuse a lens that lacks an option, has one in vain, or could be focused too near."""
    for name, other in (("focal-length", None), *ALTERNATIVES):
        if name not in options and other not in options:
            example = EXAMPLES[name] if name == "fnumber" else f'"{EXAMPLES[name]}"'
            told = f"{name}, nor {other}" if other else name
            raise UsageProblem(place, f"has no {told}", f"write {name} = {example}")
    nearest, longest = _extreme(options, "focus", 0), _extreme(options, "focal-length", 1)
    if nearest is not None and longest is not None:
        refuse_near_focus(nearest, longest, f"{_source(place)}focus")
    turned = any(_extreme(options, "blade-rotation", side) for side in (0, 1))
    refuse_idle_turn(turned, _extreme(options, "blades", 1), _source(place))


def _source(place: str) -> str:
    """The file of a place, as errors begin with it."""
    return f"{place.partition(': [')[0]}: "


def _extreme(options: Mapping[str, str], name: str, side: int) -> float | None:
    """The least (0) or greatest (1) value that an option can get; None if the depth decides."""
    if name not in options:
        return None
    drawn = distribution(name, options[name])
    if drawn is not None and drawn.kind == "percentile":
        return None
    values = (parsed(name, options[name]),) if drawn is None else drawn.values
    plain = [float(value) for value in values if not isinstance(value, Percentile)]
    return (min, max)[side](plain, default=None)


def _parsed(name: str, text: str, where: str) -> Any:
    try:
        return parsed(name, text)
    except QuantityError as error:
        raise UsageProblem(where, error.problem, error.remedy) from None


def _same(name: str) -> set[str]:
    """The option and the other way to say the same."""
    return {name}.union(*(pair for pair in ALTERNATIVES if name in pair))

"""The lenses for each picture of a batch, from all layers of options.

These layers give lens options; later ones override earlier ones:

  1. the lens file
  2. metadata of the picture
  3. keyframes, at the frame of the picture
  4. options for all pictures, from the command line or ``[lens]``
  5. options in the row of the picture in a list
  6. random draws and sweeps

An option that is animated, drawn or swept must not be set in layers 4 and 5.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

from defocus_core.errors import CALLER, Place, UsageProblem
from defocus_core.io.depth_formats.table import UNITS
from defocus_core.request.job import PictureFiles, Reading
from defocus_core.request.lens import Draw, LensValues
from defocus_core.request.parameters import METADATA
from defocus_core.request.resolver import (
    Given,
    Layer,
    alternatives,
    check_lens,
    given,
    laid_over,
    lens_of,
    missing_options,
    refuse_optics,
    refuse_repeated,
)
from defocus_core.system.text import note

if TYPE_CHECKING:
    from defocus_core.request.animation import Animation

_NONE: Layer = {}
LISTED = "lenses: "  # beginning of the keys of a lens in [sweep]


@dataclass(frozen=True)
class Sampling:
    """How many lenses to draw at random for each picture, and from which distributions."""

    count: int = 0
    seed: int = 0
    options: Layer = field(default_factory=dict)


@dataclass(frozen=True)
class PictureLenses:
    """The lenses for each picture, computed from all layers of options."""

    own: Layer  # options of all pictures
    where: Place = CALLER  # the place of these options
    file: Path | None = None  # a lens file, or None
    file_key: str = "lens"  # place of the option that names the file
    # radii leave only the opening; its unit is that of metadata
    reading: Reading = field(default_factory=Reading)
    animation: Animation | None = None
    metadata: bool = False  # whether metadata of each colour file give options
    # the options of each lens of the sweep, by its suffix
    points: Mapping[str, Layer] = field(default_factory=lambda: {"": _NONE})
    sampling: Sampling = field(default_factory=Sampling)  # the draws for each lens of the sweep
    # caches: options and lenses of the sweep for all pictures; options of the lens file, with or
    # without a blur in pixels
    _made: dict[int, tuple[Layer, LensValues | None]] = field(default_factory=dict, init=False)
    _stored: dict[bool, Layer] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        """Refuse options that are set twice, and the use of metadata where they have no effect."""
        listed = {
            name
            for layer in self.points.values()
            for name in layer.keys() & self.own.keys()
            if layer[name].place.field.startswith(LISTED)
        }
        for name in sorted(listed):
            note(f"{self.own[name].place}: has no effect on lenses of [sweep] that set it")
        refuse_repeated({k: v for k, v in self.own.items() if k not in listed}, self.places)
        if self.metadata:
            asked = {METADATA: Given(True, "", self.where.with_field(METADATA))}
            in_pixels = "blur" in {*self.own, *self.places}
            refuse_optics(asked, in_pixels=in_pixels, radii=self.reading.holds_radii)

    @cached_property
    def places(self) -> dict[str, str]:
        """The place where each animated, drawn or swept option is set, by option name.

        Alternative options, like focus-at beside focus, have the same place.
        """
        places = {} if self.animation is None else self.animation.places
        tables = [*((options, "[sweep]") for options in self.points.values())]
        for layer, table in (*tables, (self.sampling.options, "[sample]")):
            elsewhere = {name: words for name, words in places.items() if words != table}
            refuse_repeated(layer, elsewhere)
            places |= {same: table for name in layer for same in alternatives(name)}
        return places

    @property
    def count(self) -> int:
        """The number of lenses for each picture."""
        return len(self.points) * max(self.sampling.count, 1)

    @property
    def suffixes(self) -> list[str]:
        """The suffix of each lens, which is added to the names of samples."""
        draws = [f"_s{index:03}" for index in range(self.sampling.count)] or [""]
        return [suffix + draw for suffix in self.points for draw in draws]

    @property
    def varies(self) -> bool:
        """Whether pictures may have different lenses, because of keyframes or metadata."""
        return self.animation is not None or self.metadata

    @property
    def is_complete(self) -> bool:
        """Whether the options define a lens, so that defaults for relative depth are not needed."""
        fixed = self.varies or self.reading.holds_radii
        return fixed or not ("blur" in self.options or missing_options(self.options))

    @property
    def moves_focus(self) -> bool:
        """Whether keyframes move the pixel in focus."""
        return self.animation is not None and "focus-at" in self.animation.keys

    @cached_property
    def options(self) -> Layer:
        """The options that all pictures share: from the lens file, ``[lens]`` and ``[sample]``."""
        return laid_over(self._of_file(self.own), self.own, self.sampling.options)

    @cached_property
    def fixed(self) -> LensValues | None:
        """The lens of all pictures; None if keyframes or metadata may give them different ones."""
        if self.varies:
            return None
        self._check(self.options, {}, None)
        return lens_of(self.options)

    def lens_of(self, picture: PictureFiles) -> tuple[LensValues, Layer]:
        """The lens of a picture, if it has only one; and the options that its metadata gave."""
        if self.fixed is not None:
            return self.fixed, {}
        options, metadata = self._options(picture, {})
        used = {name: each for name, each in metadata.items() if options.get(name) is each}
        self._check(options, metadata, picture)
        return lens_of(options), used

    def lenses(
        self, picture: PictureFiles, numbers: Iterable[int], row: Layer = _NONE
    ) -> Iterator[tuple[str, LensValues]]:
        """Yield the lenses of a picture, each with its suffix for the name of the sample.

        `numbers` are the indices of the wanted lenses, ascending; `row` has the options of this
        picture.
        """
        refuse_repeated(row, self.places)
        points = [*self.points.items()]
        draws, alike = self.sampling.count, not (self.varies or row)
        options, metadata = (self.options, _NONE) if alike else self._options(picture, row)
        for which, mine in groupby(numbers, lambda number: number // max(draws, 1)):
            suffix, swept = points[which]
            made = self._made.get(which) if alike else None
            if made is None:
                set_to: Layer = laid_over(options, swept)
                self._check(set_to, metadata, picture)
                made = set_to, None if draws else lens_of(set_to)
                if alike:
                    self._made[which] = made
            set_to, lens = made
            if lens is not None:
                yield suffix, lens
                continue
            for index in (number % draws for number in mine):
                draw = Draw(self.sampling.seed, picture.stem + suffix, index)
                yield sys.intern(f"{suffix}_s{index:03}"), lens_of(set_to, draw)

    def _check(self, options: Layer, metadata: Layer, picture: PictureFiles | None) -> None:
        focal = metadata.get("focal-length")
        if focal and focal is options.get("focal-length") and "sensor-width" not in options:
            problem = f"is missing, and not in {focal.place.path} either"
            remedy = "add ‹sensor-width› 36mm, or what the camera has"
            raise UsageProblem("missing-option", problem, remedy, field="sensor-width")
        lacking = picture.color if self.metadata and picture is not None else None
        check_lens(options, self.where, radii=self.reading.holds_radii, lacking=lacking)

    def _options(self, picture: PictureFiles, row: Layer) -> tuple[Layer, Layer]:
        """The options of a picture except swept ones; and the options found in its metadata."""
        metadata = self._of_metadata(picture)
        own = laid_over(self.own, self.sampling.options, row)
        below = laid_over(self._of_file(own), metadata)
        return laid_over(below, self._keyed(picture), own), metadata

    def _of_file(self, above: Layer) -> Layer:
        """The options of the lens file; `above` has the options that override them."""
        if self.file is None:
            return {}
        in_pixels = "blur" in above or "blur" in self.places
        if in_pixels not in self._stored:
            from defocus_core.request.lens_files import lens_in

            where = self.where.with_field(self.file_key)
            stored = lens_in(self.file, where, in_pixels=in_pixels, radii=self.reading.holds_radii)
            self._stored[in_pixels] = stored
        return self._stored[in_pixels]

    def _of_metadata(self, picture: PictureFiles) -> Layer:
        if not self.metadata:
            return {}
        from defocus_core.io.shots.lens_metadata import lens_of as of_metadata

        metres = UNITS[self.reading.depth_unit or "m"]
        return {
            name: given(name, each.text, Place(picture.color, field=each.attribute))
            for name, each in of_metadata(picture.color, metres).items()
        }

    def _keyed(self, picture: PictureFiles) -> Layer:
        """The values of animated options at the frame of a picture."""
        if self.animation is None:
            return {}
        if picture.frame is None:
            problem = f"moves the lens, but {picture.color} has no frame number"
            remedy = "give patterns like 'shot.####.exr'"
            raise UsageProblem("idle-option", problem, remedy, field="animate")
        return self.animation.options_at(picture.frame)

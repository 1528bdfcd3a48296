"""The lens of each picture of a shot: options of the command line, keys of frames, metadata.

What the command line says holds for all frames; an option that it says cannot be animated, too.
Keys win over metadata, and metadata over the lens file.

Between two keys a value goes evenly in the variable in which the blur is smooth: the focus in
disparity, f-number, focal length and other sizes in their logarithm (an f-number in stops), angles
and pixels as they are. ``ease`` begins and ends softly at each key. Before the first key and after
the last one its value holds. Of numbers without a unit a focus is in metres, other lengths in mm.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_core.errors import CALLER, InputError, Place, UsageProblem
from defocus_core.io.depth_formats.table import UNITS
from defocus_core.io.images.describe import describe
from defocus_core.io.shots.key_files import FIELD_OF_VIEW, Key, Keys, frame_of, read_keys
from defocus_core.request.job import Picture, Reading
from defocus_core.request.lens import Lens
from defocus_core.request.lens_from_options import (
    checked,
    make_lens,
    merged,
    parsed,
    read_lens_file,
    refuse_contradiction,
    refuse_optics,
)
from defocus_core.request.parameters import (
    LENS_OPTIONS,
    METADATA,
    SCALES,
    LensParam,
    alternatives,
)
from defocus_core.request.quantities import read_at, text_of
from defocus_core.request.reading_options import field_of_view
from defocus_core.request.toml_file import Table, read_toml, refuse_unknown
from defocus_core.request.toml_file import table as table_of

if TYPE_CHECKING:
    from defocus_core.io.shots.lens_metadata import OptionFromMetadata
    from defocus_core.request.inputs import Entry
    from defocus_core.request.lens_plan import LensPlan


INTERPOLATIONS = ("linear", "ease")
_FIELD_OF_VIEW = LensParam(
    name=FIELD_OF_VIEW,
    parse=field_of_view,
    help="Vertical field of view in degrees, of which a focal length is made.",
    tag="fov",
    example="40",
    even_in="log",
)
_ANIMATED = {**LENS_OPTIONS, FIELD_OF_VIEW: _FIELD_OF_VIEW}
_DIGITS = 9


@dataclass(frozen=True)
class Animation:
    """Options of a lens with keys."""

    # By option the frames that have a key, ascending, and the keys
    keys: Keys = field(default_factory=dict)
    interpolation: str = "linear"

    @property
    def frames(self) -> tuple[int, ...]:
        """The frames that have a key, ascending."""
        return tuple(sorted({frame for keys in self.keys.values() for frame in keys}))

    def source(self, name: str) -> Place:
        """The place of the first key of an option, for errors."""
        return next(iter(self.keys[name].values())).where

    def texts(self, frame: int) -> dict[str, str]:
        """The options of a frame as texts; at a key, the text of the key."""
        return {name: self._text(name, frame) for name in self.keys}

    def _text(self, name: str, frame: int) -> str:
        keys, row = self.keys[name], _ANIMATED[name]
        frames = [*keys]
        after = bisect_right(frames, frame)
        is_between = 0 < after < len(frames) and frames[after - 1] != frame
        if not (is_between and row.even_in):
            return keys[frames[max(after - 1, 0)]].text
        first, last = frames[after - 1], frames[after]
        fraction = (frame - first) / (last - first)
        if self.interpolation == "ease":
            fraction = fraction * fraction * (3 - 2 * fraction)
        start, end = (row.parse(keys[each].text) for each in (first, last))
        if start == end:
            return keys[first].text
        if not all(isinstance(value, int | float | tuple) for value in (start, end)):
            problem = f"is {keys[first].text}, which has nothing between it and another key"
            raise UsageProblem(
                "idle-option", problem, f"give it like {row.example}", path=keys[first].where
            )
        return row.text(_between(row, start, end, fraction), _DIGITS)


def _between(row: LensParam, first: Any, last: Any, fraction: float) -> Any:
    """The value between two numbers, or of each of several."""
    if isinstance(first, tuple):
        return tuple(_between(row, *pair, fraction) for pair in zip(first, last, strict=True))
    to, back = SCALES[row.even_in]
    value = back((1 - fraction) * to(first) + fraction * to(last))
    return round(value) if isinstance(first, int) else value


def read_animation(
    files: Iterable[str], interpolation: str | None, table: Table | None = None
) -> Animation:
    """The animation of files and of ``[animate]``.

    `interpolation`: linear or ease; None for that of TOML, or linear.
    """
    root, every = Path(), dict[str, Mapping[int, Key]]()
    if table is not None:
        root, files = table.file.parent, table.texts("file")
        every, interpolation = _keys_of(table)
    keys: Keys
    for text in files:
        file, (option, is_curve, _) = root / text, text.partition("=")
        if is_curve and not file.exists():
            remedy = f"give CSV, with the header frame,{option} above its lines"
            where = CALLER.at("animate") if table is None else table.place("file")
            raise UsageProblem("malformed", f"'{text}' is no file of keys", remedy, path=where)
        if file.suffix.lower() == ".toml":
            keys, said = _keys_of(_animate_of(file))
            interpolation = interpolation or said
        else:
            keys = read_keys(file)
        for twice in keys.keys() & every.keys():
            problem = f"animates {twice}, as does {_first(every[twice]).where}"
            raise UsageProblem("contradiction", problem, "remove one of them", path=file)
        every |= keys
    checked = {name: _checked(name, keys) for name, keys in every.items() if keys}
    if checked:
        refuse_contradiction(checked, _first(next(iter(checked.values()))).where)
    return Animation(checked, interpolation or INTERPOLATIONS[0])


def read_animation_table(table: Table) -> Animation:
    """The animation of ``[animate]`` of a jobs file."""
    return read_animation((), None, table)


def _first(keys: Mapping[int, Key]) -> Key:
    return next(iter(keys.values()))


def _checked(name: str, keys: Mapping[int, Key]) -> dict[int, Key]:
    """The keys of an option by frame, once they make sense, with the units that numbers have."""
    refuse_unknown([name], tuple(_ANIMATED), _first(keys).where, "a lens", "option")
    row, made = _ANIMATED[name], {}
    for frame, key in sorted(keys.items()):
        made[frame] = Key(row.with_unit(key.text), key.where)
        read_at(key.where, row.parse, made[frame].text)
    return made


_REMEDY = 'write [animate] and focus = {1001 = "1.2m", 1060 = "4m"}'


def _animate_of(file: Path) -> Table:
    """The table of a file of keys."""
    tables = read_toml(file, what="file of keys", remedy=_REMEDY)
    refuse_unknown(tables, ("animate",), file, "a file of keys", "table")
    if not tables:
        raise InputError("empty", "has no table [animate]", _REMEDY, path=file)
    return table_of(file, tables, "animate")


def _keys_of(table: Table) -> tuple[dict[str, Mapping[int, Key]], str | None]:
    """The keys of ``[animate]``, of each option a table of values by frame; its interpolation."""
    every: dict[str, Mapping[int, Key]] = {}
    for name, frames in table.values.items():
        if name in ("file", "interpolation"):
            continue
        if not isinstance(frames, dict) or not frames:
            remedy = f'write {name} = {{1001 = "1.2m", 1060 = "4m"}}'
            problem = f"{frames!r:.40} is no table of frames"
            raise UsageProblem("malformed", problem, remedy, path=table.place(name))
        every[name] = {
            frame_of(frame, table.place(name)): Key(text_of(text), table.place(f"{name}: {frame}"))
            for frame, text in frames.items()
        }
    return every, table.choice("interpolation", INTERPOLATIONS)


@dataclass(frozen=True)
class ShotLenses:
    """Where the lens of each picture comes from."""

    flags: Mapping[str, Any]  # options of the command line, parsed
    file: Path | None = None  # a lens file, if there is one, or a folder of one for each picture
    # The depth files hold radii, so that a lens is the shape of its opening alone
    radii: bool = False
    animation: Animation = field(default_factory=Animation)
    metadata: bool = False  # whether options are taken from the metadata of each colour file
    metres: float = 1.0  # the unit of the scene, for metadata in it

    def __post_init__(self) -> None:
        """Refuse an option that the command line and the keys both set."""
        for name in self.animation.keys:
            for same in _with_alternatives(name):
                if same in self.flags:
                    problem = f"is given, and {name} is animated by {self.animation.source(name)}"
                    raise UsageProblem("contradiction", problem, "keep one of them", field=same)

    @cached_property
    def fixed(self) -> Lens | None:
        """The lens of all pictures, if that is one."""
        if self.varies:
            return None
        return make_lens(self.flags, self.file, radii=self.radii)

    @property
    def varies(self) -> bool:
        """Whether each picture may have another lens."""
        return bool(self.animation.keys) or self.metadata or self._is_folder

    @property
    def _is_folder(self) -> bool:
        """Whether each picture has a lens file of its name, as a fit of many writes them."""
        return self.file is not None and self.file.is_dir()

    def of(self, picture: Picture) -> tuple[Lens, dict[str, OptionFromMetadata]]:
        """The lens of a picture, and the options that its metadata decided."""
        if self.fixed is not None:
            return self.fixed, {}
        base, taken = self.texts(picture)
        values = {name: parsed(name, text) for name, text in base.items()}
        flags = merged(values, self.flags)
        lacking = picture.color if self.metadata else None
        file = self.file
        if self._is_folder and file is not None:
            file = file / f"{picture.stem}.toml"
        stored = {} if file is None else read_lens_file(file)
        _require_sensor(picture, taken, {*self.flags, *stored, *self.animation.keys})
        lens = make_lens(flags, file, radii=self.radii, lacking=lacking)
        used = {name: each for name, each in taken.items() if base.get(name) == each.text}
        return lens, {name: each for name, each in used.items() if name not in self.flags}

    def texts(self, picture: Picture) -> tuple[dict[str, str], dict[str, OptionFromMetadata]]:
        """The options of a picture by keys and metadata, as texts, and those of its metadata."""
        taken: dict[str, OptionFromMetadata] = {}
        if self.metadata:
            from defocus_core.io.shots.lens_metadata import lens_of

            taken = lens_of(picture.color, self.metres)
        of_metadata = {
            name: checked(name, each.text, Place(picture.color, field=each.attribute))
            for name, each in taken.items()
        }
        return merged(of_metadata, self._keyed(picture)), taken

    def _keyed(self, picture: Picture) -> dict[str, str]:
        """The options of the frame of a picture, as texts."""
        if not self.animation.keys:
            return {}
        if picture.frame is None:
            problem = f"moves the lens, but {picture.color} has no frame number"
            raise UsageProblem(
                "idle-option", problem, "give patterns like 'shot.####.exr'", field="animate"
            )
        texts = self.animation.texts(picture.frame)
        if FIELD_OF_VIEW in texts:
            texts["focal-length"] = self._focal_length(texts.pop(FIELD_OF_VIEW), picture)
        return texts

    def _focal_length(self, text: str, picture: Picture) -> str:
        """The focal length of a vertical field of view, on the sensor of the picture's shape."""
        stored = {} if self.file is None or self._is_folder else read_lens_file(self.file)
        width = self.flags.get("sensor-width") or parsed(
            "sensor-width", stored.get("sensor-width", f"{Lens.sensor_width}mm")
        )
        size = describe(picture.color)
        height = width * size.height / size.width
        return f"{height / 2 / math.tan(math.radians(field_of_view(text) / 2)):.9g}mm"


def _require_sensor(
    picture: Picture, taken: Mapping[str, OptionFromMetadata], known: Collection[str]
) -> None:
    """Refuse a focal length of metadata that do not say the sensor, which decides the blur."""
    is_said = "sensor-width" in taken or not {"sensor-width", "focal-length"}.isdisjoint(known)
    if "focal-length" in taken and not is_said:
        problem = f"is missing, and not in {picture.color} either"
        remedy = "add ‹sensor-width› 36mm, or what the camera has"
        raise UsageProblem("missing-option", problem, remedy, field="sensor-width")


def _with_alternatives(name: str) -> set[str]:
    return alternatives("focal-length" if name == FIELD_OF_VIEW else name)


def animated(
    entries: list[Entry], animation: Animation, plan: LensPlan, lens: Table, reading: Reading
) -> list[Entry]:
    """The pictures of a jobs file with the options of their frames, and of their metadata."""
    metadata = lens.flag(METADATA) or False
    if not animation.keys and not metadata:
        return entries
    if metadata and "blur" in {*plan.options, *plan.taken}:
        refuse_optics([METADATA], lens.place(), in_pixels=True)
    for name in animation.keys:
        for same in _with_alternatives(name):
            if same in lens.values or same in plan.taken:
                table = plan.taken.get(same, lens.name)
                raise UsageProblem(
                    "contradiction",
                    "is in [animate], too",
                    "remove one",
                    path=Place(lens.file, f"[{table}]", same),
                )
    width = {n: parsed(n, text) for n, text in plan.options.items() if n == "sensor-width"}
    metres = UNITS[reading.depth_unit or "m"]
    lenses = ShotLenses(width, None, plan.radii, animation, metadata, metres)
    with_options = []
    for entry in entries:
        texts, taken = lenses.texts(entry.picture)
        _require_sensor(entry.picture, taken, {*plan.options, *plan.taken, *entry.options})
        if metadata:  # what the file says holds
            said = {same for n in plan.options for same in _with_alternatives(n)}
            texts = {n: t for n, t in texts.items() if n in animation.keys or n not in said}
        with_options.append(replace(entry, options=merged(texts, entry.options)))
    return with_options

"""The lens of each picture of a shot: options of the command line, keys of frames, metadata.

What the command line says holds for all frames; an option that it says cannot be animated, too.
Keys win over metadata, and metadata over the lens file.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_core.batch.jobs.animation import (
    Animation,
    interpolation_of,
    keys_of_table,
    read_animation,
)
from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.batch.jobs.lens_from_options import (
    checked,
    make_lens,
    merged,
    parsed,
    read_lens_file,
    refuse_metadata_beside_blur,
)
from defocus_core.batch.jobs.reading_options import field_of_view
from defocus_core.batch.jobs.toml_file import Table
from defocus_core.batch.lenses.lens import Lens
from defocus_core.batch.lenses.parameters import METADATA, alternatives
from defocus_core.errors import CALLER, Place, UsageProblem
from defocus_core.io.depth_formats.table import UNITS
from defocus_core.io.images.describe import describe
from defocus_core.io.shots.key_files import FIELD_OF_VIEW

if TYPE_CHECKING:
    from defocus_core.batch.jobs.inputs import Entry
    from defocus_core.batch.jobs.lens_plan import LensPlan
    from defocus_core.io.shots.lens_metadata import OptionFromMetadata


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
        known = {*self.flags, *stored, *self.animation.keys}
        if self.metadata:
            refuse_metadata_beside_blur(known, CALLER.at(METADATA))
        _require_sensor(picture, taken, known)
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


def read_animation_table(table: Table) -> Animation:
    """The animation of ``[animate]`` of a jobs file."""
    values, interpolation = interpolation_of(table.values, table.place())
    files = values.pop("file", [])
    files = files if isinstance(files, list) else [files]
    if not all(isinstance(file, str) and file for file in files):
        problem = f"{files!r:.40} does not name files"
        raise UsageProblem(
            "malformed", problem, 'write file = "pull.csv"', path=table.place("file")
        )
    keys = keys_of_table(values, table.place())
    return read_animation(files, interpolation, keys, table.file.parent)


def animated(
    entries: list[Entry], animation: Animation, plan: LensPlan, lens: Table, reading: Reading
) -> list[Entry]:
    """The pictures of a jobs file with the options of their frames, and of their metadata."""
    metadata = lens.flag(METADATA) or False
    if not animation.keys and not metadata:
        return entries
    if metadata:
        refuse_metadata_beside_blur({*plan.options, *plan.taken}, lens.place(METADATA))
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
        with_options.append(entry.with_options(merged(texts, entry.options)))
    return with_options

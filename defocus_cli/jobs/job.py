"""A job: one picture, the lens that takes it, what to write and how to render it.

Pictures are named by the stem of their colour file; a job writes ``OUT/<kind>/<stem>.<ext>``.
Nothing here opens a file, though `Job.files` looks which are there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from defocus_cli.depth_formats.reading import DepthReading
from defocus_cli.depth_formats.sidecars import files_beside
from defocus_cli.formats.kinds import KINDS, PREVIEW, Kind
from defocus_cli.jobs.quantities import Percentile, length_text

QUALITIES = ("draft", "standard", "high", "reference")
DEVICES = ("auto", "cpu", "cuda")
DUAL_PIXEL_MODELS = ("split", "smooth")
FRAME_ROLE = "frame"  # of other frames among the inputs
OTHERS = ("hidden", "over", "holdout")  # pictures that belong to another one
TILES = (16, 1 << 14)  # px; of defocus_core, too


@dataclass(frozen=True)
class Picture:
    """Where colour and depth of one picture are; the same file twice when one EXR holds both.

    Attributes:
        stem: its name.
        color: its colour file.
        depth: its depth file; of a plate that has none its colour file.
        hidden: a picture of what lies behind the visible surface, where that is known.
        over: the plate that it lies over, if it is an element.
        holdout: a deep picture that hides what is behind it and shows nothing.
        frame: its number in a shot.
    """

    stem: str
    color: Path
    depth: Path
    hidden: Picture | None = None
    over: Picture | None = None
    holdout: Picture | None = None
    frame: int | None = None

    @property
    def others(self) -> dict[str, Picture]:
        """The pictures of the same scene that belong to it, by role: hidden, over, holdout."""
        found = {role: getattr(self, role) for role in OTHERS}
        return {role: picture for role, picture in found.items() if picture is not None}

    @property
    def files(self) -> dict[str, Path]:
        """Its files by role: color, depth; hidden_color, hidden_depth, over_color, … if any."""
        files = {"color": self.color, "depth": self.depth}
        for role, other in self.others.items():
            files |= {f"{role}_color": other.color, f"{role}_depth": other.depth}
        return files


@dataclass(frozen=True)
class Draw:
    """Which of the random lenses of a picture this is.

    Attributes:
        seed: the seed of the jobs file.
        picture: name of the picture.
        index: number of the draw for this picture.
        options: all options of the lens as texts, drawn or not.
        attempt: number of draws before this one that did not suit the picture.
    """

    seed: int
    picture: str
    index: int
    options: tuple[tuple[str, str], ...]
    attempt: int = 0


@dataclass(frozen=True)
class Lens:
    """A thin lens, lengths in mm.

    Its focus is at ``foc_dist``, at the depth of pixel ``focus_at``, or at ``focus_percentile`` of
    the depth; `defocus_cli.rendering.focusing.focused` finds the distance. Where a file holds radii
    instead of depth, only the shape of the opening is known: focal length and f-number are NaN.
    """

    foclen: float
    fnum: float
    foc_dist: float | None
    focus_at: tuple[int, int] | None = None
    sensor_width: float = 36.0
    blades: int = 0
    blade_rotation: float = 0.0
    focus_percentile: float | None = None  # 0 is the nearest pixel, 100 the farthest but the sky
    max_coc: float | None = None  # px, largest CoC radius that the picture may have
    sharp_range: tuple[float, float] | None = None  # nearest and farthest of what is in focus, too
    blade_curvature: float = 0.0
    obstruction: float = 0.0
    spherical: float = 0.0
    squeeze: float = 1.0
    aperture_image: Path | None = None
    highlights: tuple[float, float] | None = None  # threshold in linear light, and gain
    dp_model: str = "split"
    dp_crosstalk: float = 0.0
    noise: tuple[float, float] | None = None  # electrons of a light of 1, and of read noise
    noise_seed: int = 0
    draw: Draw | None = None  # of a random lens; another can be drawn from it
    # How errors about its focus begin: the file that sets it, or two dashes.
    focus_source: str = field(default="", compare=False)

    @property
    def effects(self) -> dict[str, Any]:
        """Its effects that are on, by the names of their fields: what a lens is without blades."""
        values = {name: getattr(self, name) for name in EFFECTS}
        effects = {name: value for name, value in values.items() if value != EFFECTS[name]}
        if self.aperture_image is not None:
            effects["aperture_image"] = self.aperture_image.name
        if self.sharp_range is not None:
            effects["sharp_range"] = "..".join(map(length_text, self.sharp_range))
        if self.highlights is not None:
            effects["highlights"] = "{:g}:{:g}".format(*self.highlights)
        if self.noise is not None:
            effects["noise"] = "{:g}:{:g}".format(*self.noise)
        return effects

    @property
    def is_shape(self) -> bool:
        """Whether only the shape of the opening is known, as beside a file of radii."""
        return math.isnan(self.foclen)


# Fields of effects that most lenses have not got, and their values if they are off.
EFFECTS = {
    field.name: field.default
    for field in fields(Lens)
    if field.name
    in (
        *("sharp_range", "blade_curvature", "obstruction", "spherical", "squeeze"),
        *("aperture_image", "dp_model", "dp_crosstalk", "noise", "noise_seed", "highlights"),
    )
}


@dataclass(frozen=True, kw_only=True)
class Reading(DepthReading):
    """What to take from the input files, and how to read it.

    Attributes:
        color_layer: colour layer of an EXR.
        depth_repair: auto, off (depth is used as it is read), or soft-edges=SLOPE in px per px.
        edge_width: px of the widest soft edges of depth, 0 if none are soft; None: as found.
    """

    color_layer: str | None = None
    depth_repair: str = "auto"
    edge_width: float | None = None
    blur_channels: tuple[str, ...] = ()  # names or patterns of further channels that are light


@dataclass(frozen=True)
class Outputs:
    """The outputs of a job, and where to write them."""

    root: Path
    kinds: tuple[str, ...] = ("render",)
    format: str = "exr"
    exr_type: str = "half"
    jpeg_quality: int = 95  # 1 to 100
    preview: bool = False
    overwrite: bool = False
    map_format: str = "exr"  # or tiff, of float32, too
    keep_overscan: bool = False  # pixels beyond the display window are written, too

    @property
    def rows(self) -> list[Kind]:
        """The rows of the table of kinds that are written."""
        return [KINDS[name] for name in self.kinds]

    @property
    def need_rendering(self) -> bool:
        """Whether a kind needs more than the signed radii."""
        return any(kind.rendered for kind in self.rows)

    def names(self, stem: str) -> dict[str, str]:
        """The files of one picture, relative to the root: of each kind, and of kind.preview."""
        names = {
            k.name: f"{k.name}/{stem}{k.suffix(self.format, self.map_format)}" for k in self.rows
        }
        if self.preview:
            names |= {f"{kind}{PREVIEW}": f"{kind}/{stem}.preview.png" for kind in self.kinds}
        return names


@dataclass(frozen=True)
class Machine:
    """How to compute. ``quality`` or ``tolerance`` decide the pictures.

    ``tile`` changes their last digits, too; the other fields change nothing in them.
    """

    quality: str = "standard"
    tolerance: float | None = None  # px of CoC radius, instead of a quality
    device: str = "auto"
    threads: int = 1
    memory: int | None = None  # bytes for the process; None: most of what is available
    tile: int | None = None  # px on a side of a tile; None: the renderer's own


@dataclass(frozen=True)
class Taken:
    """A frame of a shot, and the lens that takes it."""

    picture: Picture
    lens: Lens


@dataclass(frozen=True)
class Shot:
    """The frames of a shot that decide, besides its own, what a picture looks like.

    Attributes:
        sample: frames by which is decided for all of the shot how depth is repaired and where a
            focus lies that the depth decides; empty if each frame decides for itself.
        window: the frame and its neighbours, ascending: their depth is averaged where the scene is
            still, and with motion vectors they show what is hidden.
        focus: frames whose focus is averaged for the focus of this one; empty for its own.
        motion: layer of motion vectors in the files; None if there is none.
    """

    sample: tuple[Taken, ...] = ()
    window: tuple[Picture, ...] = ()
    focus: tuple[Taken, ...] = ()
    motion: str | None = None

    @property
    def pictures(self) -> dict[int, Picture]:
        """All of these frames by number."""
        taken = (each.picture for each in (*self.sample, *self.focus))
        return {int(p.frame): p for p in (*taken, *self.window) if p.frame is not None}

    @property
    def files(self) -> dict[str, Path]:
        """Their files by role, like frame1001_depth."""
        return {
            f"{FRAME_ROLE}{number}_{role}": path
            for number, picture in sorted(self.pictures.items())
            for role, path in (("color", picture.color), ("depth", picture.depth))
        }


@dataclass(frozen=True)
class Job:
    """One picture to render."""

    picture: Picture
    lens: Lens
    reading: Reading
    outputs: Outputs
    machine: Machine
    suffix: str = ""  # tells this lens from others of the same picture
    shot: Shot | None = None
    split: str = ""  # of a dataset; it changes nothing in the outputs

    @property
    def files(self) -> dict[str, Path]:
        """Its inputs by role: those of picture, shot and lens, and those beside its depth."""
        files = self.picture.files | files_beside(self.reading.row, self.picture.depth)
        if self.lens.aperture_image is not None and self.outputs.need_rendering:
            files["aperture_image"] = self.lens.aperture_image
        return files if self.shot is None else files | self.shot.files

    @property
    def lens_focal(self) -> float | None:
        """Focal length in widths of the sensor, where the depth cannot be read without it."""
        return self.lens.foclen / self.lens.sensor_width if self.reading.needs_lens else None

    @property
    def sample_id(self) -> str:
        """The name of the sample, and the stem of its files."""
        return self.picture.stem + self.suffix

    @property
    def names(self) -> dict[str, str]:
        """Every file this job writes, relative to the root: of each kind, and of kind.preview."""
        return self.outputs.names(self.sample_id)

    @property
    def paths(self) -> dict[str, Path]:
        """The file of each kind."""
        names, root = self.names, self.outputs.root
        return {kind: root / names[kind] for kind in self.outputs.kinds}

    @property
    def previews(self) -> dict[str, Path]:
        """The preview of each kind; empty when none are wanted."""
        names = {name: path for name, path in self.names.items() if name.endswith(PREVIEW)}
        return {name.removesuffix(PREVIEW): self.outputs.root / p for name, p in names.items()}

    @property
    def written(self) -> list[Path]:
        """Every file this job writes."""
        return [self.outputs.root / name for name in self.names.values()]


def lens_record(lens: Lens) -> dict[str, Any]:
    """A lens in plain numbers and words, units in the names; infinity is the word ``inf``.

    Of a lens of which only the shape is known, the other numbers are None.
    """
    record: dict[str, Any] = {
        "focal_length_mm": None if lens.is_shape else lens.foclen,
        "fnumber": None if lens.is_shape else lens.fnum,
        "sensor_width_mm": None if lens.is_shape else lens.sensor_width,
        "focus_mm": "inf" if lens.foc_dist == math.inf else lens.foc_dist,
        "blades": lens.blades,
        "blade_rotation_deg": lens.blade_rotation,
    }
    record |= lens.effects
    if lens.focus_at is not None:
        record["focus_at_px"] = list(lens.focus_at)
    if lens.focus_percentile is not None:
        record["focus_percentile"] = lens.focus_percentile
    if lens.max_coc is not None:
        record["max_coc_px"] = lens.max_coc
    if (draw := lens.draw) is not None:
        record["draw"] = {"seed": draw.seed, "index": draw.index, "attempt": draw.attempt}
    return record


def lens_words(lens: Lens) -> str:
    """A lens in words, like ``50mm f/1.4, focus 2m, sensor 36mm``."""
    return lens_record_words(lens_record(lens))


def lens_record_words(lens: Mapping[str, Any]) -> str:
    """A record of a lens in words."""
    shape = f", {lens['blades']} blades" if lens["blades"] else ""
    shape += "".join(f", {name.replace('_', ' ')} {lens[name]}" for name in EFFECTS if name in lens)
    if lens["focal_length_mm"] is None:
        return f"radii of the file{shape}"
    focus = "at {},{}".format(*lens["focus_at_px"]) if "focus_at_px" in lens else ""
    if "focus_percentile" in lens:
        focus = f"at {Percentile(lens['focus_percentile'])}"
    if lens["focus_mm"] is not None:
        focus = f"{length_text(float(lens['focus_mm']))} {focus}".strip()
    foclen, sensor = (length_text(lens[f"{key}_mm"]) for key in ("focal_length", "sensor_width"))
    return f"{foclen} f/{lens['fnumber']:g}, focus {focus}, sensor {sensor}{shape}"

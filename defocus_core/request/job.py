"""A job: one picture, the lens that takes it, what to write and how to render it.

Pictures are named by the stem of their colour file; a job writes ``OUT/<kind>/<stem>.<ext>``.
Nothing here opens a file, though `Job.files` looks which are there.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from defocus_core.errors import UsageProblem
from defocus_core.io.depth_formats.reading import DepthReading
from defocus_core.request.lens import LensValues
from defocus_core.request.output_kinds import KINDS, PREVIEW, Kind

DEVICES = ("auto", "cpu", "cuda")
FRAME_ROLE = "frame"  # of other frames among the inputs
OTHERS = ("hidden", "over", "holdout", "matte")  # pictures that belong to another one


@dataclass(frozen=True, slots=True)
class PictureFiles:
    """Where colour and depth of one picture are; the same file twice when one EXR holds both."""

    stem: str
    color: Path
    depth: Path  # its depth file; of a plate that has none its colour file
    # A picture of what lies behind the visible surface, where that is known
    hidden: PictureFiles | None = None
    over: PictureFiles | None = None  # the plate that it lies over, if it is an element
    holdout: PictureFiles | None = (
        None  # a deep picture that hides what is behind it and shows nothing
    )
    matte: PictureFiles | None = None  # a file of the coverage of its subject, twice
    frame: int | None = None  # its number in a shot
    carried: tuple[tuple[str, Path], ...] = ()  # labels that are listed with it, by role

    @property
    def others(self) -> dict[str, PictureFiles]:
        """The pictures of the same scene that belong to it, by role of `OTHERS`."""
        with_role = {role: getattr(self, role) for role in OTHERS}
        return {role: picture for role, picture in with_role.items() if picture is not None}

    @property
    def files(self) -> dict[str, Path]:
        """Its files by role: color, depth; hidden_color, over_depth, … and labels, if any."""
        files = {"color": self.color, "depth": self.depth}
        for role, other in self.others.items():
            files |= {f"{role}_color": other.color, f"{role}_depth": other.depth}
        return files | dict(self.carried)


@dataclass(frozen=True, kw_only=True)
class Reading(DepthReading):
    """What to take from the input files, and how to read it."""

    color_layer: str | None = None  # colour layer of an EXR
    # Auto, or off: depth is used as it is read
    depth_repair: str = "auto"
    # Px of the widest soft edges of depth, 0 if none are soft; None: as found
    edge_width: float | None = None
    blur_channels: tuple[str, ...] = ()  # names or patterns of further channels that are light


@dataclass(frozen=True)
class Outputs:
    """The outputs of a job, and where to write them."""

    root: Path
    kinds: tuple[str, ...] = ("render",)
    format: str = "exr"
    exr_type: str = "half"
    compression: str = "zip"  # codec of the EXR files, or input for that of the colour
    color_space: str | None = None  # srgb: all but EXR are that, whatever profile came
    jpeg_quality: int = 95  # 1 to 100
    preview: bool = False
    overwrite: bool = False
    map_format: str = "exr"  # or tiff, of float32, too
    keep_overscan: bool = False  # pixels beyond the display window are written, too
    file: str = ""  # the name of the only file, in root itself; empty for folders of kinds

    @property
    def rows(self) -> list[Kind]:
        """The rows of the table of kinds that are written."""
        return [KINDS[name] for name in self.kinds]

    @property
    def need_rendering(self) -> bool:
        """Whether a kind needs more than the signed radii."""
        return any(kind.rendered for kind in self.rows)

    @property
    def writes_exr(self) -> bool:
        """Whether a file that is written is an EXR."""
        return any(Path(name).suffix.lower() == ".exr" for name in self.names("a").values())

    @property
    def folders(self) -> tuple[Path, ...]:
        """The folders that files are written to."""
        return (self.root,) if self.file else tuple(self.root / kind for kind in self.kinds)

    def names(self, stem: str) -> dict[str, str]:
        """The files of one picture, relative to the root: of each kind, and of kind.preview."""
        if self.file:
            return {self.kinds[0]: self.file}
        names = {
            k.name: f"{k.name}/{stem}{k.suffix(self.format, self.map_format)}" for k in self.rows
        }
        if self.preview:
            names |= {f"{kind}{PREVIEW}": f"{kind}/{stem}.preview.png" for kind in self.kinds}
        return names


@dataclass(frozen=True)
class Machine:
    """How to compute. ``quality`` decides the pictures.

    ``tile`` changes their last digits, too; the other fields change nothing in them.
    """

    quality: str = "standard"
    device: str = "auto"
    threads: int = 1
    memory: int | None = None  # bytes for the process; None: most of what is available
    tile: int | None = None  # px on a side of a tile; None: the renderer's own


@dataclass(frozen=True)
class FrameLens:
    """A frame of a shot, and the lens that takes it."""

    picture: PictureFiles
    lens: LensValues


@dataclass(frozen=True)
class Shot:
    """The frames of a shot that decide, besides its own, what a picture looks like."""

    # Frames by which is decided for all of the shot how depth is repaired and where a focus
    # lies that the depth decides; empty if each frame decides for itself
    sample: tuple[FrameLens, ...] = ()
    shares_focus: bool = True  # whether these decide where the focus lies, too

    @property
    def pictures(self) -> dict[int, PictureFiles]:
        """All of these frames by number."""
        taken = (each.picture for each in self.sample)
        return {int(p.frame): p for p in taken if p.frame is not None}

    @property
    def files(self) -> dict[str, Path]:
        """Their files by role, like frame1001_depth."""
        return {
            f"{FRAME_ROLE}{number}_{role}": path
            for number, picture in sorted(self.pictures.items())
            for role, path in (("color", picture.color), ("depth", picture.depth))
        }


def reading_through(reading: Reading, lens: LensValues | None) -> Reading:
    """The reading of depth that a lens needs: as relative disparity if its blur is in pixels."""
    if lens is not None and lens.blur is not None:
        return reading if reading.relative else reading.as_relative()
    if reading.invert is not None:
        problem = "reverses relative disparity, and this depth is not relative"
        remedy = "add ‹blur› 40px, or swap the ends of ‹depth-range›"
        raise UsageProblem("idle-option", problem, remedy, field="invert")
    return reading


SPLIT_NAME = re.compile(r"[A-Za-z0-9_]{1,40}")


class Split(NamedTuple):
    """The split of a scene in a dataset; it changes nothing in the outputs."""

    name: str = ""  # empty for none
    scene: str = ""
    choices: tuple[str, ...] = ()  # the splits that there are


NO_SPLIT = Split()


@dataclass(frozen=True, slots=True)
class Job:
    """One picture to render."""

    picture: PictureFiles
    lens: LensValues
    reading: Reading
    outputs: Outputs
    machine: Machine
    suffix: str = ""  # tells this lens from others of the same picture
    shot: Shot | None = None
    split: Split = NO_SPLIT

    def __post_init__(self) -> None:
        """Read depth as the lens needs it.

        Raises:
            UsageProblem: Channels of light are named that no output holds.
        """
        if self.reading.blur_channels and self.outputs.format != "exr":
            problem = f"has no effect in {self.outputs.format}, which holds the picture alone"
            raise UsageProblem("idle-option", problem, "use ‹format› exr", field="blur-channels")
        object.__setattr__(self, "reading", reading_through(self.reading, self.lens))

    @property
    def files(self) -> dict[str, Path]:
        """Its inputs by role: those of picture, shot and lens, and those beside its depth."""
        files, row = self.picture.files, self.reading.row
        if row.sidecar or row.mask:
            from defocus_core.io.depth_formats.sidecars import files_beside

            files |= files_beside(row, self.picture.depth)
        if self.outputs.need_rendering:
            files |= self.lens.files
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


def of_views(jobs: Sequence[Job]) -> list[Job]:
    """The jobs of each view, with its name in theirs, where ‹view› names several."""
    if not any("," in (job.reading.view or "") for job in jobs):
        return list(jobs)
    return [
        replace(
            job,
            reading=replace(job.reading, view=view),
            picture=replace(job.picture, stem=f"{job.picture.stem}_{view}"),
        )
        for job in jobs
        for view in dict.fromkeys(map(str.strip, (job.reading.view or "").split(",")))
    ]

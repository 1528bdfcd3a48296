"""A job: one picture, its lens, its outputs and how to render it. Nothing here opens a file."""

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
FRAME_ROLE = "frame"  # prefix of the roles of other frames
OTHERS = ("hidden", "over", "holdout", "matte")  # roles of pictures that belong to another one
_LABEL = re.compile(r"[a-z][a-z0-9_]*")
_RESERVED = {
    *("color", "depth", FRAME_ROLE, "lens", "aperture", "dp", *OTHERS),
    *("json", "place", "sample", "shards"),
}


def is_label(name: str) -> bool:
    """Whether a label may have a name: no kind, and not begun like an input or a folder in OUT."""
    is_free = name not in KINDS and name.partition("_")[0] not in _RESERVED
    return is_free and _LABEL.fullmatch(name) is not None


@dataclass(frozen=True, slots=True)
class PictureFiles:
    """The files of a picture; colour and depth are the same file if one EXR holds both."""

    stem: str
    color: Path
    depth: Path  # its depth file; for a plate without depth its colour file
    # a picture of what lies behind the visible surface, where that is known
    hidden: PictureFiles | None = None
    over: PictureFiles | None = None  # the plate behind it, if it is an element
    holdout: PictureFiles | None = (
        None  # a deep picture that hides what is behind it, without being shown
    )
    matte: PictureFiles | None = None  # the coverage of its subject; the same file twice
    frame: int | None = None  # number of the frame in a shot
    carried: tuple[tuple[str, Path], ...] = ()  # labels that are put beside its outputs, by name

    @property
    def others(self) -> dict[str, PictureFiles]:
        """The pictures of the same scene that belong to it, by role of `OTHERS`."""
        with_role = {role: getattr(self, role) for role in OTHERS}
        return {role: picture for role, picture in with_role.items() if picture is not None}

    @property
    def files(self) -> dict[str, Path]:
        """The files by role: color, depth; hidden_color, over_depth, … and labels, if any."""
        files = {"color": self.color, "depth": self.depth}
        for role, other in self.others.items():
            files |= {f"{role}_color": other.color, f"{role}_depth": other.depth}
        return files | dict(self.carried)


@dataclass(frozen=True, kw_only=True)
class Reading(DepthReading):
    """How to read the input files."""

    color_layer: str | None = None  # colour layer of an EXR
    # auto, or off: depth is used as it is read
    depth_repair: str = "auto"
    # px of the widest soft edges of depth, 0 if none are soft; None measures them
    edge_width: float | None = None
    blur_channels: tuple[str, ...] = ()  # names or patterns of further channels that are light


@dataclass(frozen=True)
class Outputs:
    """The outputs of a job, and their place."""

    root: Path
    kinds: tuple[str, ...] = ("render",)
    format: str = "exr"
    exr_type: str = "half"
    compression: str = "zip"  # codec of EXR files; input for that of the colour file
    color_space: str | None = None  # srgb converts images other than EXR; auto keeps their profile
    jpeg_quality: int = 95  # 1 to 100
    preview: bool = False
    overwrite: bool = False
    map_format: str = "exr"  # or tiff, also float32
    keep_overscan: bool = False  # whether pixels beyond the display window are written
    labels: tuple[str, ...] = ()  # names of those that are put beside the outputs
    file: str = ""  # name of the only file, in root itself; empty for a folder for each kind

    @property
    def rows(self) -> list[Kind]:
        """The written kinds, as rows of the table."""
        return [KINDS[name] for name in self.kinds]

    @property
    def need_rendering(self) -> bool:
        """Whether a kind needs rendering, not only signed radii."""
        return any(kind.rendered for kind in self.rows)

    @property
    def folders(self) -> tuple[Path, ...]:
        """The folders that files are written to."""
        return (self.root,) if self.file else tuple(self.root / k for k in self.kinds + self.labels)

    def names(self, stem: str) -> dict[str, str]:
        """The files of a picture by kind, and by kind.preview, relative to the root."""
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
    """How to compute: pictures depend on ``quality``, their last digits on ``tile``."""

    quality: str = "standard"
    device: str = "auto"
    threads: int = 1
    memory: int | None = None  # bytes for the process; None: most of what is available
    tile: int | None = None  # px on a side of a tile; None: the renderer's own


@dataclass(frozen=True)
class FrameLens:
    """A frame of a shot, and its lens."""

    picture: PictureFiles
    lens: LensValues


@dataclass(frozen=True)
class Shot:
    """The other frames of a shot on which a picture depends."""

    # frames that decide the repair of depth, and a focus that depends on depth, for the whole shot;
    # empty if each frame decides for itself
    sample: tuple[FrameLens, ...] = ()
    shares_focus: bool = True  # whether these decide the focus, too

    @property
    def pictures(self) -> dict[int, PictureFiles]:
        """The pictures of these frames by number."""
        pictures = (each.picture for each in self.sample)
        return {int(p.frame): p for p in pictures if p.frame is not None}

    @property
    def files(self) -> dict[str, Path]:
        """Their files by role, like frame1001_depth."""
        return {
            f"{FRAME_ROLE}{number}_{role}": path
            for number, picture in sorted(self.pictures.items())
            for role, path in (("color", picture.color), ("depth", picture.depth))
        }


def reading_through(reading: Reading, lens: LensValues | None) -> Reading:
    """The reading of depth for a lens: as relative disparity if its blur is in pixels."""
    if lens is not None and lens.blur is not None:
        return reading if reading.relative else reading.as_relative()
    if reading.invert is not None:
        problem = "reverses relative disparity, and this depth is not relative"
        remedy = "add ‹blur› 40px, or swap the ends of ‹depth-range›"
        raise UsageProblem("idle-option", problem, remedy, field="invert")
    return reading


SPLIT_NAME = re.compile(r"[A-Za-z0-9_]{1,40}")


class Split(NamedTuple):
    """The split of a scene in a dataset; it does not change the outputs."""

    name: str = ""  # empty for none
    scene: str = ""
    choices: tuple[str, ...] = ()  # the names of all splits


NO_SPLIT = Split()


@dataclass(frozen=True, slots=True)
class Job:
    """One picture to render."""

    picture: PictureFiles
    lens: LensValues
    reading: Reading
    outputs: Outputs
    machine: Machine
    suffix: str = ""  # suffix that distinguishes the lenses of a picture
    shot: Shot | None = None
    split: Split = NO_SPLIT

    def __post_init__(self) -> None:
        """Read depth as the lens needs it.

        Raises:
            UsageProblem: The format cannot hold `blur_channels`, or they would lack the highlights.
        """
        if self.reading.blur_channels and self.outputs.format != "exr":
            problem = f"has no effect in {self.outputs.format}, which holds the picture alone"
            raise UsageProblem("idle-option", problem, "use ‹format› exr", field="blur-channels")
        if self.reading.blur_channels and self.lens.highlights:
            problem = "adds light that the channels of ‹blur-channels› do not have"
            raise UsageProblem("contradiction", problem, "leave one out", field="highlights")
        object.__setattr__(self, "reading", reading_through(self.reading, self.lens))

    @property
    def files(self) -> dict[str, Path]:
        """The inputs by role: those of picture, shot and lens, and sidecars of the depth."""
        files, row = self.picture.files, self.reading.row
        if row.sidecar or row.mask:
            from defocus_core.io.depth_formats.sidecars import files_beside

            files |= files_beside(row, self.picture.depth)
        if self.outputs.need_rendering:
            files |= self.lens.files
        return files if self.shot is None else files | self.shot.files

    @property
    def lens_focal(self) -> float | None:
        """Focal length in widths of the sensor, if reading the depth needs it; else None."""
        return self.lens.foclen / self.lens.sensor_width if self.reading.needs_lens else None

    @property
    def sample_id(self) -> str:
        """The name of the sample, and the stem of its files."""
        return self.picture.stem + self.suffix

    @property
    def names(self) -> dict[str, str]:
        """The files that the job writes, relative to the root, by kind, kind.preview and label."""
        labels = {k: f"{k}/{self.sample_id}{path.suffix}" for k, path in self.picture.carried}
        return self.outputs.names(self.sample_id) | labels

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
        """All files that the job writes."""
        return [self.outputs.root / name for name in self.names.values()]


def of_views(jobs: Sequence[Job]) -> list[Job]:
    """A job for each view, with its name added to the stem, if ‹view› names several."""
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

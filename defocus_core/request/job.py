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
    """Whether a name is a valid label, under which files are copied beside the outputs.

    It must not be a kind of output, and must not begin with a reserved word such as ``depth`` or
    ``json``, alone or before ``_``.
    """
    is_free = name not in KINDS and name.partition("_")[0] not in _RESERVED
    return is_free and _LABEL.fullmatch(name) is not None


@dataclass(frozen=True, slots=True)
class PictureFiles:
    """The files of a picture. `color` and `depth` are the same file if one EXR holds both.

    `carried` are files that are copied beside the outputs, by label.
    """

    stem: str
    color: Path
    depth: Path  # its depth file; for a plate without depth its colour file
    # a picture of what lies behind the visible surface, where that is known
    hidden: PictureFiles | None = None
    over: PictureFiles | None = None  # the plate behind it, if it is an element
    holdout: PictureFiles | None = (
        None  # a deep picture that hides what is behind it, without being shown
    )
    matte: PictureFiles | None = (
        None  # coverage of its subject, a file that is both color and depth
    )
    frame: int | None = None  # number of the frame in a shot
    carried: tuple[tuple[str, Path], ...] = ()  # files copied beside its outputs, by label

    @property
    def others(self) -> dict[str, PictureFiles]:
        """The other pictures of the same scene, by role: hidden, over, holdout, matte."""
        with_role = {role: getattr(self, role) for role in OTHERS}
        return {role: picture for role, picture in with_role.items() if picture is not None}

    @property
    def files(self) -> dict[str, Path]:
        """All files by role: color, depth, those of `others` like hidden_color, and `carried`."""
        files = {"color": self.color, "depth": self.depth}
        for role, other in self.others.items():
            files |= {f"{role}_color": other.color, f"{role}_depth": other.depth}
        return files | dict(self.carried)


@dataclass(frozen=True, kw_only=True)
class Reading(DepthReading):
    """Options for reading the input files."""

    color_layer: str | None = None  # colour layer of an EXR
    # auto, or off: depth is used as it is read
    depth_repair: str = "auto"
    # px of the widest soft edges of depth, 0 if none are soft; None measures them
    edge_width: float | None = None
    blur_channels: tuple[str, ...] = ()  # names or patterns of further channels to blur


@dataclass(frozen=True)
class Outputs:
    """The kinds and file formats of the outputs of a job, and the folder to write them to."""

    root: Path
    kinds: tuple[str, ...] = ("render",)
    format: str = "exr"
    exr_type: str = "half"
    compression: str = "zip"  # codec of EXR files; input for that of the colour file
    color_space: str | None = None  # srgb converts images other than EXR; None keeps their profile
    jpeg_quality: int = 95  # 1 to 100
    preview: bool = False
    overwrite: bool = False
    map_format: str = "exr"  # or tiff, also float32
    keep_overscan: bool = False  # whether pixels beyond the display window are written
    labels: tuple[str, ...] = ()  # names of files that are copied beside the outputs
    file: str = ""  # name of the only file, in root itself; empty for a folder for each kind

    @property
    def rows(self) -> list[Kind]:
        """The kinds to write, as rows of the table `output_kinds.KINDS`."""
        return [KINDS[name] for name in self.kinds]

    @property
    def need_rendering(self) -> bool:
        """Whether any kind needs a rendered picture; a CoC map, for one, needs only radii."""
        return any(kind.rendered for kind in self.rows)

    @property
    def folders(self) -> tuple[Path, ...]:
        """The folders to write to: one for each kind and label, or the root for a single file."""
        return (self.root,) if self.file else tuple(self.root / k for k in self.kinds + self.labels)

    def names(self, stem: str) -> dict[str, str]:
        """The file of each kind for a picture named `stem`, relative to the root.

        Previews have the keys ``<kind>.preview``.
        """
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
    """The quality of rendering, and the hardware to use.

    Pixels depend on ``quality``, and in their last digits on ``tile``, but on no other field.
    """

    quality: str = "standard"
    device: str = "auto"
    threads: int = 1
    memory: int | None = None  # bytes for the process; None: most of what is available
    tile: int | None = None  # px on a side of a tile; None: the renderer's own


@dataclass(frozen=True)
class FrameLens:
    """A frame of a shot, with its lens."""

    picture: PictureFiles
    lens: LensValues


@dataclass(frozen=True)
class Shot:
    """The frames of a shot that decide the repair of depth and the focus of the whole shot."""

    # frames that decide the repair of depth, and a focus that depends on depth, for the whole shot;
    # empty if each frame decides for itself
    sample: tuple[FrameLens, ...] = ()
    shares_focus: bool = True  # whether these decide the focus, too

    @property
    def pictures(self) -> dict[int, PictureFiles]:
        """The files of the deciding frames, `sample`, by frame number."""
        pictures = (each.picture for each in self.sample)
        return {int(p.frame): p for p in pictures if p.frame is not None}

    @property
    def files(self) -> dict[str, Path]:
        """The files of the frames in `sample`, by role like ``frame1001_depth``."""
        return {
            f"{FRAME_ROLE}{number}_{role}": path
            for number, picture in sorted(self.pictures.items())
            for role, path in (("color", picture.color), ("depth", picture.depth))
        }


def reading_through(reading: Reading, lens: LensValues | None) -> Reading:
    """The options for reading depth, adapted to a lens.

    With a lens whose ``blur`` is given in px, depth is read as relative disparity. Otherwise,
    UsageProblem is raised if ``invert`` is set, which only relative disparity allows.
    """
    if lens is not None and lens.blur is not None:
        return reading if reading.relative else reading.as_relative()
    if reading.invert is not None:
        problem = "reverses relative disparity, and this depth is not relative"
        remedy = "add ‹blur› 40px, or swap the ends of ‹depth-range›"
        raise UsageProblem("idle-option", problem, remedy, field="invert")
    return reading


SPLIT_NAME = re.compile(r"[A-Za-z0-9_]{1,40}")


class Split(NamedTuple):
    """The split of a dataset, like train or test, that a scene belongs to. It changes no output."""

    name: str = ""  # empty for none
    scene: str = ""
    choices: tuple[str, ...] = ()  # the names of all splits


NO_SPLIT = Split()


@dataclass(frozen=True, slots=True)
class Job:
    """A picture to render through a lens, with all options."""

    picture: PictureFiles
    lens: LensValues
    reading: Reading
    outputs: Outputs
    machine: Machine
    suffix: str = ""  # suffix that distinguishes the lenses of a picture
    shot: Shot | None = None
    split: Split = NO_SPLIT

    def __post_init__(self) -> None:
        """Check the options, and adapt the options for reading depth to the lens.

        Raises:
            UsageProblem: The output format cannot hold the channels of `blur_channels`, or
                `highlights` is on, which would not add light to these channels.
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
        """All input files by role: of the picture, its shot and its lens, and sidecars of depth."""
        files, row = self.picture.files, self.reading.row
        if row.sidecar or row.mask:
            from defocus_core.io.depth_formats.sidecars import files_beside

            files |= files_beside(row, self.picture.depth)
        if self.outputs.need_rendering:
            files |= self.lens.files
        return files if self.shot is None else files | self.shot.files

    @property
    def lens_focal(self) -> float | None:
        """Focal length divided by sensor width; None unless it is needed to read the depth."""
        return self.lens.foclen / self.lens.sensor_width if self.reading.needs_lens else None

    @property
    def sample_id(self) -> str:
        """Name of the sample, the stem of its files: name of the picture and suffix of the lens."""
        return self.picture.stem + self.suffix

    @property
    def names(self) -> dict[str, str]:
        """The files to write, relative to the root, by kind, ``<kind>.preview`` or label."""
        labels = {k: f"{k}/{self.sample_id}{path.suffix}" for k, path in self.picture.carried}
        return self.outputs.names(self.sample_id) | labels

    @property
    def paths(self) -> dict[str, Path]:
        """The path of the output file of each kind."""
        names, root = self.names, self.outputs.root
        return {kind: root / names[kind] for kind in self.outputs.kinds}

    @property
    def previews(self) -> dict[str, Path]:
        """The path of the preview of each kind; empty if no previews are wanted."""
        names = {name: path for name, path in self.names.items() if name.endswith(PREVIEW)}
        return {name.removesuffix(PREVIEW): self.outputs.root / p for name, p in names.items()}

    @property
    def written(self) -> list[Path]:
        """The paths of all files to write: outputs, previews and labels."""
        return [self.outputs.root / name for name in self.names.values()]


def of_views(jobs: Sequence[Job]) -> list[Job]:
    """Split jobs whose option view names several views, like left,right, into one for each.

    The name of the view is added to the file stem.
    """
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

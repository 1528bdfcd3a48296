"""The data of a picture on its path, as passed from stage to stage.

A `Take` is a job in progress, with its inputs, lens, radii and rendered planes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from defocus_core.io.arrays import sample_plane
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.exr.windows import NO_OVERSCAN, Layout, Overscan
from defocus_core.io.images.color import Color
from defocus_core.picture.opening import aperture_in_pixels
from defocus_core.request.job import Job, PictureFiles, Reading
from defocus_core.request.lens import LensValues
from defocus_core.request.output_kinds import Kind
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from torch import Tensor

    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.picture.layers import Layers
    from defocus_core.renderer.engine.scene import Scene
    from defocus_core.renderer.engine.settings import Settings
    from defocus_core.renderer.layers.layer import KnownLayer


class Radii(NamedTuple):
    """The signed CoC radii of a frame."""

    # [H, W] float32. Empty pixels have the greatest radius, so that they hide nothing, and pixels
    # beside them are seen through the whole lens
    px: Any
    limits: tuple[float, float]  # the least and the greatest of non-empty pixels
    infinity: float | None  # radius at infinity; None if the file holds radii
    scale: float  # px for a disparity of 1 per mm; 1 if the file holds radii
    # a note on radii that were limited
    warnings: tuple[str, ...] = ()


_UNKNOWN = Radii(None, (0.0, 0.0), None, 1.0)


@dataclass(frozen=True)
class InputPair:
    """Colour and depth of a picture, before or after decoding, with options for reading them."""

    picture: PictureFiles
    reading: Reading
    # focal length in widths of the sensor, if reading the depth needs it
    lens_focal: float | None = None
    # whether all overscan is wanted, or only what blur reaches
    whole: bool = False
    limit: Overscan | None = None  # greatest overscan in px; None for no limit
    overscan: Overscan = NO_OVERSCAN  # the overscan that both have
    planes: tuple[Color, Depth] | None = None  # colour and depth, once decoded

    @classmethod
    def from_job(cls, job: Job) -> InputPair:
        """The pair of a job, not decoded yet."""
        whole = job.outputs.keep_overscan
        return cls(job.picture, job.reading, job.lens_focal, whole=whole)

    @property
    def color(self) -> Color:
        """The colour; the pair must be decoded."""
        assert self.planes is not None
        return self.planes[0]

    @property
    def depth(self) -> Depth:
        """The depth; the pair must be decoded."""
        assert self.planes is not None
        return self.planes[1]

    @property
    def differs(self) -> bool:
        """Whether colour and depth differ in size."""
        return bool(self.color.shape[:2] != self.depth.metres.shape)

    def with_depth(self, depth: Depth) -> InputPair:
        """The pair with its depth replaced."""
        return replace(self, planes=(self.color, depth))


class Arrays(NamedTuple):
    """A picture in memory, as arrays that are not converted yet."""

    color: Any  # [H, W] or [H, W, C]
    depth: Any  # [H, W]
    matte: Any = None  # [H, W], the coverage of its subject
    hidden: tuple[Any, Any] | None = None  # colour and depth of hidden surfaces


@dataclass(frozen=True)
class Inputs:
    """The decoded inputs of a job; jobs of the same picture share them."""

    arrays_mb: float  # MB of these inputs and of the outputs
    color: Color
    depth: Depth
    hidden: tuple[Color, Depth] | None = None  # colour and depth of the hidden layer, if needed
    plate: InputPair | None = None  # the plate behind it, if it is an element
    layers: Layers | None = None  # of a deep picture, or of an element and its plate
    matte: Any = None  # [H, W], the coverage of its subject, or None
    empty: Any = None  # empty pixels, bool [H, W]; None if there are none
    warnings: tuple[str, ...] = ()  # notes on contents of the files that the renderer ignores
    stamps: Mapping[str, Any] = field(
        default_factory=dict
    )  # size, time and hash of each file, by role
    seconds: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Take:
    """A job in progress: inputs, lens, radii and rendered planes."""

    job: Job  # what was asked for
    inputs: Inputs
    lens: LensValues  # with its focus distance, once known
    radii: Radii = _UNKNOWN  # of the picture, or of the element over a plate
    # [H, W] px, radii of the front surface: the plate where the element is empty
    shown: Any = None
    limits: tuple[float, float] = (0.0, 0.0)  # the least and the greatest radius in the picture
    device: str = "cpu"  # device of rendering
    back: str = "torch"  # back of rendering: compiled loops, or torch
    # arrays [H, W] of each rendered kind: C for each view of an image, in linear light; one for a
    # map
    images: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    # Number of pixels of each kind that were clamped to the range of half
    clamped: Mapping[str, int] = field(default_factory=dict)
    reach: int = 0  # greatest distance in px by which blur moves light
    # number of clipped lights that were made brighter; None if not requested
    lamps: int | None = None
    bound_mb: float = 0.0  # upper bound of rendering memory besides inputs and outputs
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    stats: Mapping[str, float] = field(default_factory=dict)
    repair: DepthRepair | None = None  # how depth was repaired; None if nothing was rendered
    decided: DepthRepair | None = None  # the repair decided by its shot; None if the frame decides
    shot_note: str = ""  # note on decisions by other frames

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the displayed picture, in px."""
        return self.inputs.depth.size

    @cached_property
    def longer_axis(self) -> float:
        """The longer half axis of a blur in px, as a multiple of its CoC radius.

        It is 1 unless pixels are not square.
        """
        return aperture_in_pixels(self.lens, self.inputs.color.pixel_aspect)[1]

    def with_inputs(self, **changes: Any) -> Take:
        """The take with some fields of its `inputs` replaced."""
        return replace(self, inputs=replace(self.inputs, **changes))

    @property
    def color_note(self) -> str:
        """A note on how the colour was read, and on how many clipped lights were brightened."""
        lit = "" if self.lamps is None else f"{counted(self.lamps, 'clipped light')} brightened"
        return ", ".join(filter(None, (self.inputs.color.note, lit)))

    def depth_words(self, *, rendered: bool = True) -> str:
        """A note on how the depth was read and, if `rendered`, how it was repaired."""
        notes = (repair_words(self.repair), self.shot_note) if rendered else ()
        return "; ".join(filter(None, (self.inputs.depth.note, *notes)))


@dataclass(frozen=True)
class Surfaces:
    """The surfaces of a scene: the visible one, or one for each layer, nearest first."""

    take: Take
    # colour of each surface whose depth may be repaired by its edges
    colors: tuple[Color, ...]
    radii: tuple[Radii, ...]  # radii of each surface, computed from its depth
    # colour of each surface [C, H, W], linear, premultiplied, with alpha
    light: tuple[Tensor, ...]
    px: tuple[Tensor, ...]  # radii of each surface [H, W] to render with
    repair: DepthRepair  # of the depth
    coverage: Tensor | None = None  # [L, H, W] of layers; None for a single surface
    hidden: KnownLayer | None = None  # the known hidden layer
    matte: Tensor | None = None  # [H, W], the coverage of the subject, or None
    # number of clipped lights that were made brighter; None if not requested
    lamps: int | None = None


class Pass(NamedTuple):
    """One rendering of a scene, or of some of its colour channels."""

    take: Take
    scene: Scene
    settings: Settings
    channels: tuple[int, ...]  # indices of the planes of the picture that it renders
    light: tuple[int, ...]  # indices of the light planes of the scene, in rendering order
    px: float = 0.0  # added to all radii, in px
    order: tuple[int, ...] = ()  # index of the rendered plane of each channel; empty: as rendered


class Contents(NamedTuple):
    """The channels of an output file."""

    take: Take  # the job in progress
    kind: Kind  # the kind of output
    names: tuple[str, ...]  # names of the channels of colour, or the kind of a map
    planes: tuple[Any, ...]  # arrays [H, W] of these channels
    extras: Mapping[str, Any]
    layout: Layout  # place of the first pixel, display window, views

    def mapped(self, change: Callable[[Any], Any]) -> Contents:
        """The contents with `change` applied to each array [H, W]."""
        extras = {name: change(plane) for name, plane in self.extras.items()}
        return self._replace(planes=tuple(map(change, self.planes)), extras=extras)


def repair_words(repair: DepthRepair | None) -> str:
    """The repair of depth as one line of text; empty if nothing was changed."""
    values = repair_record(repair)
    if values is None or not values["kinds"]:
        return ""
    numbers = (f"{name}={value:g}" for name, value in values.items() if isinstance(value, float))
    return f"repaired {', '.join(values['kinds'])}: {', '.join(numbers)}"


def repair_record(repair: DepthRepair | None) -> dict[str, Any] | None:
    """The repair of depth as a dictionary for JSON; None if it was off.

    `defocus help json` describes its fields.
    """
    if repair is None:
        return None
    kinds = {
        "noise": repair.noise is not None,
        "anti-aliased": repair.antialiased,
        "soft-edges": repair.least_slope is not None and not repair.antialiased,
        "ramps": repair.ramps and repair.least_slope is None,
        "displaced-edges": repair.edge_shifts is not None,
        "few-levels": repair.quantised,
    }
    shift = None if repair.edge_shifts is None else repair.edge_shifts.median
    return {
        "kinds": [kind for kind, is_there in kinds.items() if is_there],
        "noise_px": _round(repair.noise),
        "edge_width_px": _round(repair.edge_width),
        "displaced_px": _round(shift),
        "share": _round(repair.fraction),
    }


def _round(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


_WHITE = 0.9999  # of an integer picture, in linear light
_FLOATS = (".exr", ".hdr")  # formats without a greatest light
RADII = ("coc_mean_px", "coc_p50_px", "coc_p99_px")  # mean, median, 99th percentile, unsigned
# Keys of the measures, in the order of the table of a card.
MEASURES = (*RADII, "clipped_share", "invented_share")


def measures(take: Take) -> dict[str, float | None]:
    """Statistics of a rendered picture for its record; None where a value is unknown.

    Besides those of `radius_measures`, ``clipped_share`` is the share of pixels with a channel at
    its maximum (not for EXR and HDR), and ``invented_share`` that of pixels with trust below 0.99.
    """
    nothing = None if take.inputs.empty is None else sample_plane(take.inputs.empty)
    pixels, invented = take.stats.get("pixels", 0), take.stats.get("pixels_invented")
    color, clipped = take.inputs.color, None
    if color.path.suffix.lower() not in _FLOATS:
        white = [sample_plane(plane) >= _WHITE for plane in color.light]
        clipped = float(np.mean(np.any(white, axis=0)))
    return {
        **radius_measures(sample_plane(take.shown), nothing),
        "clipped_share": clipped,
        "invented_share": None if invented is None or not pixels else invented / pixels,
    }


def radius_measures(radius: Any, nothing: Any) -> dict[str, float]:
    """Mean, median and 99th percentile of |radius| in px, without the empty pixels `nothing`."""
    sizes = np.abs((radius if nothing is None else radius[~nothing]).astype("float64"))
    if not sizes.size:
        return dict.fromkeys(RADII, 0.0)
    # as `np.percentile` has them, which imports a tenth of NumPy
    ordered, place = np.sort(sizes, axis=None), np.array([0.5, 0.99]) * (sizes.size - 1)
    percentiles = np.interp(place, np.arange(sizes.size), ordered)
    return dict(zip(RADII, map(float, (sizes.mean(), *percentiles)), strict=True))

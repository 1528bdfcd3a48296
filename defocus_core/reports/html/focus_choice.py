"""A page for choosing focus and blur: small rendered pictures, and the command of each.

The pictures differ in the distance in focus (`_FOCUSES` surfaces), the strength of the blur
(`_STRENGTHS`) and, for relative depth, in whether large or small numbers are near. The page shows
the picture nearest to what the reader chooses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, printable
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.exr.windows import NO_OVERSCAN
from defocus_core.io.images.color import Color
from defocus_core.io.images.encode import display_encoded, srgb_matrix
from defocus_core.picture.focus import in_pixels
from defocus_core.picture.memory_budget import arrays_mb
from defocus_core.picture.pair import read
from defocus_core.picture.plain_path import compute, load, prepare
from defocus_core.picture.subject import FoundPixel, on_ramp, subject_of, surface_of
from defocus_core.picture.take import InputPair, Inputs
from defocus_core.reports.html.item import LIGHT, PLAIN, Item, Layer
from defocus_core.reports.html.layers import pack
from defocus_core.reports.html.page import KEYS, plain, write_page
from defocus_core.reports.html.thumbnails import encoded, resized
from defocus_core.request.job import Job, Machine, Outputs, PictureFiles, Reading
from defocus_core.request.lens import LensValues
from defocus_core.request.parameters import LENS_OPTIONS
from defocus_core.request.quantities import Unitless
from defocus_core.system.text import command_line

Progress = Callable[[int, int], None]
_FOCUSES = 8
_STRENGTHS = (0.25, 0.5, 1.0, 2.0, 4.0)  # factors of the given blur
_ASKED = _STRENGTHS.index(1.0)
_PIXELS, _WIDEST = 240_000, 1000  # pixels of a picture, and px of its width
_JPEG = "jpeg:85"  # makes a page of a few MB for a photograph, and of less than 30 MB for noise
_TOP = 65535  # steps of the map
_BINS = 256
_MM_PER_M = 1000.0
_KEYS = (
    ("← →", "focus nearer or farther"),
    ("↑ ↓", "more or less blur"),
    ("c", "copy the command"),
)
_TURN = ("i", "the other end of the depth is near")


class _Small(NamedTuple):
    """A picture reduced to the size of the page."""

    inputs: Inputs  # its colour and depth
    scale: float  # its width over that of the picture
    # [H, W] numbers of relative depth, or 1/m; greater is nearer, unless black is near
    disparity: NDArray[np.float64]


class _Focus(NamedTuple):
    """What is in focus in some of the pictures."""

    value: float  # its disparity
    place: tuple[int, int]  # a pixel of the picture where it is
    sharp: Unitless | None = None  # the numbers of its surface

    def plain(self) -> dict[str, object]:
        """The fields for JSON, with the sharp range as an option of the command line."""
        sharp = "" if self.sharp is None else LENS_OPTIONS["sharp-range"].text(self.sharp)
        option = f" --sharp-range {sharp}" if sharp else ""
        return {"value": self.value, "place": self.place, "sharp": option}


# Which end of relative depth is near: the direction of nearer focuses, and the option.
_END = {
    False: {"near": 1, "words": "white is near", "option": " --no-invert"},
    True: {"near": -1, "words": "black is near", "option": " --invert"},
}


def write_choice(
    picture: PictureFiles,
    lens: LensValues,
    reading: Reading,
    path: Path,
    machine: Machine,
    progress: Progress | None = None,
    *,
    command: Sequence[str],
    whole_surface: bool = False,
    either_end: bool = False,
) -> None:
    """Write the page on which focus and blur of a picture are chosen.

    `command`: the words of the command that renders the picture, without focus and strength.
    `whole_surface`: whether all of the surface in focus is sharp. `either_end`: whether the reader
    chooses which end of relative depth is near.
    """
    load()
    job = Job(picture, lens, reading, Outputs(Path()), machine)
    color, depth = read(InputPair(picture, job.reading, lens_focal=job.lens_focal))
    if depth.is_radius and not depth.is_relative:
        problem, remedy = "holds radii, which have a focus already", "give depth"
        raise InputError("radii", problem, remedy, path=depth.path)
    small, lens = _reduced(job, color, depth), in_pixels(lens, depth)
    focuses = _focuses(small, lens, depth, whole_surface)
    if whole_surface:
        lens = replace(lens, sharp_range=None)
        job = replace(job, lens=lens)
    strengths, inverted = _strengths(lens), depth.inverted
    ends: tuple[bool, ...] = (inverted,)
    if either_end and depth.is_relative:
        ends = inverted, not inverted
    layer = Layer("render", "render", LIGHT, ("R", "G", "B"), depth.size, None)
    sharp = replace(layer, key="input", title="input", thumbnail=_jpeg(small.inputs.color))
    renders = [[[layer] * len(strengths) for _ in focuses] for _ in ends]
    count = len(ends) * len(focuses) * len(strengths)
    for done, (end, at, n) in enumerate(np.ndindex(len(ends), len(focuses), len(strengths)), 1):
        each = replace(job, lens=_refocused(strengths[n], focuses[at], small.scale))
        renders[end][at][n] = replace(layer, thumbnail=_rendered(each, small.inputs, ends[end]))
        if progress:
            progress(done, count)
    item = Item(picture.color.name, "", passes=True, layers=[sharp, _depth_layer(small, depth)])
    payloads: dict[str, str] = {}
    data = {
        "items": [plain(item, payloads)],
        "renders": plain(renders, payloads),
        "metric": not depth.is_relative,
        "focuses": [each.plain() for each in focuses],
        "strengths": [_strength_words(each) for each in strengths],
        "place": list(lens.focus_at or subject_of(depth).scaled(depth.size)),
        "strength": _ASKED,
        "ends": [_END[is_black] for is_black in ends],
        "command": command_line([*command, "-o", f"out.{'jpg' if color.within_white else 'exr'}"]),
    }
    title = f"Focus and blur of {printable(picture.color.name)}"
    write_page(
        path,
        "choose",
        data=data,
        payloads=payloads,
        title=title,
        keys=(*_KEYS, *(_TURN,) * (len(ends) - 1), *KEYS),
    )


def focuses_of(disparity: NDArray[np.float64]) -> list[float]:
    """At most `_FOCUSES` disparities to focus on, ascending, each of which occurs in the picture.

    Their density is proportional to the cube root of the density of the pixels, which minimises
    the mean squared distance of a pixel to the nearest of them (Panter and Dite 1951).
    """
    low, high = float(disparity.min()), float(disparity.max())
    if low == high:
        return [low]
    counts, edges = np.histogram(disparity, _BINS, (low, high))
    weight = np.concatenate([[0.0], np.cumsum(np.cbrt(counts))])
    ends = np.interp(np.linspace(0, weight[-1], _FOCUSES + 1), weight, edges)
    values = np.sort(disparity, axis=None)
    starts = np.searchsorted(values, ends)
    starts[-1] = len(values)
    pairs = pairwise(starts)
    return sorted({float(values[(a + b) // 2]) for a, b in pairs if b > a})


def _rendered(job: Job, inputs: Inputs, inverted: bool) -> bytes:
    """The rendered small picture, as a JPEG; `inverted`: whether black is near."""
    inputs = replace(inputs, depth=replace(inputs.depth, inverted=inverted))
    image = compute(prepare(job, inputs)).images["render"]
    return _jpeg(replace(inputs.color, planes=tuple(image)))


def _focuses(small: _Small, lens: LensValues, depth: Depth, whole_surface: bool) -> list[_Focus]:
    """The choices of focus.

    With `whole_surface`, the focus of the lens takes the place of the choice nearest to it.
    """
    shows_surface = ~on_ramp(small.disparity)
    if not shows_surface.any():
        shows_surface[:] = True
    values = focuses_of(small.disparity[shows_surface])
    focuses = [_Focus(value, _place_of(small, value, shows_surface)) for value in values]
    if not whole_surface:
        return focuses
    focuses = [
        each._replace(sharp=surface_of(depth, FoundPixel(*each.place, depth.size)))
        for each in focuses
    ]
    assert lens.focus_at is not None
    x, y = lens.focus_at
    own = _Focus(float(depth.metres[y, x]), (x, y), Unitless(lens.sharp_range or ()) or None)
    apart = [abs(each.value - own.value) for each in focuses]
    focuses[apart.index(min(apart))] = own
    return focuses


def _strengths(lens: LensValues) -> list[LensValues]:
    """The lens with each strength of blur, rounded as the command has it."""
    if isinstance(lens.blur, float):
        blurs = (float(f"{lens.blur * factor:.3g}") for factor in _STRENGTHS)
        return [replace(lens, blur=blur) for blur in blurs]
    numbers = (float(f"{lens.fnum / factor:.3g}") for factor in _STRENGTHS)
    return [replace(lens, fnum=number) for number in numbers]


def _refocused(lens: LensValues, focus: _Focus, scale: float) -> LensValues:
    """The lens with that focus, for a picture whose width is `scale` times that of the original."""
    sharp = lens.sharp_range if focus.sharp is None else focus.sharp
    lens = replace(lens, focus_at=None, focus_percentile=None, sharp_range=sharp)
    clamp = None if lens.clamp_blur is None else lens.clamp_blur * scale
    if isinstance(lens.blur, float):
        return replace(lens, blur=lens.blur * scale, clamp_blur=clamp, focus_value=focus.value)
    distance = _MM_PER_M / focus.value if focus.value else math.inf
    return replace(lens, clamp_blur=clamp, foc_dist=distance)


def _reduced(job: Job, color: Color, depth: Depth) -> _Small:
    """The picture reduced to the size of the page: colour by mean light, depth by nearest pixel."""
    width, height = color.size
    scale = min(1.0, _WIDEST / width, math.sqrt(_PIXELS / (width * height)))
    size = max(1, round(height * scale)), max(1, round(width * scale))
    cut = color.overscan.shown(*color.shape[:2])
    whole = (np.asarray(plane[cut[0]][:, cut[1]], np.float32) for plane in color.planes)
    shown = zip(whole, color.channels, strict=False)
    planes = [resized(plane[:, :, None], size)[:, :, 0] for plane, _ in shown]
    down, across = (
        place.start + ((np.arange(few) + 0.5) * many / few).astype(int)
        for place, few, many in zip(cut, size, (height, width), strict=True)
    )
    metres = np.ascontiguousarray(depth.metres[:][np.ix_(down, across)])
    empty = None if depth.empty is None else depth.empty[:][np.ix_(down, across)]
    inputs = Inputs(
        arrays_mb(job),
        replace(color, planes=tuple(planes), passes=(), extras={}, overscan=NO_OVERSCAN),
        replace(depth, metres=metres, empty=empty, overscan=NO_OVERSCAN),
        empty=empty,
    )
    disparity = metres.astype(np.float64)
    if not depth.is_relative:
        disparity = 1 / disparity
    return _Small(inputs, size[1] / width, disparity)


def _jpeg(color: Color) -> bytes:
    """A picture as a JPEG in sRGB."""
    samples: NDArray[np.uint8] = display_encoded(
        np.stack([plane[:] for plane in color.planes], axis=2),
        color.channels,
        8,
        keep_alpha=False,
        to_srgb=srgb_matrix(color.path, color.channels, color.attributes),
    )[0]
    samples = np.repeat(samples, 3, axis=2) if samples.shape[2] == 1 else samples
    return encoded(samples, "jpeg", {"Compression": _JPEG})


def _depth_layer(small: _Small, depth: Depth) -> Layer:
    """The layer of the disparity, in 65536 steps, or in the whole numbers of the file."""
    low, high = ends = float(small.disparity.min()), float(small.disparity.max())
    if high - low <= _TOP and (small.disparity == small.disparity.round()).all():
        high = low + _TOP
    share = (small.disparity - low) / ((high - low) or 1.0)
    steps = pack(np.round(share * _TOP).astype(np.uint16)[None], (0, 0, *depth.size))
    values = replace(steps, ends=(low, high), inverse=not depth.is_relative)
    unit = "" if depth.is_relative else "m"
    names = ("depth", "depth", PLAIN, ("depth",))
    return Layer(*names, depth.size, ends=ends, values=values, unit=unit)


def _place_of(small: _Small, value: float, shows_surface: NDArray[np.bool_]) -> tuple[int, int]:
    """The pixel (x, y) of the original picture in the middle of a surface of that disparity."""
    rows, columns = np.nonzero((small.disparity == value) & shows_surface)
    best = np.argmin(np.hypot(rows - rows.mean(), columns - columns.mean()))
    x, y = (int((each[best] + 0.5) / small.scale) for each in (columns, rows))
    return x, y


def _strength_words(lens: LensValues) -> dict[str, str]:
    """The strength of the blur of a lens, in words and as an option of the command line."""
    if lens.blur is None:
        return {"words": f"f/{lens.fnum:g}", "option": f"--fnumber {lens.fnum:g}"}
    text = LENS_OPTIONS["blur"].text(lens.blur)
    return {"words": f"blur {text}", "option": f"--blur {text}"}

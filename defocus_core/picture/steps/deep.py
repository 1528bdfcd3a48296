"""Deep pictures: the samples of each pixel as layers for the renderer.

What lies behind each other is known, with its coverage; nothing is invented where the file knows
better. Colour and depth of such a file are those of its picture in focus and of its first surface.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.errors import InputError
from defocus_core.io.arrays import Keeping, bands, count_of
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.depth_formats.depth_numbers import DepthNumbers
from defocus_core.io.depth_formats.resolving import resolved
from defocus_core.io.depth_formats.rules import decoded
from defocus_core.io.exr.channel_choice import choose_color
from defocus_core.io.exr.deep_samples import ALPHA, BACK, DEPTH, FRONT
from defocus_core.io.exr.header import Header, is_exr, read_headers
from defocus_core.io.exr.reading import read_layers
from defocus_core.io.exr.views import in_view
from defocus_core.io.images.color_planes import Color
from defocus_core.io.safe_files import read_head
from defocus_core.picture.layers import Layers, flat_layer
from defocus_core.picture.steps.plate import Plate
from defocus_core.system.text import counted


def layers_of_scene(
    picture: Picture,
    reading: Reading,
    part: int | None,
    like: tuple[Color, Depth],
    plate: Plate | None,
    keeping: Keeping,
    lens_focal: float | None,
) -> Layers | None:
    """The layers of a picture, with its plate and its holdout; None if nothing is deep."""
    header = deep_header(picture, reading, part)
    headers = [header, None if plate is None else deep_header(plate.picture, plate.reading, None)]
    if headers == [None, None] and picture.holdout is None:
        return None
    if picture.hidden is not None:
        problem = "is given ‹hidden›, but what its samples or its holdout hide is known"
        raise InputError("contradiction", problem, "leave ‹hidden› out", path=picture.color)
    layers = _layers(picture, headers[0], reading, like, keeping, lens_focal)
    if plate is not None:
        below = plate.picture, headers[1], plate.reading, (plate.color, plate.depth)
        layers = layers.before(_layers(*below, keeping, lens_focal))
    if picture.holdout is not None:
        black = keeping.new(like[1].metres.shape, np.float16)
        holdout = _holdout(picture.holdout, reading, like, keeping, lens_focal)
        layers = layers.held_out_by(holdout, black)
    return layers.tidy(keeping)


def _layers(
    picture: Picture,
    header: Header | None,
    reading: Reading,
    like: tuple[Color, Depth],
    keeping: Keeping,
    lens_focal: float | None,
) -> Layers:
    """The layers of one picture: its samples, or a single one if it is not deep."""
    if header is None:
        return flat_layer(*like)
    return read_deep(picture, header, reading, like, keeping, lens_focal)


def _holdout(
    holdout: Picture,
    reading: Reading,
    like: tuple[Color, Depth],
    keeping: Keeping,
    lens_focal: float | None,
) -> Layers:
    """The samples of a deep holdout, without light."""
    color, depth = like
    path = holdout.color
    headers = read_headers(path) if is_exr(read_head(path)) else ()
    deep = [header for header in headers if header.deep]
    if len(deep) != 1:
        problem = f"holds {len(deep)} deep parts" if deep else "holds no deep data"
        raise InputError("empty", problem, "give ‹holdout› a deep EXR of one part", path=path)
    display = deep[0].display
    if (display.width, display.height) != color.size:
        width, height = color.size
        problem = f"is {display.width}x{display.height} px but the picture is {width}x{height} px"
        raise InputError("wrong-size", problem, "give a holdout of its size", path=path)
    like = (color, replace(depth, path=path, channel=DEPTH))
    return _sampled(path, deep[0], (), reading, like, keeping, lens_focal)


def deep_header(picture: Picture, reading: Reading, part: int | None) -> Header | None:
    """The part of a picture's colour if it is deep."""
    if not is_exr(read_head(picture.color)):
        return None
    headers = in_view(picture.color, read_headers(picture.color), reading.view)
    if not any(header.deep for header in headers):
        return None
    header = choose_color(picture.color, headers, layer=reading.color_layer, part=part).header
    return header if header.deep else None


def read_deep(
    picture: Picture,
    header: Header,
    reading: Reading,
    like: tuple[Color, Depth],
    keeping: Keeping,
    lens_focal: float | None,
) -> Layers:
    """Read the samples of a deep picture."""
    color, depth = like
    if picture.depth != picture.color or depth.channel != DEPTH:
        problem = "is deep: its samples have a depth of their own, channel Z"
        raise InputError(
            "deep-data", problem, "leave the depth file and ‹depth-channel› out", path=picture.color
        )
    names = {channel.plain: channel.name for channel in header.channels}
    sources = tuple(names[name] for name in (*color.channels[: len(color.light)], *color.passes))
    return _sampled(picture.color, header, sources, reading, like, keeping, lens_focal)


def _sampled(
    path: Path,
    header: Header,
    sources: tuple[str, ...],
    reading: Reading,
    like: tuple[Color, Depth],
    keeping: Keeping,
    lens_focal: float | None,
) -> Layers:
    """The samples of a deep part as layers, with the channels of light that are wanted."""
    color, depth = like
    read = read_layers(path, header, sources, keeping, color.overscan)
    reading = replace(reading, part=None)

    def metres_of(numbers: Any) -> Any:
        return _metres(numbers, reading, color, depth, keeping, lens_focal)

    metres = [metres_of(layer[DEPTH]) for layer in read.layers]
    ends = tuple(
        (metres_of(layer[FRONT]), metres_of(layer[BACK])) if BACK in layer else None
        for layer in read.layers
    )
    alpha = tuple(layer[ALPHA] for layer in read.layers)
    depths = tuple(_depth(depth, *pair) for pair in zip(metres, alpha, strict=True))
    light = tuple(tuple(layer[name] for name in sources) for layer in read.layers)
    return Layers(light, alpha, depths, len(color.light), read.merged, ends=ends)


def _metres(
    numbers: Any,
    reading: Reading,
    color: Color,
    like: Depth,
    keeping: Keeping,
    lens_focal: float | None,
) -> Any:
    """Metres [H, W] of the numbers of a layer, read as those of the first surface."""
    samples = DepthNumbers(numbers, "EXR", "", channel=like.channel)
    decoding = resolved(
        like.path, reading, samples, picture_width=color.size[0], lens_focal=lens_focal
    )
    metres, frame = keeping.new(numbers.shape, "float32"), (numbers.shape[0], numbers.shape[1])
    for rows in bands(numbers.shape):
        metres[rows] = decoded(
            numbers[rows], decoding, first_row=rows.start, frame=frame, overscan=like.overscan
        )
    return metres


def _depth(like: Depth, metres: Any, alpha: Any) -> Depth:
    """The depth of one layer; infinitely far where it has no sample."""
    for rows in bands(metres.shape):
        far = np.float32(0 if like.is_radius else np.inf)
        metres[rows] = np.where(np.asarray(alpha[rows]) > 0, metres[rows], far)
    depth = replace(like, metres=metres, nothing=None)
    count, first = count_of((~depth.valid(rows), rows.start) for rows in bands(metres.shape))
    if count:
        problem = f"is NaN or ≤ 0 in {counted(count, 'sample')}, the first in pixel {first}"
        raise InputError(
            "not-finite", problem, "write inf for sky, and leave other samples out", path=like.path
        )
    return depth

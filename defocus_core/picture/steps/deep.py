"""Deep pictures: make layers for the renderer from the samples of each pixel.

Of the inputs, colour remains that of the flattened picture, and depth that of the first surface.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from defocus_core.errors import InputError
from defocus_core.io.arrays import count_of
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.depth_formats.reading import DepthNumbers
from defocus_core.io.depth_formats.rules import decoded, resolved
from defocus_core.io.exr.channel_choice import choose_color, in_view
from defocus_core.io.exr.deep_layers import deep_layers
from defocus_core.io.exr.deep_samples import ALPHA, DEPTH
from defocus_core.io.exr.header import Header, is_exr, read_headers
from defocus_core.io.read_files import read_head
from defocus_core.picture.layers import Layers, flat_layer
from defocus_core.picture.pair import parts_of
from defocus_core.picture.take import InputPair, Take
from defocus_core.system.text import counted


def read(take: Take) -> Take:
    """Make layers of the picture and of its plate and holdout, if any."""
    inputs, plate = take.inputs, take.inputs.plate
    wanted = InputPair.from_job(take.job)
    picture = wanted.picture
    if picture.hidden is not None:
        problem = "is given ‹hidden›, but what its samples or its holdout hide is known"
        raise InputError("contradiction", problem, "leave ‹hidden› out", path=picture.color)
    layers = _layers(replace(wanted, planes=(inputs.color, inputs.depth)))
    if plate is not None:
        layers = layers.stacked_over(_layers(plate))
    if picture.holdout is not None:
        black = np.zeros(inputs.depth.metres.shape, np.float16)
        hiding = replace(wanted, picture=picture.holdout, planes=(inputs.color, inputs.depth))
        layers = layers.hold_out(_holdout(hiding), black)
    layers = layers.cut()
    note = f"{inputs.color.note}, {layers.words}"
    return take.with_inputs(
        color=replace(inputs.color, note=note), layers=None if layers.is_flat else layers
    )


def _layers(pair: InputPair) -> Layers:
    """The layers of one picture: those of its samples; or a single one if it is not deep."""
    picture, reading, color, header = pair.picture, pair.reading, pair.color, None
    if is_exr(read_head(picture.color)):
        headers = in_view(picture.color, read_headers(picture.color), reading.view)
        if any(each.deep for each in headers):
            part, _ = parts_of(picture, reading)
            header = choose_color(
                picture.color, headers, layer=reading.color_layer, part=part
            ).header
    if header is None or not header.deep:
        return flat_layer(color, pair.depth)
    if picture.depth != picture.color or pair.depth.channel != DEPTH:
        problem = "is deep: its samples have a depth of their own, channel Z"
        remedy = "leave the depth file and ‹depth-channel› out"
        raise InputError("deep-data", problem, remedy, path=picture.color)
    names = {channel.plain: channel.name for channel in header.channels}
    sources = tuple(names[name] for name in (*color.channels[: len(color.light)], *color.passes))
    return _read_samples(pair, header, sources)


def _holdout(pair: InputPair) -> Layers:
    """The layers of a deep holdout, without light."""
    color, path = pair.color, pair.picture.color
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
    return _read_samples(
        pair.with_depth(replace(pair.depth, path=path, channel=DEPTH)), deep[0], ()
    )


def _read_samples(pair: InputPair, header: Header, sources: tuple[str, ...]) -> Layers:
    """Read the samples of a deep part as layers; `sources` are the channels to read as light."""
    color, depth = pair.color, pair.depth
    path = pair.picture.color
    layers, merged = deep_layers(path, header, sources, color.overscan)
    metres = [_metres(layer[DEPTH], pair) for layer in layers]
    alpha = tuple(layer[ALPHA] for layer in layers)
    depths = tuple(_depth(depth, *both) for both in zip(metres, alpha, strict=True))
    light = tuple(tuple(layer[name] for name in sources) for layer in layers)
    return Layers(light, alpha, depths, len(color.light), merged)


def _metres(numbers: Any, pair: InputPair) -> Any:
    """Convert depth numbers of a layer to metres [H, W], like those of the first surface."""
    like = pair.depth
    samples = DepthNumbers(like.path, numbers, "EXR", "", channel=like.channel)
    return decoded(numbers, resolved(pair.reading, samples, pair.lens_focal), like.overscan)


def _depth(like: Depth, metres: Any, alpha: Any) -> Depth:
    """The depth of a layer, infinite where alpha is 0; `like` is that of the first surface."""
    metres[~(np.asarray(alpha) > 0)] = 0 if like.is_radius else np.inf
    depth = replace(like, metres=metres, empty=None)
    count, first = count_of(depth.invalid)
    if count:
        problem = f"is NaN or ≤ 0 in {counted(count, 'sample')}, the first in pixel {first}"
        remedy = "write inf for sky, and leave other samples out"
        raise InputError("not-finite", problem, remedy, path=like.path)
    return depth

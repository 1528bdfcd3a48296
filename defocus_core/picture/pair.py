"""Colour and depth of a picture: decoded, brought to one size, and checked."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.depth_formats.depth import Depth, depth_of, read_depth, require_valid
from defocus_core.io.depth_formats.exr_depth_channel import NoDepthChannel, choose_depth_channel
from defocus_core.io.depth_formats.reading import DepthNumbers, stretched, wrong_size
from defocus_core.io.exr.channel_choice import choose_color, in_view, require_part, require_view
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan
from defocus_core.io.images.color import SHARP_INSIDE, Color, read_color, require_finite
from defocus_core.io.images.describe import describe
from defocus_core.io.read_files import read_head
from defocus_core.picture.scene import map_on, picture_on
from defocus_core.picture.steps.table import PAIR, WINDOW, apply_steps
from defocus_core.picture.take import Arrays, InputPair, Inputs
from defocus_core.request.job import Job, PictureFiles, Reading
from defocus_core.system import memory
from defocus_core.system.text import note


def read(wanted: InputPair) -> tuple[Color, Depth]:
    """Read colour and depth, resize depth to the size of colour, and check all pixels."""
    picture, asked = wanted.picture, wanted.reading.resize_depth
    shared = picture.color == picture.depth
    if shared and wanted.reading.resize_depth is None and not is_exr(read_head(picture.color)):
        reading = replace(wanted.reading, resize_depth="guided")  # smaller in a photograph
        wanted = replace(wanted, reading=reading)
    require_view((picture.color, picture.depth), wanted.reading.view)
    decoded = _decode(apply_steps(WINDOW, wanted))
    if asked is not None and not decoded.differs:
        words = f"{picture.depth.name}: ‹resize-depth› {asked}: it has the size of the colour"
        depth = decoded.depth
        decoded = decoded.with_depth(replace(depth, warnings=(*depth.warnings, words)))
    if decoded.color.note.endswith(SHARP_INSIDE):
        note(f"defocus: {picture.color}: {SHARP_INSIDE} is rendered")
    return _completed(decoded)


def _completed(decoded: InputPair) -> tuple[Color, Depth]:
    """Apply the steps for decoded pairs, such as resizing depth; then check all pixels."""
    pair = apply_steps(PAIR, decoded)
    require_valid(pair.depth)
    require_finite(pair.color)
    return pair.color, pair.depth


def parts_of(picture: PictureFiles, reading: Reading) -> tuple[int | None, int | None]:
    """The number of the part to read in the colour file, and in the depth file.

    A part is one of a multi-part EXR, a page of a TIFF or a frame of an array. None stands for a
    file that has only one.
    """
    if reading.part is None:
        return None, None
    from defocus_core.io.array_files import has_frames

    if has_frames(picture.depth):
        return reading.part if len(describe(picture.color).parts) > 1 else None, reading.part
    paths = (picture.color, picture.depth)
    color, depth = (len(describe(path).parts) for path in paths)
    if picture.color == picture.depth or max(color, depth) == 1:
        require_part(picture.color, reading.part, color)
    return reading.part if color > 1 else None, reading.part if depth > 1 else None


def _decode(wanted: InputPair) -> InputPair:
    """Decode the colour and the depth file."""
    picture, reading = wanted.picture, wanted.reading
    color_part, depth_part = parts_of(picture, reading)
    shared = picture.color == picture.depth
    color = read_color(
        picture.color,
        layer=reading.color_layer,
        part=color_part,
        view=reading.view,
        overscan=wanted.overscan,
        blur_channels=reading.blur_channels,
        original=shared,
    )
    if shared and reading.row.is_right_half:
        left = tuple(plane[:, : color.size[0] // 2] for plane in color.planes)
        color = replace(color, planes=left)
    depth = read_depth(
        picture.depth,
        replace(reading, part=depth_part),
        size=color.size,
        lens_focal=wanted.lens_focal,
        overscan=wanted.overscan,
        alpha=color.alpha,
    )
    radial = (reading.geometry or reading.row.geometry) == "radial"
    if radial and color.pixel_aspect != 1:
        problem = "holds distances to the point, and the pixels of the colour are not square"
        remedy = "convert it to depth along the axis"
        raise InputError("not-square", problem, remedy, path=picture.depth)
    lone = len(color.channels) == 1 and not color.extras and depth.channel != ""
    if shared and (lone or depth.channel in color.channels):
        problem = f"has {depth.channel} alone, which is not both colour and depth"
        remedy = "give the depth file as a second argument"
        raise InputError("no-depth", problem, remedy, path=picture.color)
    return replace(wanted, planes=(color, depth))


def overscan_of(wanted: InputPair) -> Overscan:
    """The overscan, pixels beyond the display window, that colour and depth of a picture both have.

    A depth file that is no EXR has overscan if its size is that of the colour's display window
    together with its overscan.
    """
    picture, reading, whole = wanted.picture, wanted.reading, wanted.whole
    color_part, depth_part = parts_of(picture, reading)
    if not is_exr(read_head(picture.color)):
        return NO_OVERSCAN
    headers = in_view(picture.color, read_headers(picture.color), reading.view)
    color = choose_color(picture.color, headers, layer=reading.color_layer, part=color_part).header
    overscan = color.data.overscan(color.display, whole=whole)
    if not any(overscan):
        return NO_OVERSCAN
    if not is_exr(read_head(picture.depth)):
        info, frame = describe(picture.depth), color.display.grown(overscan)
        is_whole = (info.width, info.height) == (frame.width, frame.height)
        return overscan if is_whole else NO_OVERSCAN
    headers = in_view(picture.depth, read_headers(picture.depth), reading.view)
    deeper = replace(reading, part=depth_part)
    try:
        depth = choose_depth_channel(picture.depth, headers, deeper).header
    except NoDepthChannel:  # a plate needs none; for others the reader reports it
        return overscan
    return overscan.smaller(depth.data.overscan(depth.display, whole=whole))


def read_overscan(wanted: InputPair) -> InputPair:
    """Set how much overscan to read, the pixels beyond the display window."""
    overscan = overscan_of(wanted)
    return replace(wanted, overscan=overscan.smaller(wanted.limit or overscan))


def stretch_words(share: float) -> str:
    """A note on the share by which an aspect ratio was changed; empty if it is 0."""
    return f", stretched by {abs(share):.2%}" if share else ""


def resized(given: InputPair) -> InputPair:
    """Resize depth to the size of colour, without averages of two surfaces."""
    color, depth, reading = given.color, given.depth, given.reading
    (height, width), (rows, columns) = color.shape[:2], depth.metres.shape
    share = stretched((columns, rows), (width, height))
    is_smaller = columns < width and rows < height
    if share is None or (reading.resize_depth is None and not is_smaller):
        raise wrong_size(depth.path, (rows, columns), (width, height))
    if depth.is_radius and not depth.is_relative:
        problem = f"holds radii in px of a picture of {columns}x{rows} px"
        raise InputError("radii", problem, "give radii of the size of the colour", path=depth.path)
    size = f"{columns}x{rows} px resized"
    if reading.resize_depth is None:
        words = f"{depth.path.name}: {size} to {width}x{height} px, guided by the colours"
        depth = replace(depth, warnings=(*depth.warnings, words))
    if reading.resize_depth != "nearest":
        require_valid(depth)
        metres = _guided(depth, color)
        note = f"{depth.note}, {size}, guided by the colours{stretch_words(share)}"
        return given.with_depth(replace(depth, metres=metres, note=note))
    across = ((np.arange(width) + 0.5) * columns / width).astype(int)
    down = ((np.arange(height) + 0.5) * rows / height).astype(int)
    metres = depth.metres[down][:, across]
    note = f"{depth.note}, {size} by nearest{stretch_words(share)}"
    return given.with_depth(replace(depth, metres=metres, note=note))


def _guided(depth: Depth, color: Color) -> NDArray[np.float32]:
    """Resize depth to the size of colour, with its edges where the colours change; [H, W]."""
    import torch

    from defocus_core.depth.guided_resize import guided_depth

    given, image = map_on(depth.metres, "cpu"), picture_on(color.planes, "cpu")
    if not depth.is_relative:
        metres: NDArray[np.float32] = guided_depth(given, image).numpy()
        return metres
    # Disparity of any scale, mapped to 1 at its farthest and 2 at its nearest number.
    far, near = (float(end) for end in torch.aminmax(given))
    if depth.inverted:
        far, near = near, far
    scale = (near - far) or 1.0
    guided = guided_depth(1 / (1 + (given - far) / scale), image)
    numbers: NDArray[np.float32] = (far + scale * (1 / guided - 1)).float().numpy()
    return numbers


def of_arrays(job: Job, arrays: Arrays) -> Inputs:
    """The inputs of a job from arrays in memory. Integer colours are sRGB, floats linear light."""
    from defocus_core.io.images.color_space import unit

    color, depth = _pair_of_arrays(job, arrays.color, arrays.depth)
    hidden = None if arrays.hidden is None else _pair_of_arrays(job, *arrays.hidden)
    if hidden is not None and hidden[0].shape != color.shape:
        raise ValueError(f"hidden must be shaped as the picture {list(arrays.color.shape)}")
    size, matte = depth.metres.shape, arrays.matte
    if matte is not None:
        matte = unit(matte) if matte.dtype.kind == "u" else np.asarray(matte, np.float32)
        if matte.shape != size or not ((matte >= 0) & (matte <= 1)).all():
            got = f"{list(matte.shape)} in {matte.min():g} to {matte.max():g}"
            raise ValueError(f"matte must be {list(size)} in 0 to 1, got {got}")
    held = sum(plane.nbytes for plane in (*color.planes, depth.metres)) / memory.MB
    held *= 1 + (hidden is not None) + len(job.outputs.kinds)
    said = (*color.warnings, *depth.warnings)
    return Inputs(held, color, depth, hidden, matte=matte, empty=depth.empty, warnings=said)


def _pair_of_arrays(job: Job, color: NDArray[Any], depth: NDArray[Any]) -> tuple[Color, Depth]:
    """Colour and depth from arrays, checked and brought to one size."""
    from defocus_core.io.images.color_space import linear_light, unit
    from defocus_core.io.images.raster import PLAIN_CHANNELS

    if color.ndim not in (2, 3) or depth.ndim != 2 or not color.size or not depth.size:
        got = f"{list(color.shape)} and {list(depth.shape)}"
        raise ValueError(f"color must be [H, W, C] and depth [H, W], got {got}")
    pixels = color if color.ndim == 3 else color[:, :, None]
    channels = PLAIN_CHANNELS.get(pixels.shape[2])
    if channels is None or pixels.dtype.str[1:] not in ("u1", "u2", "f2", "f4", "f8"):
        problem = f"is of {pixels.shape[2]} channels of {pixels.dtype}"
        remedy = "give [H, W, C] of 1 to 4 channels, of floats, uint8 or uint16"
        raise InputError("wrong-type", problem, remedy, path=job.picture.color)
    alpha = unit(pixels[:, :, -1:]) if channels[-1] == "A" else None
    whole = pixels.dtype.kind == "u"
    if whole:
        light = linear_light(pixels[:, :, : len(channels) - (alpha is not None)], alpha, gamma=None)
        pixels = light if alpha is None else np.concatenate([light, alpha], axis=2)
    planes = tuple(np.ascontiguousarray(np.moveaxis(pixels, 2, 0), np.float32))
    note = f"{color.dtype} in memory, {'sRGB' if whole else 'linear'}"
    kind = "NPY" if depth.dtype.kind == "f" else "integer NPY"
    numbers = DepthNumbers(job.picture.depth, depth, kind, f"{depth.dtype} in memory")
    decoded = (
        Color(planes, tuple(channels), job.picture.color, note=note, within_white=whole),
        depth_of(numbers, job.reading, lens_focal=job.lens_focal),
    )
    return _completed(replace(InputPair.from_job(job), planes=decoded))

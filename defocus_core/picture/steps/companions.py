"""Steps for what accompanies a picture: a plate, hidden surfaces, and a matte.

A plate lies behind an element, a picture with alpha; both are rendered as one scene. Hidden
surfaces are given by files. A matte is the coverage of the subject, 0 to 1, as of portrait modes
and segmentations; its edges become the edges of the depth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.arrays import times
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.depth_formats.exr_depth_channel import NoDepthChannel
from defocus_core.io.depth_formats.photo_depth import matte_inside
from defocus_core.io.depth_formats.reading import stretched
from defocus_core.io.exr.channel_choice import views_of
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.exr.windows import Overscan
from defocus_core.io.images.color import Color, read_color, require_finite
from defocus_core.io.images.color_space import unit
from defocus_core.io.images.primaries import refuse_other_primaries
from defocus_core.io.images.raster import choose_page, read_pages, read_samples
from defocus_core.io.read_files import read_head
from defocus_core.picture.element import element_depth
from defocus_core.picture.layers import Layers, coverage
from defocus_core.picture.pair import overscan_of, stretch_words
from defocus_core.picture.pair import read as read_pair
from defocus_core.picture.radii import radii_of
from defocus_core.picture.scene import map_on, picture_on
from defocus_core.picture.take import InputPair, Surfaces, Take
from defocus_core.system.text import counted, note


def window_of_plate(wanted: InputPair) -> InputPair:
    """Limit the overscan of an element to that of its plate."""
    below = _wanted(wanted)
    return replace(wanted, limit=overscan_of(below))


def read_plate(take: Take) -> Take:
    """Read the plate of an element, and make layers of both."""
    picture, inputs = take.job.picture, take.inputs
    if picture.hidden is not None:
        remedy = "the plate is what lies behind"
        raise UsageProblem("contradiction", "contradicts ‹over›", remedy, field="hidden")
    wanted = _wanted(InputPair.from_job(take.job))
    plate = _plate(replace(wanted, limit=inputs.color.overscan, whole=True))
    warnings = *inputs.warnings, *plate.depth.warnings, *_doubts(inputs.color, plate.color)
    pictures = inputs.color, plate.color
    light = tuple((*c.light, *c.planes[len(c.channels) :]) for c in pictures)
    empty = inputs.depth.empty, plate.depth.empty
    nowhere = any(each is None for each in empty)
    alpha = tuple(coverage(c.planes[0].shape, c.alpha) for c in pictures)
    depths, colors = (inputs.depth, plate.depth), len(inputs.color.light)
    return take.with_inputs(
        plate=plate,
        layers=Layers(light, alpha, depths, colors, pictures=pictures),
        empty=None if nowhere else np.logical_and(*empty),
        warnings=warnings,
    )


def radii_of_both(take: Take) -> Take:
    """Show the radii of the plate in maps where the element is empty."""
    plate, element, own = take.inputs.plate, take.inputs.depth, take.radii
    assert plate is not None
    below, shown = radii_of(take.lens, plate.depth), own.px
    if element.empty is not None:
        shown = np.where(element.empty, below.px, own.px)
    limits = min(own.limits[0], below.limits[0]), max(own.limits[1], below.limits[1])
    return replace(take, shown=shown, limits=limits)


def _wanted(element: InputPair) -> InputPair:
    """The plate to read; options for layers and parts of files apply to the element only."""
    assert element.picture.over is not None
    path, reading = element.picture.color, element.reading
    has_views = is_exr(read_head(path)) and views_of(read_headers(path))
    view = reading.view if has_views else None
    reading = replace(reading, color_layer=None, depth_channel=None, part=None, view=view)
    return replace(element, picture=element.picture.over, reading=reading)


def _plate(wanted: InputPair) -> InputPair:
    """Decode the plate; if it has no depth, it is infinitely far away."""
    picture = wanted.picture
    try:
        if picture.depth != picture.color or is_exr(read_head(picture.color)):
            return replace(wanted, planes=read_pair(wanted))
    except NoDepthChannel:
        if picture.depth != picture.color:
            raise
    return _far_away(wanted)


def _doubts(element: Color, plate: Color) -> Iterator[str]:
    """Check that an element and a plate match; yield warnings about the alpha of the element."""
    path, alpha = plate.path, element.alpha
    if alpha is None:
        problem = "has no alpha, and hides the plate everywhere"
        remedy = "give an element, or leave ‹over› out"
        raise InputError("idle-option", problem, remedy, path=element.path)
    sizes = [f"{w}x{h} px" for h, w, _ in (element.shape, plate.shape)]
    if sizes[0] != sizes[1]:
        problem = f"is {sizes[1]} but the element is {sizes[0]}"
        raise InputError("wrong-size", problem, "give a plate of its size", path=path)
    names = [(*c.channels[: len(c.light)], *c.passes) for c in (element, plate)]
    if names[0] != names[1]:
        problem = f"has {', '.join(names[1])} but the element {', '.join(names[0])}"
        raise InputError("wrong-size", problem, "give a plate of the same channels", path=path)
    refuse_other_primaries(path, plate.attributes, element.attributes, "the element")
    beyond = int(np.count_nonzero((alpha < 0) | (alpha > 1)))
    lit = np.logical_or.reduce([light != 0 for light in element.light])
    glowing = int(np.count_nonzero((alpha <= 0) & lit))
    if beyond:
        yield f"alpha beyond 0…1 in {counted(beyond, 'pixel')} taken as 0 or 1"
    if glowing:
        yield f"light without alpha in {counted(glowing, 'pixel')} left out of ‹over›"


def _far_away(wanted: InputPair) -> InputPair:
    """Decode a plate without depth, as infinitely far away."""
    picture, reading, overscan = wanted.picture, wanted.reading, wanted.limit
    assert overscan is not None
    if reading.holds_radii:
        what, remedy = "radii", "give them as ‹over-depth› RADII"
        if reading.relative:
            what = "disparity"
            remedy = "give it as ‹over-depth› DEPTH, of the scale of the element's"
        raise InputError("radii", f"has no {what}", remedy, path=picture.color)
    color = read_color(picture.color, view=reading.view, overscan=overscan)
    require_finite(color)
    metres = np.full(color.shape[:2], np.inf, np.float32)
    warning = f"{picture.color.name}: the plate has no depth and is taken as infinitely far"
    note = "no depth, infinitely far"
    depth = Depth(metres, picture.color, "", note, overscan=overscan, warnings=(warning,))
    return replace(wanted, planes=(color, element_depth(depth, color)))


def read_hidden(take: Take) -> Take:
    """Read the hidden layer: colour and depth of the surfaces behind the visible ones."""
    hidden, color = take.job.picture.hidden, take.inputs.color
    wanted = InputPair.from_job(take.job)
    assert hidden is not None
    behind, depth = read_pair(replace(wanted, picture=hidden))
    if behind.shape != color.shape:
        size, needed = (
            f"{width}x{height} px of {channels} channels"
            for height, width, channels in (behind.shape, color.shape)
        )
        problem = f"is {size} but the picture is {needed}"
        raise InputError("wrong-size", problem, "give ‹hidden› of the same kind", path=hidden.color)
    refuse_other_primaries(behind.path, behind.attributes, color.attributes, "the picture")
    warnings = (f"hidden: {warning}" for warning in behind.warnings)
    return take.with_inputs(hidden=(behind, depth), warnings=(*take.inputs.warnings, *warnings))


def show_hidden(surfaces: Surfaces) -> Surfaces:
    """Add the hidden layer to the scene; it is unknown where depth is inf and colour 0."""
    take = surfaces.take
    assert take.inputs.hidden is not None
    color, depth = take.inputs.hidden
    shown = np.logical_or.reduce([plane != 0 for plane in color.planes])
    known = np.isfinite(depth.metres) | shown
    px = times(radii_of(take.lens, depth).px, take.longer_axis)
    light = picture_on(color.planes, take.device)
    hidden = light, map_on(px, take.device), map_on(known, take.device)
    return replace(surfaces, hidden=hidden)


def read_matte(take: Take) -> Take:
    """Read the matte, from its file or from inside a photograph, if anything is rendered."""
    picture, color = take.job.picture, take.inputs.color
    if picture.over is not None and picture.matte is None:
        return take
    if picture.over is not None:
        problem = "contradicts ‹over›, whose element has its own alpha"
        raise UsageProblem("contradiction", problem, "leave it out", field="matte")
    if not take.job.outputs.need_rendering:
        return take
    path = picture.color if picture.matte is None else picture.matte.color
    if picture.matte is not None:
        values = _matte_values(path)
    elif (inside := matte_inside(path)) is not None:
        values = unit(inside)
        note(f"defocus: {path}: the matte of a person inside it is used, or give ‹matte› FILE")
    else:
        return take
    return take.with_inputs(matte=_coverage(path, values, color.size, color.overscan))


def show_matte(surfaces: Surfaces) -> Surfaces:
    """Add the matte to the scene."""
    take = surfaces.take
    return replace(surfaces, matte=map_on(take.inputs.matte, take.device))


def _coverage(
    path: Path, values: NDArray[np.float32], size: tuple[int, int], overscan: Overscan
) -> NDArray[np.float32]:
    """The coverage of a subject [H, W], 0 to 1, resized to its picture and extended to overscan.

    `path` is the file, for errors; `size` is (width, height) of the picture without overscan.
    """
    (height, width), (columns, rows) = values.shape, size
    if (width, height) != size:
        if (share := stretched((width, height), size)) is None:
            problem = (
                f"is {width}x{height} px, of another aspect than its picture, {columns}x{rows}"
            )
            remedy = "give a matte of the picture"
            raise InputError("wrong-size", problem, remedy, path=path)
        if share:
            note(f"defocus: {path}: {width}x{height} px{stretch_words(share)}")
        values = _resized(values, size)
    pads = (overscan.top, overscan.bottom), (overscan.left, overscan.right)
    return np.pad(values, pads, mode="edge")


def _matte_values(path: Path) -> NDArray[np.float32]:
    """Read coverage [H, W] from a file: its alpha if it has one, else its grey."""
    if is_exr(read_head(path)):
        color = read_color(path)
        colors = color.pixels if color.alpha is None else np.asarray(color.alpha[:])[:, :, None]
    else:
        page = choose_page(path, read_pages(path), None)
        colors = unit(read_samples(path, page.page))
        if "A" in page.channels:
            colors = colors[:, :, page.channels.index("A")][:, :, None]
    values = np.asarray(colors[:, :, 0], np.float32)
    if colors.shape[2] > 1 and (np.abs(colors[:, :, :3] - values[:, :, None]) > 0.1).any():
        problem, remedy = "has colours, and a matte is grey", "give the matte, not the picture"
        raise InputError("not-one-channel", problem, remedy, path=path)
    if not ((values >= 0) & (values <= 1)).all():
        problem = "has numbers beyond 0 to 1, which are not coverage"
        raise InputError("out-of-range", problem, "scale it to 0 to 1", path=path)
    return values


def _resized(values: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.float32]:
    """Resize a matte [H, W] to (width, height) by linear interpolation."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    roi = oiio.ROI(0, size[0], 0, size[1], 0, 1, 0, 1)
    buffer = oiio.ImageBuf(np.ascontiguousarray(values[:, :, None]))
    found = oiio.ImageBufAlgo.resize(buffer, roi=roi, filtername="triangle")
    return np.clip(np.asarray(found.get_pixels(oiio.FLOAT)).reshape(size[::-1]), 0, 1)

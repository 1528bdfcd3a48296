"""The plate that an element lies over: read beside it, and rendered with it as one scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.arrays import bands, computed
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.depth_formats.exr_depth_channel import NoDepthChannel
from defocus_core.io.exr.channel_choice import views_of
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.images.color import Color, read_color, require_finite
from defocus_core.io.images.primaries import refuse_other_primaries
from defocus_core.io.safe_files import read_head
from defocus_core.picture.element import element_depth
from defocus_core.picture.layers import Layers, coverage
from defocus_core.picture.pair import overscan_of
from defocus_core.picture.pair import read as read_pair
from defocus_core.picture.radii import radii_of
from defocus_core.picture.take import InputPair, Plate, Take
from defocus_core.system.text import counted


def window(wanted: InputPair) -> InputPair:
    """The element with the overscan that its plate has, too."""
    below = _wanted(wanted)
    return replace(wanted, limit=overscan_of(below))


def read(take: Take) -> Take:
    """The element with its plate."""
    picture, inputs = take.job.picture, take.inputs
    if picture.hidden is not None:
        raise UsageProblem(
            "contradiction", "stands beside ‹over›", "the plate is what lies behind", field="hidden"
        )
    wanted = _wanted(InputPair.of(take.job, inputs.holding.keeping))
    plate = _check(inputs.color, _plate(replace(wanted, limit=inputs.color.overscan, whole=True)))
    pictures = inputs.color, plate.color
    light = tuple((*c.light, *c.planes[len(c.channels) :]) for c in pictures)
    empty = inputs.depth.empty, plate.depth.empty
    nowhere = any(each is None for each in empty)
    alpha = tuple(coverage(c.planes[0].shape, c.alpha) for c in pictures)
    depths, colors = (inputs.depth, plate.depth), len(inputs.color.light)
    return take.reading(
        plate=plate,
        layers=Layers(light, alpha, depths, colors, pictures=pictures),
        empty=None if nowhere else computed(lambda a, b: a & b, *empty),
        warnings=(*inputs.warnings, *plate.warnings),
    )


def radii(take: Take) -> Take:
    """The radii of both, of which those in front are shown."""
    plate, element, own = take.inputs.plate, take.inputs.depth, take.radii
    assert plate is not None
    below, shown = radii_of(take.lens, plate.depth, take.inputs.holding.keeping), own.px
    if element.empty is not None:
        shown = computed(lambda a, n, b: np.where(n, b, a), own.px, element.empty, below.px)
    limits = min(own.limits[0], below.limits[0]), max(own.limits[1], below.limits[1])
    return replace(take, shown=shown, limits=limits)


def _wanted(element: InputPair) -> InputPair:
    """The plate of an element; of the options that choose layers and parts are the element's."""
    assert element.picture.over is not None
    path, reading = element.picture.color, element.reading
    has_views = is_exr(read_head(path)) and views_of(read_headers(path))
    view = reading.view if has_views else None
    reading = replace(reading, color_layer=None, depth_channel=None, part=None, view=view)
    return replace(element, picture=element.picture.over, reading=reading)


def _plate(wanted: InputPair) -> Plate:
    """A plate, infinitely far if it has no depth."""
    picture = wanted.picture
    try:
        if picture.depth != picture.color or is_exr(read_head(picture.color)):
            return Plate(picture, wanted.reading, *read_pair(wanted))
    except NoDepthChannel:
        if picture.depth != picture.color:
            raise
    return _far_away(wanted)


def _check(element: Color, plate: Plate) -> Plate:
    """The plate with warnings of the element over it."""
    path, alpha = plate.color.path, element.alpha
    if alpha is None:
        problem = "has no alpha, and hides the plate everywhere"
        raise InputError(
            "idle-option", problem, "give an element, or leave ‹over› out", path=element.path
        )
    sizes = [f"{w}x{h} px" for h, w, _ in (element.shape, plate.color.shape)]
    if sizes[0] != sizes[1]:
        problem = f"is {sizes[1]} but the element is {sizes[0]}"
        raise InputError("wrong-size", problem, "give a plate of its size", path=path)
    names = [(*c.channels[: len(c.light)], *c.passes) for c in (element, plate.color)]
    if names[0] != names[1]:
        problem = f"has {', '.join(names[1])} but the element {', '.join(names[0])}"
        raise InputError("wrong-size", problem, "give a plate of the same channels", path=path)
    refuse_other_primaries(path, plate.color.attributes, element.attributes, "the element")
    beyond = glowing = 0
    for rows in bands(alpha.shape):
        fraction = np.asarray(alpha[rows])
        beyond += int(np.count_nonzero((fraction < 0) | (fraction > 1)))
        lit = np.logical_or.reduce([light[rows] != 0 for light in element.light])
        glowing += int(np.count_nonzero((fraction <= 0) & lit))
    warnings = list(plate.warnings)
    if beyond:
        warnings.append(f"alpha beyond 0…1 in {counted(beyond, 'pixel')} taken as 0 or 1")
    if glowing:
        warnings.append(f"light without alpha in {counted(glowing, 'pixel')} left out of ‹over›")
    return replace(plate, warnings=tuple(warnings))


def _far_away(wanted: InputPair) -> Plate:
    """A plate without depth: infinitely far."""
    picture, reading, overscan = wanted.picture, wanted.reading, wanted.limit
    assert overscan is not None
    if reading.holds_radii:
        what, remedy = "radii", "give them as ‹over› PLATE RADII"
        if reading.relative:
            what, remedy = (
                "disparity",
                "give it as ‹over› PLATE DEPTH, of the scale of the element's",
            )
        raise InputError("radii", f"has no {what}", remedy, path=picture.color)
    color = read_color(picture.color, view=reading.view, keeping=wanted.keeping, overscan=overscan)
    require_finite(color)
    metres = wanted.keeping.new(color.shape[:2], np.float32)
    for rows in bands(color.shape):
        metres[rows] = np.full(metres[rows].shape, np.inf, np.float32)
    depth = Depth(metres, picture.color, "", "no depth, infinitely far", overscan=overscan)
    warning = f"{picture.color.name}: the plate has no depth and is taken as infinitely far"
    return Plate(picture, reading, color, element_depth(depth, color, wanted.keeping), (warning,))

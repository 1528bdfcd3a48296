"""The plate that an element lies over: read beside it, and rendered with it as one scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.errors import InputError
from defocus_core.io.arrays import Keeping, bands, computed
from defocus_core.io.depth_formats.depth import Depth
from defocus_core.io.exr.channel_choice import NoDepthChannel
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.exr.views import views_of
from defocus_core.io.exr.windows import Overscan
from defocus_core.io.images.color import read_color, require_finite
from defocus_core.io.images.color_planes import Color
from defocus_core.io.images.primaries import refuse_other_primaries
from defocus_core.io.safe_files import read_head
from defocus_core.picture.pair import read
from defocus_core.picture.sources import layer_windows, windows
from defocus_core.picture.steps.alpha import coverage, element_depth
from defocus_core.picture.steps.overscan import overscan_of
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.renderer.layers.stacked_samples import Layered
    from defocus_core.tensors.source import Pixels


@dataclass(frozen=True)
class Plate:
    """A decoded plate."""

    picture: Picture
    reading: Reading  # how it was read
    color: Color
    depth: Depth  # its depth; infinitely far if it has none
    warnings: tuple[str, ...] = ()  # what was taken for granted of it, and of the element over it


def read_over(
    picture: Picture,
    reading: Reading,
    keeping: Keeping,
    lens_focal: float | None,
    *,
    whole: bool = False,
) -> tuple[Color, Depth, Plate]:
    """Decode an element and its plate, with the overscan that both have.

    Of the options those that choose among layers and parts are the element's.
    """
    assert picture.over is not None
    plate_reading = _reading_of_plate(picture.over, reading)
    overscan = overscan_of(picture.over, plate_reading, whole=whole)
    color, depth = read(picture, reading, keeping, lens_focal, overscan, whole=whole)
    plate = _plate(picture.over, plate_reading, keeping, lens_focal, color.overscan)
    return color, depth, _checked(color, plate)


def _reading_of_plate(picture: Picture, reading: Reading) -> Reading:
    """The options without those that choose among layers and parts of the element."""
    exr = is_exr(read_head(picture.color))
    view = reading.view if exr and views_of(read_headers(picture.color)) else None
    return replace(reading, color_layer=None, depth_channel=None, part=None, view=view)


def _plate(
    picture: Picture,
    reading: Reading,
    keeping: Keeping,
    lens_focal: float | None,
    overscan: Overscan,
) -> Plate:
    """A plate, infinitely far if it has no depth."""
    try:
        if picture.depth != picture.color or is_exr(read_head(picture.color)):
            read_as = read(picture, reading, keeping, lens_focal, overscan, whole=True)
            return Plate(picture, reading, *read_as)
    except NoDepthChannel:
        if picture.depth != picture.color:
            raise
    return _far_away(picture, reading, keeping, overscan)


def _checked(element: Color, plate: Plate) -> Plate:
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


def layers_of(
    lights: Sequence[Pixels],  # of both their light [C, H, W]
    pictures: tuple[Color, Color],
    radii: Sequence[Pixels],  # of both the repaired radii [H, W] in px
    device: str,
) -> Layered:
    """The element before the plate, as layers with coverage."""
    from defocus_core.renderer.layers.stacked_samples import Layered

    size = pictures[0].planes[0].shape
    alpha = windows([coverage(size, color.alpha) for color in pictures], device)
    return Layered.of(layer_windows(lights), layer_windows(radii), alpha)


def nothing_of(element: Depth, plate: Plate) -> Any:
    """Where neither an element nor its plate has anything, bool [H, W]; None if nowhere."""
    if element.nothing is None or plate.depth.nothing is None:
        return None
    return computed(lambda a, b: a & b, element.nothing, plate.depth.nothing)


def _far_away(picture: Picture, reading: Reading, keeping: Keeping, overscan: Overscan) -> Plate:
    """A plate without depth: infinitely far."""
    if reading.holds_radii:
        what, remedy = "radii", "give them as ‹over› PLATE RADII"
        if reading.relative:
            what, remedy = (
                "disparity",
                "give it as ‹over› PLATE DEPTH, of the scale of the element's",
            )
        raise InputError("radii", f"has no {what}", remedy, path=picture.color)
    color = read_color(picture.color, view=reading.view, keeping=keeping, overscan=overscan)
    require_finite(color)
    metres = keeping.new(color.shape[:2], np.float32)
    for rows in bands(color.shape):
        metres[rows] = np.full(metres[rows].shape, np.inf, np.float32)
    depth = Depth(metres, picture.color, "", "no depth, infinitely far", overscan=overscan)
    warning = f"{picture.color.name}: the plate has no depth and is taken as infinitely far"
    return Plate(picture, reading, color, element_depth(depth, color, keeping), (warning,))

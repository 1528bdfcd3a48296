"""The frame of a picture: its size, tiles, content, slices, and parts of the aperture.

If there are cat's eyes, the pupil changes over the frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import torch
from torch import Tensor

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import CatEye, Rim, falloff
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.optics.parts import LEFT, RIGHT, Part
from defocus_core.renderer.blur.kernel_bank import Slicing, TransformWindow
from defocus_core.renderer.compositing.sight import ASIDE, OPAQUE, fraction_in_frame
from defocus_core.renderer.engine.settings import Quality, Settings
from defocus_core.renderer.layers.alpha import Alpha
from defocus_core.renderer.layers.slice_radii import CompositeOrder
from defocus_core.renderer.layers.slopes import along_first
from defocus_core.tensors.box import Box, Grid
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.validation import Scalar
from defocus_core.tensors.views import ViewTensors

# Px around a pixel that decide what its own surface is: soft edges, mixed pixels, slopes.
NEIGHBOURHOOD = 24


class Content(NamedTuple):
    """Properties of the whole picture that decide how it is rendered."""

    limits: tuple[float, float]  # least and greatest signed radius of visible surfaces, in px
    edges: bool  # whether surfaces hide others
    tilted: bool  # whether surfaces may be tilted
    minimum: float  # least light, 0 unless pixels are negative (colours outside the gamut)
    # Least and greatest value of each channel; none where more than these are seen
    channels: tuple[tuple[float, float], ...]
    limit: float  # brightness that a highlight exceeds
    highlights: bool  # whether there are highlights
    double: bool  # whether float32 is too coarse for the pixels
    alpha: Alpha = Alpha.NONE  # where the alpha of its views comes from
    open: bool = False  # whether there are pixels that layers do not cover


class Slices(NamedTuple):
    """The slices of a frame, their blur, and the order of their layers."""

    # Between which visible layers hidden octaves of blur are composited
    composite_order: CompositeOrder
    octaves: list[int]  # for each slice the octave of a hidden surface
    visible: Slicing  # how visible surfaces are blurred
    invented: Slicing  # how hidden surfaces that are invented are blurred


class Division(NamedTuple):
    """The division of the aperture into parts that are composited separately."""

    aperture: Aperture
    # The parts of the centre view; then a left and a right half, if these are composited in
    # addition
    parts: list[Part]
    weights: list[Scalar]  # for each part the share of the aperture
    centre: slice  # the parts of the centre view
    pair: slice  # the parts of left and right, which may be those of the centre view

    @classmethod
    def from_aperture(cls, aperture: Aperture, centre: int, dual_pixel: DualPixel | None) -> Self:
        """The division of an aperture that has `centre` parts (1, 4 or 16) for the centre view.

        `dual_pixel`: the photodiodes of left and right; None if these are not rendered.
        """
        divided = [*aperture.parts(centre)]
        of_centre = of_pair = slice(0, len(divided))
        if dual_pixel and (len(divided) == 1 or dual_pixel.halves != (LEFT, RIGHT)):
            of_pair = slice(len(divided), len(divided) + 2)
            divided += dual_pixel.halves
        weights = [aperture.fraction(part) for part in divided]
        return cls(aperture, divided, weights, of_centre, of_pair)

    @property
    def groups(self) -> list[slice]:
        """The groups of parts that are transformed at once.

        The centre is a group of its own, so that it does not depend on the other views.
        """
        return [self.centre] if self.pair == self.centre else [self.centre, self.pair]

    @property
    def left_fraction(self) -> Scalar:
        """The left view's share of the light of left and right.

        It is one half for measured photodiodes, whose kernels are normalised separately.
        """
        parts = list(zip(self.parts[self.pair], self.weights[self.pair], strict=True))
        if any(part.sensitivity for part, _ in parts):
            return 0.5
        return sum(weight for part, weight in parts if part.is_left) / sum(self.weights[self.pair])

    def mean(self, values: Tensor) -> Tensor:
        """The mean [..., h, w] of values [M, ..., h, w] over the parts of the centre view."""
        values = values[self.centre]
        if len(values) == 1:
            return values[0]
        fractions = along_first(self.weights[self.centre], values)
        return (values * fractions).sum(0) / fractions.sum(0)


@dataclass(frozen=True)
class SharedFrame:
    """The data that all regions of a picture share."""

    size: tuple[int, int]  # (height, width) in px
    settings: Settings
    quality: Quality  # settings of the quality
    dtype: torch.dtype  # type of the numbers to compute with
    # Rows above and below, and columns on both sides, by which the scene goes on
    beyond: tuple[int, int]
    cut: bool  # whether light from beyond these rows and columns would reach the frame
    farthest: int  # the greatest reach of light in px
    margin: int  # width in px of the border around a region on which its pixels depend
    content: Content  # properties of the pixels
    radii: tuple[float, ...]  # signed radius of each slice in px, ascending
    # Returns tiles and slices for a division, on first use: compiled loops need neither
    tiled: Callable[[Division], tuple[Grid, Slices]]

    @cached_property
    def division(self) -> Division:
        """The division of the aperture into parts."""
        settings = self.settings
        centre = 1 if settings.cat_eye else self.quality.parts  # a rim would clip parts away
        pair = settings.dual_pixel if settings.left_right else None
        return Division.from_aperture(settings.aperture, centre, pair)

    @cached_property
    def _tiled(self) -> tuple[Grid, Slices]:
        return self.tiled(self.division)

    @property
    def grid(self) -> Grid:
        """The tiles of the frame."""
        return self._tiled[0]

    @property
    def slices(self) -> Slices:
        """The slices of the picture, and how they are blurred."""
        return self._tiled[1]

    @property
    def box(self) -> Box:
        """The whole frame."""
        return Box(0, 0, *self.size)

    @property
    def scene(self) -> Box:
        """The frame together with the surroundings from which light may reach it."""
        (height, width), (rows, columns) = self.size, self.beyond
        return Box(-rows, -columns, height + 2 * rows, width + 2 * columns)

    def is_inside(self, box: Box, bounds: Box) -> bool:
        """Whether no light from outside of `bounds` reaches `box`."""
        return box == box.grown(0, bounds.enlarged(-self.farthest))

    @property
    def trace(self) -> float:
        """The least coverage of a pixel by its own surface, so that no pixel stays uncovered.

        It exceeds 0 if a pixel at the border may see nothing of the frame: through a measured
        pupil, whose light may be off the centre, or through an obstruction as wide as half the
        frame.
        """
        aperture, radii = self.settings.aperture, self.radii
        opaque = float(aperture.fixed.obstruction) * max(abs(radii[0]), abs(radii[-1]))
        if opaque >= min(self.size) / 2:
            return OPAQUE
        return 0.0 if aperture.image is None else ASIDE

    @property
    def views(self) -> int:
        """The number of images: 1 (centre) or 3 (centre, left and right)."""
        return 3 if self.settings.left_right else 1


def frame_at(frame: SharedFrame, box: Box) -> SharedFrame:
    """The frame with the pupils as seen from the corners of a region, if there are cat's eyes."""
    if frame.settings.cat_eye is None:
        return frame
    views = corner_views(frame, box)
    clipped: dict[int, TransformWindow] = {}

    def slicing(of: Slicing) -> Slicing:
        for window in of.windows:
            if id(window) not in clipped:
                clipped[id(window)] = window.seen(views)
        return of._replace(windows=[clipped[id(window)] for window in of.windows])

    visible, invented = (slicing(of) for of in (frame.slices.visible, frame.slices.invented))
    slices = frame.slices._replace(visible=visible, invented=invented)
    return replace(frame, tiled=lambda _: (frame.grid, slices))


def corner_views(frame: SharedFrame, box: Box) -> list[Rim]:
    """The pupils as seen from the corners of a region, row by row; empty without cat's eyes."""
    cat_eye = frame.settings.cat_eye
    if cat_eye is None:
        return []
    return [
        cat_eye.view(float(x), float(y), frame.size)
        for y in (box.top, box.top + box.height)
        for x in (box.left, box.left + box.width)
    ]


class RegionPlace(NamedTuple):
    """The rectangles of a region, in coordinates of the frame unless stated."""

    frame: SharedFrame
    grid: Grid
    outer: Box  # all pixels on which the pixels of the region depend
    held: Box  # pixels from which light reaches the region
    inner: Box  # the same, with surroundings of the frame
    inside: Box  # `held` in coordinates of `outer`
    core: Box  # the tiles of the region in coordinates of `outer`

    @classmethod
    def from_grid(cls, frame: SharedFrame, grid: Grid) -> RegionPlace:
        """The rectangles of the region that consists of the tiles of `grid`."""
        box = grid.box
        outer = box.grown(frame.margin, frame.box)
        reach = max(frame.farthest + frame.farthest % 2, *frame.beyond)  # even: it may be halved
        held, inner = box.grown(reach, frame.box), box.grown(reach, frame.scene)
        return cls(frame, grid, outer, held, inner, held.seen_from(outer), box.seen_from(outer))

    def fractions(self, bounds: Box, signed_radius: Tensor, parts: list[Part]) -> Tensor:
        """The shares [m, 1, h, w] of parts that see `bounds`.

        `signed_radius`: [h, w] px, of the pixels of the tiles.
        """
        frame, core = self.frame, self.grid.box
        aperture = frame.division.aperture
        seen, position, size = corner_views(frame, core), core.seen_from(bounds), bounds[2:]
        fractions = fraction_in_frame(signed_radius, position, size, aperture, parts, seen)
        if not seen:
            return fractions
        from defocus_core.renderer.blur.layer_blur import blended

        return blended(fractions, core, core)


def views_of(frame: SharedFrame, at: Tensor, core: Box, region: Box) -> Rim | None:
    """The pupils as seen from n pixels of a region; None without cat's eyes.

    `at`: [n, 2], rows and columns in the coordinates of `core`; `core`, `region`: the rectangle of
    the region in these coordinates and in those of the frame.
    """
    cat_eye = frame.settings.cat_eye
    if cat_eye is None:
        return None
    y, x = (
        (at + sent([region.top - core.top, region.left - core.left], at) + 0.5)
        .to(frame.dtype)
        .unbind(1)
    )
    return cat_eye.view(x, y, frame.size)


def darkened(views: ViewTensors, cat_eye: CatEye, frame: tuple[int, int]) -> ViewTensors:
    """Views of a rectangle of a picture, darkened by the vignetting at each pixel.

    `frame`: (height, width) of the picture in px.
    """
    like = views.images[0]
    y, x = (torch.arange(s.first, s.end).to(like) + 0.5 for s in views.box.sides)
    fraction = falloff(cat_eye.centre_distance(x[None, :], y[:, None], frame), cat_eye.size)
    return views._replace(images=[image * fraction for image in views.images])

"""The regions of a picture: slice, blur, composite, tile by tile; several at once, in order.

Slices of a layer are summed in the Fourier domain; layers are composited front to back, for each
part of the aperture. Hidden layers fill the gaps of visible ones; in focus they also occlude. What
a region holds is found first, from a picture or from layers with coverage; the region itself is
given it, and computes tiles. Regions in focus are copied.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import count, islice
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.optics.parts import Part
from defocus_core.renderer.blur.layer_blur import Blur, Sliced, blended
from defocus_core.renderer.compositing.aperture_views import TileCompositor
from defocus_core.renderer.compositing.highlights import (
    Highlights,
    draw,
    occluders_of,
    split,
)
from defocus_core.renderer.compositing.saturating_sum import (
    ColorRange,
    add_light,
    count_negative,
    pair_of,
    picture,
    within_alpha,
)
from defocus_core.renderer.compositing.sight import (
    Openings,
    SightLimits,
    border_fallback,
    fraction_in_frame,
)
from defocus_core.renderer.engine.frame import (
    NEIGHBOURHOOD,
    SharedFrame,
    corner_views,
    frame_at,
    views_of,
)
from defocus_core.renderer.engine.layer_order import Filling, add_in_order
from defocus_core.renderer.engine.scene import (
    RegionSurfaces,
    Scene,
    SurfacesOfColors,
    continued,
    layers_within,
)
from defocus_core.renderer.inpainting.frame_pyramid import Backdrop, backdrop_of
from defocus_core.renderer.inpainting.hidden_layers import HiddenLayer, without_known
from defocus_core.renderer.layers.layer import SampleLayer, of_slices
from defocus_core.renderer.layers.samples import Layered
from defocus_core.renderer.layers.slice_radii import SHARP, slice_position
from defocus_core.renderer.layers.sliced_surface import SurfaceSamples
from defocus_core.renderer.layers.slopes import AROUND, Shifts, slopes
from defocus_core.tensors.box import BLOCK, Box, Grid, Span, regions
from defocus_core.tensors.pyramid import axes
from defocus_core.tensors.source import Pixels
from defocus_core.tensors.threads import threaded
from defocus_core.tensors.torch_modes import recomputed, unrecorded
from defocus_core.tensors.views import Views, added, joined

# Samples at the border of the frame that are looked up at once; bounds memory.
_SAMPLES_AT_ONCE = 1 << 17


class _Place(NamedTuple):
    """Where a region lies; the rectangles are those of the frame unless it is said."""

    frame: SharedFrame
    grid: Grid
    outer: Box  # all that its pixels depend on
    held: Box  # what light reaches it from
    inner: Box  # the same with what lies beyond the frame
    inside: Box  # `held` within `outer`
    core: Box  # its tiles within `outer`

    @classmethod
    def of(cls, frame: SharedFrame, grid: Grid) -> _Place:
        """The place of the tiles of a region."""
        box = grid.box
        outer = box.grown(frame.margin, frame.box)
        reach = max(frame.farthest + frame.farthest % 2, *frame.beyond)  # even: it may be halved
        held, inner = box.grown(reach, frame.box), box.grown(reach, frame.scene)
        return cls(frame, grid, outer, held, inner, held.seen_from(outer), box.seen_from(outer))

    def fills(self, surface: HiddenLayer | None) -> list[Filling]:
        """A hidden surface to composite; nothing if it has no pixel."""
        if surface is None or not bool(surface.mask.any()):
            return []
        return [Filling(self.frame, self.grid, (self.held, self.inner), surface)]

    def fractions(self, bounds: Box, signed_radius: Tensor, parts: list[Part]) -> Tensor | None:
        """The shares [m, 1, ..., h, w] of parts that look into a box; None if all are 1."""
        frame, core = self.frame, self.grid.box
        if frame.is_inside(core, bounds):
            return None
        aperture = frame.division.aperture
        seen, position, size = corner_views(frame, core), core.seen_from(bounds), bounds[2:]
        fractions = fraction_in_frame(signed_radius, position, size, aperture, parts, seen)
        return blended(fractions, core, core) if seen else fractions


class _Seen(NamedTuple):
    """What is seen in the rectangle `outer` of a region."""

    # Visible samples, those of the surface that the depth names first
    layers: tuple[SampleLayer, ...]
    positions: Tensor  # [H, W] of the first layer, between slice radii
    highlights: Highlights | None
    hidden: list[Filling]
    behind: tuple[SampleLayer, ...] = ()  # samples that nearer ones hide
    uncovered: tuple[SampleLayer, ...] = ()  # what no sample covers, as a surface without colours
    sight: SightLimits | None = None  # how far the lens sees in the tiles
    openings: Openings | None = None  # of layers: where the lens sees past opaque samples
    solid: tuple[SampleLayer, ...] = ()  # of layers: the nearest opaque sample of each pixel


def region_of(
    frame: SharedFrame,
    grid: Grid,
    scene: Scene,
    backdrop: Backdrop | SurfacesOfColors | None,
) -> Region:
    """A rectangle of tiles of a scene.

    `backdrop`: the frame at low resolution, or hidden surfaces that are continued for all colours;
    None if nothing is continued.
    """
    frame = frame_at(frame, grid.box)
    place = _Place.of(frame, grid)
    image, radius = (place.outer.of(x).to(frame.dtype) for x in (scene.image, scene.signed_radius))
    if frame.content.edges:  # pixels beside them are looked up by their numbers
        image, radius = image.contiguous(), radius.contiguous()
    if scene.layered is None:
        seen = _of_picture(place, scene, image, radius, backdrop)
        plain = seen.layers[0].color
    else:
        seen = _of_layers(place, scene.layered, image, backdrop)
        plain = image.clamp(max=frame.content.limit)  # with alpha, without the light of highlights
    fallback = border_fallback(place.core.of(plain), frame.trace) if frame.trace else None
    return Region(place, seen, scene.layered, fallback)


def _of_picture(
    place: _Place,
    scene: Scene,
    image: Tensor,
    signed_radius: Tensor,
    backdrop: Backdrop | SurfacesOfColors | None,
) -> _Seen:
    """What a picture [C, H, W] and its radii show and hide."""
    frame, content, slices = place.frame, place.frame.content, place.frame.slices
    of_all: RegionSurfaces | None = None
    layers: tuple[SampleLayer, ...] = (SampleLayer.whole(image, signed_radius),)
    if isinstance(backdrop, SurfacesOfColors):
        of_all = backdrop.at(place.outer, place.inside)
        layers = of_all.layers
    elif backdrop is not None:
        layers = layers_within(image, signed_radius, backdrop, place.outer)
    highlights = None
    if content.highlights:
        layers, highlights = split(layers, len(image), content.limit)
    positions, sight = slice_position(signed_radius, slices.radii), None
    if content.edges:
        sight = SightLimits.of(signed_radius, positions, slices.visible.layers, slices.octaves)
        sight = sight.over(place.core).without([not one.edges for one in content.each])
    invented = of_all.hidden if of_all else None
    if isinstance(backdrop, Backdrop):
        around = place.outer, place.inside
        invented = continued(layers[0], backdrop, *around, frame)
    return _Seen(layers, positions, highlights, place.fills(invented), sight=sight)


def _of_layers(
    place: _Place, layered: Layered, image: Tensor, backdrop: Backdrop | SurfacesOfColors | None
) -> _Seen:
    """What layers show and hide; `image`: [C + 1, H, W], the picture of them in focus."""
    frame, slices = place.frame, place.frame.slices
    stack = layered.stack(place.outer, frame.dtype)
    radius = stack.signed_radius[0]
    visible, hidden = stack.visible(), stack.hidden()
    if layered.mixed and isinstance(backdrop, Backdrop):
        own, *nearer = layers_within(visible[0].color, radius, backdrop, place.outer)
        visible = (own, *visible[1:], *nearer)
        if nearer:  # which hide a part of it
            hidden = (own._replace(coverage=1 - own.coverage, sparse=True), *hidden[1:])
    layers, highlights = split(visible, len(image) - 1, frame.content.limit)
    if highlights is not None:  # with an alpha of 0
        light = torch.cat([highlights.light, torch.zeros_like(highlights.light[:, :1])], 1)
        highlights = highlights._replace(light=light)
    fills, farthest = list[Filling](), torch.full_like(radius, layered.limits[1])
    uncovered: tuple[SampleLayer, ...] = ()
    if layered.open and layered.is_continued:
        rest = stack.through[-1:]
        uncovered = (SampleLayer(rest[:0], rest, farthest, sparse=True),)
    if backdrop is not None:
        assert isinstance(backdrop, Backdrop), "layers of all colours"
        around = place.outer, place.inside
        invented, known = continued(layers[0], backdrop, *around, frame), stack.knows_behind()
        if invented is not None and known is not None:
            behind = place.inside.of(known), place.inside.of(stack.signed_radius[-1])
            middle = axes(frame.size, place.held.top, place.held.left)
            invented = without_known(invented, *behind, middle)
        fills = place.fills(invented)
    openings = Openings.of(stack.opaque(), slices.radii, slices.visible.layers)
    return _Seen(
        layers,
        slice_position(radius, slices.radii),
        highlights,
        fills,
        behind=hidden,
        uncovered=uncovered,
        openings=openings.over(place.core),
        solid=(SampleLayer.whole(image[:0], stack.solid(layered.limits[1])),),
    )


def _samples_within(place: _Place, layers: Sequence[SampleLayer]) -> SurfaceSamples:
    """The samples whose light reaches the tiles."""
    radii = place.frame.slices.radii
    layers = [layer.within(place.inside) for layer in layers]
    if len(layers) > len(radii) + 1:
        layers = [layers[0], *of_slices(layers[1:], radii)]
    return SurfaceSamples(layers, slice_position(layers[0].signed_radius, radii))


def _visible(place: _Place, seen: _Seen) -> SurfaceSamples:
    """The visible samples whose light reaches the tiles, with their slopes and shifts."""
    frame, inside, first = place.frame, place.inside, seen.layers[0]
    radii, division = frame.slices.radii, frame.division
    around = inside.grown(AROUND, Box(0, 0, *first.signed_radius.shape[-2:]))
    inner, radius = inside.seen_from(around), around.of(first.signed_radius)
    positions = around.of(seen.positions)
    lean = shifts = None
    if frame.content.tilted:
        lean = slopes(radius, frame.quality.min_slope)
    if frame.settings.left_right and frame.copies_in_focus:
        color = around.of(first.color)
        halves = division.parts[division.pair]
        shifts = Shifts(color, radius, positions, inner, radii, division.aperture, halves)
    lean = None if lean is None else inner.of(lean)
    samples = _samples_within(place, seen.layers)
    return samples._replace(positions=inner.of(positions), slopes=lean, shifts=shifts)


def _fractions_seen(place: _Place, seen: _Seen, bounds: Box, parts: list[Part]) -> Tensor | None:
    """As `_Place.fractions`, in the mean over the visible samples of each pixel."""
    first, *others = (layer.within(place.core) for layer in seen.layers)
    radius = first.signed_radius
    total = place.fractions(bounds, radius, parts)
    if total is None or not first.sparse or not others:  # of a picture, its own surface alone
        return total
    radii = torch.stack([layer.signed_radius for layer in others])
    weights = torch.stack([layer.covered for layer in others])
    total = total * (1 - weights.sum(0))
    at_once = max(1, _SAMPLES_AT_ONCE // radius.numel())
    for start in range(0, len(radii), at_once):
        radius, weight = (x[start : start + at_once] for x in (radii, weights))
        fractions = place.fractions(bounds, radius, parts)
        if fractions is not None:
            total = total + (fractions * weight).sum(2)
    return total


def _discs(place: _Place, seen: _Seen, highlights: Highlights) -> Tensor:
    """The discs of highlights behind surfaces, for each part of the aperture.

    Of layers, what hides a part of a light is in its coverage already.
    """
    radii, (aperture, parts, *_) = place.frame.slices.radii, place.frame.division
    occluders = occluders_of(seen.solid or seen.layers, radii)
    barrel = views_of(place.frame, highlights.at, place.core, place.grid.box)
    return draw(highlights, occluders, radii, aperture, parts, place.core, barrel)


class Region:
    """A rectangle of tiles, and everything that they share."""

    def __init__(
        self, place: _Place, seen: _Seen, layered: Layered | None, fallback: Tensor | None
    ) -> None:
        """Prepare the blur of what is seen.

        `layered`: the layers that are seen; None for a picture; `fallback`: [C + 1, h, w], what is
        seen where nothing else is for sure; None without any.
        """
        frame = self._frame = place.frame
        slicing, division = frame.slices.visible, frame.division
        self._tiles = place.grid.tiles
        self._layered, self._fallback, self._like = layered, fallback, seen.layers[0].color
        self._sight, self._openings, self._hidden = seen.sight, seen.openings, seen.hidden
        self._blur = Blur(
            frame.slices.radii,
            slicing.windows,
            slicing.coarse,
            place.grid.seen_from(place.inner),
            division.groups,
            axes(frame.size, place.inner.top, place.inner.left),
            by_corners=frame.settings.field is not None,
        )
        around = place.inner.seen_from(place.held)

        def sliced(samples: SurfaceSamples) -> Sliced:
            return self._blur.sliced(samples._replace(around=around), 1, slicing.layers)

        self._visible = sliced(_visible(place, seen))
        behind, uncovered = (
            sliced(_samples_within(place, layers)) if layers else None
            for layers in (seen.behind, seen.uncovered)
        )
        self._behind, self._uncovered = behind, uncovered
        centre = division.parts[division.centre]
        self._in_frame = _fractions_seen(place, seen, frame.box, centre)
        self._in_scene: Tensor | None = None
        if frame.cut:
            self._in_scene = _fractions_seen(place, seen, frame.scene, division.parts)
        self._range = ColorRange.of(frame.content.channels, self._like, frame.content.minimum)
        highlights = seen.highlights
        self._highlights = _discs(place, seen, highlights) if highlights else None

    def tile(self, index: int) -> Views:
        """The views of one tile of the region."""
        frame, box = self._frame, self._tiles[index]
        compositor, needed = self._composited(index)
        lit, division = self._lit(compositor.front, index), frame.division
        trust = self._trust(lit[:, -1], compositor.invented, box)
        counts, content = self._counts(index, needed), frame.content
        weights = division.weights
        centre = self._range.bounded(picture(lit[division.centre], weights[division.centre]))
        if not frame.settings.left_right:
            return Views([centre], trust, counts, box)
        both, weights = lit[division.pair], weights[division.pair]
        if compositor.moved is not None:
            both = add_light(both, compositor.moved)
        cut = sum(part.is_left for part in division.parts[division.pair])
        left, right = picture(both[:cut], weights[:cut]), picture(both[cut:], weights[cut:])
        counts |= count_negative(torch.stack([left, right]), content.limit, content.minimum)
        fraction = division.left_fraction
        pair = pair_of(centre, left, right, minimum=content.minimum, fraction=fraction)
        images = self._range.bounded_pair(pair, centre, fraction)
        if self._layered is not None:
            images = within_alpha(images, fraction)
        images = frame.settings.dual_pixel.crossed(images, centre)
        return Views([centre, *images], trust, counts, box)

    def _trust(self, covered: Tensor, invented: Tensor | None, box: Box) -> Tensor:
        """The share of the aperture that saw the scene, [1, h, w].

        Of the coverage [M, h, w] of all parts the share that is not invented, times the share of
        the parts that looks into the frame: what surfaces are continued by was not seen.
        """
        mean = self._frame.division.mean
        observed = covered if invented is None else covered - invented
        fraction = mean(observed) / mean(covered)
        if self._in_frame is not None and not self._frame.is_inside(box, self._frame.box):
            expected = box.seen_from(self._tiles[0]).of(self._in_frame)
            fraction = fraction * mean(expected[:, 0])
        return fraction.clamp(0, 1)[None]

    def _composited(self, index: int) -> tuple[TileCompositor, list[Filling]]:
        """The views of a tile by the parts of the aperture, and the hidden surfaces they needed."""
        compositor, visible = self._blank(index), self._blur.over_tile(self._visible, index)
        layered, reaching = self._layered, self._reaching(index)
        if self._uncovered is not None:
            compositor.reserve(self._blur.over_tile(self._uncovered, index))
        if self._behind is None or self._openings is None or layered is None:
            order = self._frame.slices.composite_order
            needed = add_in_order(compositor, visible, reaching, order, index)
        else:
            hidden = self._blur.over_tile(self._behind, index)
            openings = self._openings.over(self._tiles[index].seen_from(self._tiles[0]))
            compositor.add_known(visible, hidden, openings, closed=not layered.open)
            compositor.close(openings)
            needed = [] if compositor.is_nearly_full() else reaching
            for surface in needed:
                compositor.fill(surface.over_tile(index).whole())
        if layered is not None and not layered.blurs_alpha:
            compositor.add_alpha()
        if layered is not None and layered.open:
            compositor.leave_open()
        return compositor, needed

    def _blank(self, index: int) -> TileCompositor:
        """The views of a tile without surfaces."""
        size, like = self._tiles[index][2:], self._like
        division = self._frame.division
        blank = like.new_zeros(len(division.parts), len(like) + 1, *like.shape[1:-2], *size)
        sight = self._sight and self._sight.over(self._tiles[index].seen_from(self._tiles[0]))
        return TileCompositor(blank, self._full(index), division.groups, sight)

    def _reaching(self, index: int) -> list[Filling]:
        """The hidden surfaces that reach a tile."""
        return [surface for surface in self._hidden if surface.plan[index]]

    def _lit(self, views: Tensor, index: int) -> Tensor:
        """The views of all parts, with highlights.

        A picture is divided by its coverage, which highlights do not share: they are weighted by
        it, so that errors of the coverage do not make them brighter.
        """
        box = self._tiles[index].seen_from(self._tiles[0])
        if self._fallback is not None:
            views = views + box.of(self._fallback)
        if self._highlights is None:
            return views
        inside = 1.0 if self._in_scene is None else box.of(self._in_scene)
        return add_light(views, box.of(self._highlights) * (views[:, -1:] / inside))

    def _full(self, index: int) -> Tensor | float:
        """The greatest coverage in a tile."""
        tile, frame = self._tiles[index], self._frame
        if self._in_scene is None or not frame.content.edges or frame.is_inside(tile, frame.scene):
            return 1.0
        return tile.seen_from(self._tiles[0]).of(self._in_scene)

    def _counts(self, index: int, needed: list[Filling]) -> dict[str, int]:
        """Counts of the work done for a tile, and of the work of a renderer that skips nothing."""
        windows, area = self._frame.slices.visible.windows, self._tiles[index].area
        reaching, pieces = self._reaching(index), self._visible.pieces[index]
        visible = [windows[slice_index] for slice_index in self._visible.surface.plan[index]]
        hidden = [
            surface.windows[slice_index]
            for surface in reaching
            for slice_index in surface.plan[index]
        ]
        done = [(window, window.level) for window in visible]
        done += [
            (surface.windows[slice_index], surface.level + surface.windows[slice_index].level)
            for surface in needed
            for slice_index in surface.plan[index]
        ]
        counts = {
            "pixels": area,
            "pixels_copied": 0 if any(window.margin for window in visible + hidden) else area,
            "tiles": 1,
            "slice_tiles": 2 * len(windows),
            "slice_tiles_done": len(done),
            "slice_tiles_blurred": sum(window.margin > 0 for window, _ in done),
            "slice_tiles_reduced": sum(level > 0 for _, level in done),
            "slice_tiles_culled": len(visible) + len(hidden) - len(done),
            "layer_pixels": area * len(pieces),
            "layer_pixels_done": sum(piece.patch.shown.area for piece in pieces),
            "tiles_culled": int(len(needed) < len(reaching)),
            "tiles_with_hidden": int(bool(reaching)),
        }
        pictures = math.prod(self._like.shape[1:-2])
        return {name: pictures * count for name, count in counts.items()}


# Greater than all rows and columns.
_NOWHERE = 1 << 40
# Counts that are 0 for copied tiles.
_COMPUTED = (
    *("slice_tiles_done", "slice_tiles_blurred", "slice_tiles_reduced", "slice_tiles_culled"),
    *("layer_pixels", "layer_pixels_done", "tiles_culled", "tiles_with_hidden"),
)


def rendered_regions(
    frame: SharedFrame,
    scene: Scene,
    *,
    reaching: Pixels,  # [H, W] px, the radii whose light reaches farthest
    at_once: int | None,  # greatest number of regions computed at once; None for as many as threads
    progress: Callable[[int, int], None] | None,
) -> Iterator[Views]:
    """The views of each region of a picture, row by row, each from left to right."""
    threads = frame.settings.threads
    pixels, signed_radius = scene.image, scene.signed_radius
    grids = [grid for row in regions(frame.grid, frame.margin) for grid in row]
    with unrecorded(signed_radius.device):
        backdrop = _backdrop(frame, scene)
    at_once = min(threads, len(grids), at_once or threads)
    # a copied pixel has no gradient to the radius
    may_copy = not (isinstance(signed_radius, Tensor) and signed_radius.requires_grad)
    numbers, reported = count(1), Counter[Box]()

    def report(box: Box, tiles: int) -> None:
        """Report tiles of a region as done, unless it is computed again."""
        reported[box] += tiles
        for number in islice(numbers, tiles):
            if progress and number <= len(frame.grid.tiles):
                progress(number, len(frame.grid.tiles))

    def computed(grid: Grid) -> Views:
        part = blurred_part(frame, grid, reaching) if may_copy else grid
        if part is None:
            return _copied(frame, grid, pixels)
        tiles: list[Views] = []
        with unrecorded(signed_radius.device):
            region = region_of(frame, part, scene, backdrop)
            work = recomputed(region.tile), range(len(part.tiles)), threads // at_once
            for tile in threaded(*work):
                tiles.append(tile)
                report(grid.box, 1)
        views = joined([tiles[i : i + part.columns] for i in range(0, len(tiles), part.columns)])
        return views if part.box == grid.box else _copied(frame, grid, pixels, views)

    def in_order() -> Iterator[Views]:
        parts = threaded(recomputed(computed), grids, at_once)
        for grid, part in zip(grids, parts, strict=True):
            report(grid.box, len(grid.tiles) - reported[grid.box])  # copies
            yield part

    return in_order()


def _backdrop(frame: SharedFrame, scene: Scene) -> Backdrop | SurfacesOfColors | None:
    """What hidden surfaces are continued from; None if none is."""
    content, layered = frame.content, scene.layered
    if not content.edges or scene.surfaces is not None:
        return scene.surfaces if content.edges else None
    if layered is not None and not layered.is_continued:
        return None
    pixels, limit = scene.image, content.limit
    if layered is not None:
        if not layered.blurs_alpha:
            in_memory = isinstance(pixels, Tensor)
            pixels = pixels[:-1] if in_memory else layered.picture(alpha=False)
        limit = max(limit, 1.0)  # alpha is no light
    return backdrop_of(
        pixels,
        scene.signed_radius,
        limit,
        frame.dtype,
        frame.settings.threads,
        content.limits,
        unmixes=frame.quality.unmixes and (layered is None or layered.mixed),
        matte=scene.matte,
    )


def _copied(frame: SharedFrame, grid: Grid, pixels: Pixels, part: Views | None = None) -> Views:
    """Views of a region in focus: its pixels themselves, but for a part that was computed."""
    image = grid.box.of(pixels).to(frame.dtype)
    trust, images = image.new_ones(1, *image.shape[1:]), [image] * frame.views
    pictures = math.prod(image.shape[1:-2])
    area, tiles, counts = pictures * grid.box.area, pictures * len(grid.tiles), dict[str, int]()
    if part:
        images, counts = [image.clone() for image in images], part.stats
        where = part.box.seen_from(grid.box)
        for whole, computed in zip([*images, trust], [*part.images, part.trust], strict=True):
            where.of(whole).copy_(computed)
        area, tiles = area - pictures * part.box.area, tiles - counts["tiles"]
    slice_tiles = 2 * len(frame.slices.radii) * tiles
    copies = {"pixels": area, "pixels_copied": area, "tiles": tiles, "slice_tiles": slice_tiles}
    return Views(images, trust, added([counts, copies]), grid.box)


def assembled(frame: SharedFrame, pixels: Tensor, parts: Iterator[Views]) -> Views:
    """The views of the whole picture.

    Each image [C, H, W] has memory of its own: a caller who keeps one does not keep the others.
    Trust is [1, H, W]. Of a batch they are [B, C, H, W] and [B, 1, H, W].

    `pixels`: [C, H, W], whose precision the views get.
    """
    if torch.is_grad_enabled():
        views = joined(list(in_rows(part.to(pixels.dtype) for part in parts)))
        return _by_picture(views._replace(stats=total(frame, [views.stats])))
    each = pixels.movedim(0, -3)  # in memory picture by picture
    images = [each.new_empty(each.shape).movedim(-3, 0) for _ in range(frame.views)]
    trust = each.new_empty(*each.shape[:-3], 1, *each.shape[-2:]).movedim(-3, 0)
    counts: list[dict[str, int]] = []
    for part in (each.to(pixels.dtype) for each in parts):
        for image, part_image in zip(images, part.images, strict=True):
            part.box.of(image).copy_(part_image)
        part.box.of(trust).copy_(part.trust)
        counts.append(part.stats)
    whole = Box(0, 0, *pixels.shape[-2:])
    return _by_picture(Views(images, trust, total(frame, counts), whole))


def _by_picture(views: Views) -> Views:
    """Views [C, ..., H, W] as [..., C, H, W]; each picture of a batch has the slices of all."""
    if views.trust.dim() == 3:
        return views
    images = [image.movedim(0, -3) for image in views.images]
    stats = views.stats | {"slices": views.trust.shape[1] * views.stats["slices"]}
    return views._replace(images=images, trust=views.trust.movedim(0, -3), stats=stats)


def total(frame: SharedFrame, counts: list[dict[str, int]]) -> dict[str, int]:
    """The counts of all regions together."""
    return {"slices": len(frame.slices.radii), **added([dict.fromkeys(_COMPUTED, 0), *counts])}


def in_rows(parts: Iterator[Views]) -> Iterator[list[Views]]:
    """The regions of a picture, row by row."""
    row: list[Views] = []
    for part in parts:
        if row and part.box.left == 0:
            yield row
            row = []
        row.append(part)
    yield row


def blurred_part(frame: SharedFrame, grid: Grid, signed_radius: Pixels) -> Grid | None:
    """The part of a region to compute: its tiles, cut to the pixels that blurred light reaches.

    `signed_radius`: [H, W] px of the frame. Returns none if all of the region is copied.
    """
    if not frame.copies_in_focus:
        return grid
    around = grid.box.grown(frame.margin, frame.box)
    radii = around.of(signed_radius).detach()
    reached = _reached(frame, around, radii).tolist()
    if any(first > last for first, last in reached):
        return None
    if frame.settings.field is not None:  # seen from its corners, which neighbours share
        return grid
    spans = (Span(first // BLOCK * BLOCK, (last // BLOCK + 1) * BLOCK) for first, last in reached)
    return grid.within(Box.over(*spans))


def _reached(frame: SharedFrame, around: Box, radii: Tensor) -> Tensor:
    """The first and the last row, and column, that blurred light reaches: [2, 2].

    The first one is greater if none is reached.

    `radii`: [..., h, w] px of the part.
    """
    lows, highs = (radii, radii) if radii.dim() == 2 else (radii.amin(0), radii.amax(0))
    minimum, maximum = (torch.cat([end(1), end(0)]) for end in (lows.amin, highs.amax))
    blurred, reach = (minimum < -SHARP) | (maximum > SHARP), _reach(frame, minimum, maximum)
    lines = [torch.arange(side.first, side.end, device=radii.device) for side in around.sides]
    at, sizes = torch.cat(lines), [len(line) for line in lines]
    first = torch.split(torch.where(blurred, at - reach, _NOWHERE), sizes)
    last = torch.split(torch.where(blurred, at + reach, -_NOWHERE), sizes)
    pairs = zip(first, last, strict=True)
    return torch.stack([torch.stack([one.amin(), other.amax()]) for one, other in pairs])


def _reach(frame: SharedFrame, minimum: Tensor, maximum: Tensor) -> Tensor | int:
    """Px around pixels of radii [n] from least to most in which their blur changes the picture."""
    if frame.content.edges:  # which reveal hidden surfaces, too
        return frame.margin
    slice_radii = torch.tensor(frame.slices.radii, dtype=torch.float64, device=minimum.device)
    spread = torch.tensor(frame.slices.visible.reaches, device=minimum.device)
    nearest = torch.searchsorted(slice_radii, minimum.double(), right=True) - 1
    farthest = torch.searchsorted(slice_radii, maximum.double())
    limits = (end.clamp(0, len(slice_radii) - 1) for end in (nearest, farthest))
    return NEIGHBOURHOOD + torch.maximum(*(spread.index_select(0, end) for end in limits))

"""The regions of a picture, computed in order, several at once; those in focus are copied."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import count, islice

import torch
from torch import Tensor

from defocus_core.depth.matting import Unmixed
from defocus_core.renderer.engine.frame import NEIGHBOURHOOD, SharedFrame
from defocus_core.renderer.engine.region import region_of
from defocus_core.renderer.engine.scene import Scene, SurfacesOfColors, taken_apart
from defocus_core.renderer.inpainting.frame_pyramid import Backdrop, backdrop_of
from defocus_core.renderer.layers.slice_radii import SHARP
from defocus_core.tensors.box import BLOCK, Box, Grid, Span, regions
from defocus_core.tensors.source import Pixels
from defocus_core.tensors.threads import threaded
from defocus_core.tensors.torch_modes import recomputed, unrecorded
from defocus_core.tensors.views import Views, added, joined

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
    shown = _shown_at_once(frame, scene) if len(grids) == 1 else None
    backdrop = _backdrop(frame, scene, shown)
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
            region = region_of(frame, part, scene, backdrop, shown)
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


def _shown_at_once(frame: SharedFrame, scene: Scene) -> Unmixed | None:
    """The surfaces of a small frame, for its region and its backdrop; None to find them by part."""
    taken_elsewhere = scene.layered or scene.surfaces or scene.matte is not None
    if taken_elsewhere or not (frame.content.edges and frame.quality.unmixes):
        return None
    pixels, radius = (
        frame.box.of(x).to(frame.dtype).contiguous() for x in (scene.image, scene.signed_radius)
    )
    return taken_apart(pixels, radius, None, frame.box, frame)


def _backdrop(
    frame: SharedFrame, scene: Scene, shown: Unmixed | None
) -> Backdrop | SurfacesOfColors | None:
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
        unmixes=frame.quality.unmixes and layered is None,
        shown=shown,
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

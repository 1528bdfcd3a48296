"""The regions of a picture, computed in order, some at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import count

import torch
from torch import Tensor

from defocus_core.engine.frame import Frame
from defocus_core.engine.region import Region
from defocus_core.engine.unchanged_parts import blurred_part, counts_of_copies
from defocus_core.images.box import Box, Span
from defocus_core.images.source import Pixels
from defocus_core.images.tiling import Grid, regions
from defocus_core.images.views import Views, added, joined
from defocus_core.inpainting.frame_pyramid import backdrop
from defocus_core.inpainting.known_layer import Behind
from defocus_core.runtime.checkpointing import recomputed, unrecorded
from defocus_core.runtime.threads import threaded


def finished(
    frame: Frame,
    pixels: Pixels,
    signed_radius: Pixels,
    *,
    hidden: Behind | None,
    threads: int,
    at_once: int | None = None,
    progress: Callable[[int, int], None] | None,
) -> Iterator[Views]:
    """The regions of a picture, row by row, each from left to right.

    Args:
        frame: What holds for the whole picture.
        pixels: [C, H, W], in any precision; the result has the same.
        signed_radius: [H, W] px.
        hidden: What is known behind the visible surface.
        threads: As for `render`.
        at_once: Regions computed at once at most: bounds memory. None for as many as threads.
        progress: As for `render`.
    """
    beyond = None
    if frame.edges:
        beyond = backdrop(pixels, signed_radius, frame.limit, frame.dtype, threads, frame.ends)
    grids = [grid for row in regions(frame.grid, frame.margin) for grid in row]
    at_once = min(threads, len(grids), at_once or threads)
    # a copied pixel has no gradient to the radius
    wanted = isinstance(signed_radius, Tensor) and signed_radius.requires_grad
    done, told_of = count(1), Counter[Box]()

    def told(box: Box, count: int) -> None:
        told_of[box] += count
        for _ in range(count):
            number = next(done)
            if progress and number <= len(frame.grid.tiles):  # not when it is computed again
                progress(number, len(frame.grid.tiles))

    def computed(grid: Grid) -> Views:
        part = grid if wanted else blurred_part(frame, grid, signed_radius)
        if not part:
            counts = counts_of_copies(frame, grid.box.area, len(grid.tiles))
            return _copied(frame, grid.box, pixels)._replace(stats=counts)
        tiles: list[Views] = []
        with unrecorded():
            region = Region(frame, part, pixels, signed_radius, hidden, beyond)
            numbers = range(len(part.tiles))
            for tile in threaded(recomputed(region.tile), numbers, threads // at_once):
                tiles.append(tile)
                told(grid.box, 1)
        rest = len(grid.tiles) - len(part.tiles)
        rows = _among_copies(frame, grid.box, part, tiles, pixels)
        made = joined(rows)
        counts = counts_of_copies(frame, grid.box.area - part.box.area, rest)
        return made._replace(stats=added([made.stats, counts]))

    def handed_over() -> Iterator[Views]:
        parts = threaded(recomputed(computed), grids, at_once)
        for grid, part in zip(grids, parts, strict=True):
            told(grid.box, len(grid.tiles) - told_of[grid.box])  # copies
            yield part

    return handed_over()


def _among_copies(
    frame: Frame, whole: Box, part: Grid, tiles: Sequence[Views], pixels: Pixels
) -> list[list[Views]]:
    """Rows of views of a rectangle: the tiles of a part, and the rest as it was."""
    down, across = (
        (Span(side.first, inner.first), Span(inner.end, side.end))
        for side, inner in zip(whole.sides, part.box.sides, strict=True)
    )

    def copied(rows: Span, columns: Span) -> list[Views]:
        box = Box.over(rows, columns)
        return [_copied(frame, box, pixels)] if box.area else []

    above, below = (copied(rows, whole.sides[1]) for rows in down)
    made = []
    for first in range(0, len(tiles), part.columns):
        before, after = (copied(part.tiles[first].sides[0], columns) for columns in across)
        made.append([*before, *tiles[first : first + part.columns], *after])
    return [row for row in (above, *made, below) if row]


def _copied(frame: Frame, box: Box, pixels: Pixels) -> Views:
    """Views of what is as it was."""
    image = box.of(pixels).to(frame.dtype)
    images = [image] * (3 if frame.left_right else 1)
    return Views(images, image.new_ones(1, *image.shape[1:]), {}, box)


def assembled(frame: Frame, pixels: Tensor, parts: Iterator[Views]) -> Views:
    """The views of the whole picture.

    Each image [C, H, W] is in memory of its own: who keeps or saves one does not keep the others.
    Trust is [1, H, W].

    Args:
        frame: What holds for the whole picture.
        pixels: [C, H, W], whose precision the result has.
        parts: From `finished`.
    """
    if torch.is_grad_enabled():
        found = joined(list(in_rows(part.to(pixels.dtype) for part in parts)))
        return found._replace(stats=total(frame, [found.stats]))
    images = [pixels.new_empty(pixels.shape) for _ in range(3 if frame.left_right else 1)]
    trust = pixels.new_empty(1, *pixels.shape[-2:])
    counts: list[dict[str, int]] = []
    for part in parts:
        for image, some in zip(images, part.images, strict=True):
            part.box.of(image).copy_(some)
        part.box.of(trust).copy_(part.trust)
        counts.append(part.stats)
    return Views(images, trust, total(frame, counts), Box(0, 0, *pixels.shape[-2:]))


def total(frame: Frame, counts: list[dict[str, int]]) -> dict[str, int]:
    """The counts of all regions together."""
    return {"slices": len(frame.radii), **added(counts)}


def in_rows(parts: Iterator[Views]) -> Iterator[list[Views]]:
    """Those of a row of regions together."""
    row: list[Views] = []
    for part in parts:
        if row and part.box.left == 0:
            yield row
            row = []
        row.append(part)
    yield row

"""The regions of a picture, computed one by one or some at once, and put together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.backdrop import backdrop
from defocus_core.copying import blurred_part, counts_of_copies
from defocus_core.frame import Frame
from defocus_core.known import Behind
from defocus_core.recomputed import recomputed, unrecorded
from defocus_core.region import Region, Tile
from defocus_core.source import Pixels
from defocus_core.spans import Span
from defocus_core.threads import threaded
from defocus_core.tiling import Box, Grid, regions


class Finished(NamedTuple):
    """A part of a picture that is computed.

    Attributes:
        box: Where in the frame it is.
        images: The centre, or centre, left and right: [1 or 3, C, h, w].
        trust: [1, 1, h, w].
        counts: Of the work done.
    """

    box: Box
    images: Tensor
    trust: Tensor
    counts: dict[str, int]


def finished(
    frame: Frame,
    pixels: Pixels,
    signed_radius: Pixels,
    *,
    hidden: Behind | None,
    threads: int,
    at_once: int | None = None,
    progress: Callable[[int, int], None] | None,
) -> Iterator[Finished]:
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
    beyond, given = None, signed_radius
    signed_radius = frame.mending.mended(signed_radius, pixels)
    if frame.edges:
        beyond = backdrop(pixels, signed_radius, frame.limit, frame.dtype, threads, frame.ends)
    grids = [grid for row in regions(frame.grid, frame.margin) for grid in row]
    at_once = min(threads, len(grids), at_once or threads)
    wanted = isinstance(given, Tensor) and given.requires_grad  # a copy has no slope
    done, told_of = count(1), Counter[Box]()

    def told(box: Box, count: int) -> None:
        told_of[box] += count
        for _ in range(count):
            number = next(done)
            if progress and number <= len(frame.grid.tiles):  # not when it is computed again
                progress(number, len(frame.grid.tiles))

    def computed(grid: Grid) -> Finished:
        part = grid if wanted else blurred_part(frame, grid, given)
        if not part:
            counts = counts_of_copies(frame, grid.box.area, len(grid.tiles))
            return Finished(grid.box, *_copied(frame, grid.box, pixels), counts)
        tiles: list[Tile] = []
        with unrecorded():
            region = Region(frame, part, pixels, signed_radius, hidden, beyond)
            numbers = range(len(part.tiles))
            for tile in threaded(recomputed(region.tile), numbers, threads // at_once):
                tiles.append(tile)
                told(grid.box, 1)
        rest = len(grid.tiles) - len(part.tiles)
        rows = _among_copies(frame, grid.box, part, tiles, pixels)
        made, trust = (joined([[one[kind] for one in row] for row in rows]) for kind in (0, 1))
        counts = counts_of_copies(frame, grid.box.area - part.box.area, rest)
        return Finished(grid.box, made, trust, added(region.counts(tiles), counts))

    def handed_over() -> Iterator[Finished]:
        parts = threaded(recomputed(computed), grids, at_once)
        for grid, part in zip(grids, parts, strict=True):
            told(grid.box, len(grid.tiles) - told_of[grid.box])  # copies
            yield part

    return handed_over()


def _among_copies(
    frame: Frame, whole: Box, part: Grid, tiles: Sequence[Tile], pixels: Pixels
) -> list[list[tuple[Tensor, Tensor]]]:
    """Rows of images and trust of a rectangle: the tiles of a part, and the rest as it was."""
    down, across = (
        (Span(side.first, inner.first), Span(inner.end, side.end))
        for side, inner in zip(whole.sides, part.box.sides, strict=True)
    )

    def copied(rows: Span, columns: Span) -> list[tuple[Tensor, Tensor]]:
        box = Box.over(rows, columns)
        return [_copied(frame, box, pixels)] if box.area else []

    above, below = (copied(rows, whole.sides[1]) for rows in down)
    made = []
    for first in range(0, len(tiles), part.columns):
        before, after = (copied(part.tiles[first].sides[0], columns) for columns in across)
        row = [(tile.images, tile.trust) for tile in tiles[first : first + part.columns]]
        made.append([*before, *row, *after])
    return [row for row in (above, *made, below) if row]


def _copied(frame: Frame, box: Box, pixels: Pixels) -> tuple[Tensor, Tensor]:
    """Images and trust of what is as it was."""
    image = box.of(pixels).to(frame.dtype)
    images = image.expand(3 if frame.left_right else 1, *image.shape)
    return images, image.new_ones(1, 1, *image.shape[1:])


def assembled(
    frame: Frame, pixels: Tensor, parts: Iterator[Finished]
) -> tuple[list[Tensor], Tensor, dict[str, int]]:
    """Images, trust, and counts of the work done.

    The images are the centre, or centre, left and right, [C, H, W] each, in memory of its own: who
    keeps or saves one does not keep the others. Trust is [1, 1, H, W].

    Args:
        frame: What holds for the whole picture.
        pixels: [C, H, W], whose precision the result has.
        parts: From `finished`.
    """
    counts: list[dict[str, int]] = []
    if torch.is_grad_enabled():
        found = [part._replace(images=part.images.to(pixels.dtype)) for part in parts]
        counts = [part.counts for part in found]
        rows = list(in_rows(iter(found)))
        apart = [[part.images.unbind() for part in row] for row in rows]
        kinds = range(len(apart[0][0]))
        images = [joined([[part[kind] for part in row] for row in apart]) for kind in kinds]
        trust = joined([[part.trust for part in row] for row in rows]).to(pixels.dtype)
    else:
        images = [pixels.new_empty(pixels.shape) for _ in range(3 if frame.left_right else 1)]
        trust = pixels.new_empty(1, 1, *pixels.shape[-2:])
        for part in parts:
            for image, some in zip(images, part.images, strict=True):
                part.box.of(image).copy_(some)
            part.box.of(trust).copy_(part.trust)
            counts.append(part.counts)
    return images, trust, total(frame, counts)


def total(frame: Frame, counts: list[dict[str, int]]) -> dict[str, int]:
    """The counts of all regions together."""
    return {"slices": len(frame.radii), **added(*counts)}


def in_rows(parts: Iterator[Finished]) -> Iterator[list[Finished]]:
    """Those of a row of regions together."""
    row: list[Finished] = []
    for part in parts:
        if row and part.box.left == 0:
            yield row
            row = []
        row.append(part)
    yield row


def added(*counts: dict[str, int]) -> dict[str, int]:
    """The sums of some counts."""
    total: dict[str, int] = {}
    for each in counts:
        total |= {name: total.get(name, 0) + count for name, count in each.items()}
    return total


def joined(rows: list[list[Tensor]]) -> Tensor:
    """Pictures [..., h, w], beside and below each other, as one."""
    if torch.is_grad_enabled():
        return torch.cat([torch.cat(row, -1) for row in rows], -2)
    first = rows[0][0]
    size = sum(row[0].shape[-2] for row in rows), sum(one.shape[-1] for one in rows[0])
    whole = first.new_empty(*first.shape[:-2], *size)
    top = 0
    for row in rows:
        left = 0
        for one in row:
            height, width = one.shape[-2:]
            whole[..., top : top + height, left : left + width] = one
            left += width
        top += height
    return whole

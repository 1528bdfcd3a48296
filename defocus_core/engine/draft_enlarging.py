"""Drafts: a picture of half size enlarged from cells to px.

Beside its colours each cell is rendered with the share that its blur leaves of detail: how much of
that is shown in the end tells what nearer surfaces hide of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import torch
from torch import Tensor

from defocus_core.compositing.saturating_sum import pair_of
from defocus_core.engine.draft_cells import HalfSize, half_size, means
from defocus_core.engine.draft_detail import AROUND, Given, share_left, smooth, with_detail
from defocus_core.engine.frame import Frame
from defocus_core.engine.region_schedule import in_rows
from defocus_core.images.box import Box
from defocus_core.images.source import Pixels
from defocus_core.images.views import Views, added, joined
from defocus_core.runtime.checkpointing import recomputed
from defocus_core.runtime.threads import threaded

_PX = 2  # of a cell, on a side
# What stands for all detail of a cell beside its colours, as a share of what counts as a highlight:
# so little that it does not tell surfaces apart.
_UNIT = 2.0**-12
# Height and width in cells of tiles that are enlarged.
_TILE = (32, 512)
# Cells around a tile that decide what its px are.
_AROUND = AROUND + 1


class Enlarging:
    """What cells of a picture lack of it.

    Attributes:
        cells: [C + 1, h, w], what is to be rendered.
    """

    def __init__(self, frame: Frame, image: Pixels, pixels: Pixels, signed_radius: Pixels) -> None:
        """Nothing is rendered yet.

        Args:
            frame: What holds for all cells.
            image: [C, h, w] cells.
            pixels: [C, H, W] px of the picture.
            signed_radius: [H, W] px of the picture.
        """
        self._frame, self._threads = frame, frame.settings.threads
        self._size = signed_radius.shape[0], signed_radius.shape[1]
        limit = frame.content.limit
        # less than no light in a picture that has none
        unit = self._unit = _UNIT * limit if limit > 0 else -1.0
        self._of_px = (pixels, signed_radius)

        def merged(px: Tensor, radius: Tensor) -> Tensor:
            return torch.cat([means(px), unit * share_left(radius)[None]])

        held = isinstance(image, Tensor)
        share = half_size(share_left, signed_radius, threads=self._threads, hold=held)
        if isinstance(image, Tensor) and isinstance(share, Tensor):
            self.cells: Pixels = torch.cat([image, unit * share[None]])
        else:
            self.cells = HalfSize(merged, *self._of_px)

    def enlarged(self, parts: Iterator[Views]) -> Iterator[Views]:
        """Tiles of px, of rendered cells; the last rows of these wait for the ones below them."""
        done, kept = 0, list[Views]()
        counts: dict[str, int] = {}
        height, width = self._frame.size
        for row in in_rows(parts):
            counts = added([counts, *map(self._counts, row)])
            cells = joined([*([each] for each in kept), [joined([row])]])
            end = cells.box.sides[0].end
            ready = end if end == height else end - _AROUND
            tiles = [
                Box(top, left, min(_TILE[0], ready - top), min(_TILE[1], width - left))
                for top in range(done, ready, _TILE[0])
                for left in range(0, width, _TILE[1])
            ]
            tile = recomputed(partial(self._tile, cells))
            for part in threaded(tile, tiles, self._threads):
                yield part._replace(stats=counts)
                counts = {}
            first = max(ready - _AROUND, cells.box.top)
            done, kept = ready, [cells.within(Box(first, 0, end - first, width))]

    def _tile(self, cells: Views, tile: Box) -> Views:
        """Some cells as px; they count nothing."""
        wide = tile.grown(1, self._frame.box)  # for slopes of detail
        around = wide.grown(AROUND, self._frame.box)
        part, here = wide.seen_from(around), cells.within(around)
        images = torch.stack(list(here.images))
        own = around.of(self.cells).to(images.dtype)
        px = (self._px(wide).of(x).to(images.dtype) for x in self._of_px)
        given = Given(own[:-1], own[-1] / self._unit, *px)
        images = with_detail(images[:, :-1], images[:, -1] / self._unit, given, part)
        if not self._frame.content.signed:
            images = images.clamp(min=0)
        if len(images) > 1:
            pair = pair_of(*images, signed=self._frame.content.signed)
            images = torch.cat([images[:1], pair])
        box = self._px(tile)
        inner = box.seen_from(self._px(wide))
        trust = smooth(here.trust[None], part)[0]
        return Views(list(inner.of(images)), inner.of(trust), {}, box)

    def _px(self, cells: Box) -> Box:
        """The px of cells."""
        whole = Box(0, 0, *self._size)
        return Box(*(_PX * n for n in cells)).grown(0, whole)

    def _counts(self, part: Views) -> dict[str, int]:
        """Those of a part in cells, in px."""
        pixels = self._px(part.box).area
        copied = part.stats["pixels_copied"] * pixels // part.box.area
        return {**part.stats, "pixels": pixels, "pixels_copied": copied}

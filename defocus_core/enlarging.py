"""A picture rendered at half of its size, enlarged again: cells of two by two px become px.

Beside its colours each cell is rendered with the share that its blur leaves of detail: how much of
that is shown in the end tells what nearer surfaces hide of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.assembly import Finished, added, in_rows, joined
from defocus_core.compositing import pair_of
from defocus_core.detail import AROUND, Given, share_left, smooth, with_detail
from defocus_core.frame import Frame
from defocus_core.half_size import HalfSize, half_size, means
from defocus_core.source import Pixels
from defocus_core.threads import threaded
from defocus_core.tiling import Box

_PX = 2  # of a cell, on a side
# What stands for all detail of a cell beside its colours, as a share of what counts as a highlight:
# so little that it does not tell surfaces apart.
_UNIT = 2.0**-12
# Px that are made of cells at once.
_BAND = 1 << 17


class Enlarging:
    """What cells of a picture lack of it.

    Attributes:
        cells: [C + 1, h, w], what is to be rendered.
    """

    def __init__(
        self, frame: Frame, image: Pixels, pixels: Pixels, signed_radius: Pixels, *, threads: int
    ) -> None:
        """Nothing is rendered yet.

        Args:
            frame: What holds for all cells.
            image: [C, h, w] cells.
            pixels: [C, H, W] px of the picture.
            signed_radius: [H, W] px of the picture.
            threads: Bands enlarged at once.
        """
        self._frame, self._threads = frame, threads
        self._size = signed_radius.shape[0], signed_radius.shape[1]
        # less than no light in a picture that has none
        unit = self._unit = _UNIT * frame.limit if frame.limit > 0 else -1.0
        share = half_size(share_left, signed_radius, threads=threads)
        self._of_cells, self._of_px = (image, share), (pixels, signed_radius)

        def merged(px: Tensor, radius: Tensor) -> Tensor:
            return torch.cat([means(px), unit * share_left(radius)[None]])

        if isinstance(image, Tensor) and isinstance(share, Tensor):
            self.cells: Pixels = torch.cat([image, unit * share[None]])
        else:
            self.cells = HalfSize(merged, pixels, signed_radius)

    def enlarged(self, parts: Iterator[Finished]) -> Iterator[Finished]:
        """Bands of rows of px, of rendered cells; those wait for the ones below them."""
        done, kept = 0, list[_Cells]()
        counts: dict[str, int] = {}
        height = self._frame.size[0]
        rows = max(1, _BAND // (_PX * self._size[1]))
        for row in in_rows(parts):
            counts = added(counts, *map(self._counts, row))
            images = joined([[part.images for part in row]])
            trust = joined([[part.trust for part in row]])
            cells = _below_each_other([*kept, _Cells(row[0].box.top, images, trust)])
            ready = cells.end if cells.end == height else cells.end - AROUND
            some = [(first, min(first + rows, ready)) for first in range(done, ready, rows)]
            for part in threaded(partial(self._band, cells), some, self._threads):
                yield part._replace(counts=counts)
                counts = {}
            done, kept = ready, [cells.rows(ready - AROUND, cells.end)]

    def _band(self, cells: _Cells, rows: tuple[int, int]) -> Finished:
        """Some rows of cells as px; they count nothing."""
        (H, W), (height, width) = self._size, self._frame.size
        first, last = max(rows[0] - AROUND, 0), min(rows[1] + AROUND, height)
        around = rows[0] - first, last - rows[1]
        _, images, trust = cells.rows(first, last)
        box = Box(_PX * rows[0], 0, min(_PX * rows[1], H) - _PX * rows[0], W)
        of_cells = Box(first, 0, last - first, width)
        own = (*map(of_cells.of, self._of_cells), *map(box.of, self._of_px))
        given = Given(*(x.to(images.dtype) for x in own))
        images = with_detail(images[:, :-1], images[:, -1] / self._unit, given, *around)
        if not self._frame.signed:
            images = images.clamp(min=0)
        if len(images) > 1:
            pair = pair_of(*images, signed=self._frame.signed)
            images = torch.cat([images[:1], pair])
        return Finished(box, images, smooth(trust[0], *around)[None, :, : box.height, :W], {})

    def _counts(self, part: Finished) -> dict[str, int]:
        """Those of a part in cells, in px."""
        (H, W), box = self._size, part.box
        height = min(_PX * (box.top + box.height), H) - _PX * box.top
        width = min(_PX * (box.left + box.width), W) - _PX * box.left
        copied = part.counts["pixels_copied"] * height * width // box.area
        return {**part.counts, "pixels": height * width, "pixels_copied": copied}


class _Cells(NamedTuple):
    """Rendered rows of cells.

    Attributes:
        top: The first of them.
        images: [1 or 3, C + 1, n, w].
        trust: [1, 1, n, w].
    """

    top: int
    images: Tensor
    trust: Tensor

    @property
    def end(self) -> int:
        """The row after the last."""
        return self.top + self.images.shape[-2]

    def rows(self, first: int, end: int) -> _Cells:
        """Some of them."""
        first = max(first, self.top)
        cut = slice(first - self.top, end - self.top)
        return _Cells(first, self.images[..., cut, :], self.trust[..., cut, :])


def _below_each_other(some: list[_Cells]) -> _Cells:
    """Rows that follow each other, as one."""
    images = torch.cat([each.images for each in some], -2)
    return _Cells(some[0].top, images, torch.cat([each.trust for each in some], -2))

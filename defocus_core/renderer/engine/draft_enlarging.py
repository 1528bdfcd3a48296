"""Drafts: a rendered picture of half size enlarged from coarse pixels to pixels.

Beside its colours each coarse pixel is rendered with the share of detail that its blur leaves. The
part of this share that is shown afterwards gives the share of detail that nearer surfaces hide.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import torch
from torch import Tensor

from defocus_core.renderer.compositing.color_range import ColorRange
from defocus_core.renderer.compositing.saturating_sum import count_negative, pair_of
from defocus_core.renderer.engine.draft_coarse import HalfSize, means
from defocus_core.renderer.engine.draft_detail import (
    AROUND,
    Original,
    between,
    fraction_left,
    smooth,
    spread,
    with_detail,
)
from defocus_core.renderer.engine.frame import SharedFrame
from defocus_core.renderer.engine.region_schedule import in_rows
from defocus_core.tensors.box import Box
from defocus_core.tensors.checkpointing import recomputed
from defocus_core.tensors.source import Pixels, banded
from defocus_core.tensors.threads import threaded
from defocus_core.tensors.views import Views, added, joined

_PX = 2  # pixels on a side of a coarse pixel
# Value of the channel of detail where a coarse pixel has all of it, as a share of the limit of
# highlights: so little that it does not distinguish surfaces.
_UNIT = 2.0**-12
# (height, width) in coarse pixels of tiles that are enlarged.
_TILE = (32, 512)
# Coarse pixels around a tile that decide its pixels.
_AROUND = AROUND + 1


class Enlarging:
    """A picture in coarse pixels to be rendered, and its enlargement afterwards.

    Attributes:
        coarse: [C + 1, h, w], the coarse pixels to render: colours, and the share of detail.
    """

    def __init__(
        self, frame: SharedFrame, image: Pixels, pixels: Pixels, signed_radius: Pixels
    ) -> None:
        """Add the channel of detail to the coarse pixels.

        `image`: [C, h, w] coarse pixels; `pixels`: [C, H, W] px of the picture; `signed_radius`:
        [H, W] px of the picture.
        """
        self._frame, self._threads = frame, frame.settings.threads
        height, width = self._size = signed_radius.shape[-2], signed_radius.shape[-1]
        self._odd = height % 2 == 1, width % 2 == 1
        limit = frame.content.limit
        # less than no light in a picture that has none
        unit = self._unit = _UNIT * limit if limit > 0 else -1.0
        self._in_px = (pixels, signed_radius)
        ends = [(band.amin((-2, -1)), band.amax((-2, -1))) for band in banded(pixels)]
        lows, highs = (torch.stack(each).detach() for each in zip(*ends, strict=True))
        channels = [*zip(lows.amin(0).tolist(), highs.amax(0).tolist(), strict=True)]
        self._minimum = min(0.0, *(darkest for darkest, _ in channels))
        self._maximum = max(brightest for _, brightest in channels)
        self._channels = [
            (min(least), max(greatest))
            for least, greatest in (
                zip(*each, strict=True)
                for each in zip(channels, frame.content.channels, strict=False)
            )
        ]

        def merged(px: Tensor, radius: Tensor) -> Tensor:
            return torch.cat([means(px), unit * fraction_left(radius)[None]])

        if isinstance(image, Tensor):
            fraction = HalfSize(fraction_left, signed_radius).at_once(self._threads)
            self.coarse: Pixels = torch.cat([image, unit * fraction[None]])
        else:
            self.coarse = HalfSize(merged, *self._in_px)

    def enlarged(self, parts: Iterator[Views]) -> Iterator[Views]:
        """Tiles in pixels, from regions in coarse pixels; the last rows wait for those below."""
        done, kept = 0, list[list[Views]]()
        counts: dict[str, int] = {}
        height, width = self._frame.size
        for row in in_rows(parts):
            counts = added([counts, *map(self._counts, row)])
            coarse = joined([*kept, row])
            end = coarse.box.sides[0].end
            ready = end if end == height else end - _AROUND
            tiles = [
                Box(top, left, min(_TILE[0], ready - top), min(_TILE[1], width - left))
                for top in range(done, ready, _TILE[0])
                for left in range(0, width, _TILE[1])
            ]
            tile = recomputed(partial(self._tile, coarse))
            for part in threaded(tile, tiles, self._threads):
                yield part._replace(stats=added([counts, part.stats]))
                counts = {}
            first = max(ready - _AROUND, coarse.box.top)
            done, kept = ready, [[coarse.within(Box(first, 0, end - first, width))]]

    def _tile(self, coarse: Views, tile: Box) -> Views:
        """A tile of coarse pixels in pixels, which counts those that are clamped."""
        wide = tile.grown(1, self._frame.box)  # for gradients of detail
        around = wide.grown(AROUND, self._frame.box)
        part, rendered = wide.seen_from(around), coarse.within(around)
        images = torch.stack(list(rendered.images))
        sharp = around.of(self.coarse).to(images.dtype)
        # between the middles of the first and the last coarse pixels if their number is odd
        top, left, height, width = (_PX * n for n in wide)
        wide_px = Box(top, left, height - self._odd[0], width - self._odd[1])
        px, radius = (wide_px.of(x).to(images.dtype) for x in self._in_px)
        original = Original(sharp[:-1], sharp[-1] / self._unit, px, radius, self._odd)
        images = with_detail(
            images[:, :-1], images[:, -1] / self._unit, original, part, self._maximum
        )
        content, counts, box = self._frame.content, dict[str, int](), self._px(tile)
        inner = box.seen_from(wide_px)
        if len(images) > 1:
            counts |= count_negative(inner.of(images[1:]), content.limit, self._minimum)
        limits = ColorRange.of(self._channels, images[0], self._minimum)
        centre = limits.bounded(images[0])
        images = torch.cat([centre[None], images[1:]])
        if len(images) > 1:
            fraction = self._frame.division.left_fraction
            pair = pair_of(*images, minimum=self._minimum, fraction=fraction)
            images = torch.cat([images[:1], limits.bounded_pair(pair, centre, fraction)])
        trust = between(smooth(spread(rendered.trust[None]), part)[0], self._odd)
        return Views(list(inner.of(images)), inner.of(trust), counts, box)

    def _px(self, coarse: Box) -> Box:
        """The pixels of a rectangle of coarse pixels."""
        return Box(*(_PX * n for n in coarse)).grown(0, Box(0, 0, *self._size))

    def _counts(self, part: Views) -> dict[str, int]:
        """The counts of a part in coarse pixels, with pixels counted in pixels."""
        pixels = self._px(part.box).area
        copied = part.stats["pixels_copied"] * pixels // part.box.area
        counts = {**part.stats, "pixels": pixels, "pixels_copied": copied}
        counts.pop("pixels_clamped", None)  # of coarse pixels
        return counts

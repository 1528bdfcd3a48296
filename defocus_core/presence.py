"""Which slices of a picture reach which of its tiles, from a sample of its pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.antialiased import without_averages
from defocus_core.frame import Frame
from defocus_core.halving import axes, halves
from defocus_core.hidden import hidden_layers
from defocus_core.mixed import EDGE
from defocus_core.neighbours import extreme_around
from defocus_core.patches import Patch, patches
from defocus_core.planes import Planes
from defocus_core.ramps import without_ramps
from defocus_core.resampling import cells_read
from defocus_core.slicing import position
from defocus_core.slopes import slopes
from defocus_core.source import Pixels
from defocus_core.tiling import BLOCK, TILE, Box, blocks_at, visible_slices
from defocus_core.windows import Window

# Pixels of a sample at most, of one that shows what is hidden, and of the strips in which all are
# looked at.
_SAMPLE, _SAMPLE_BEHIND, _STRIP = 1 << 18, 1 << 20, 1 << 20
# Px of hidden content behind an edge that each pixel of a sample may stand for.
_WIDE = 16
# Px of overlap of strips: soft edges are as wide as that.
_OVERLAP = 12


class _Around(NamedTuple):
    """What the tiles of a frame see of a surface, at the resolution at which it is blurred.

    Attributes:
        blocks: [K, rows, columns] bool, where its rungs are.
        tiles: That are computed.
        plan: For each of them the rungs that reach it.
    """

    blocks: Tensor
    tiles: list[Box]
    plan: list[list[int]]


class Cover:
    """Where the slices of a surface are.

    Attributes:
        plan: For each tile the rungs of the ladder that reach it.
        layer_of: For each rung the number of the layer that it adds up to.
        windows: For each rung its window.
        halvings: How many times resolution is halved before anything else.
    """

    def __init__(
        self,
        around: _Around,
        blocks: Tensor,
        stride: int,
        layer_of: list[int],
        windows: list[Window],
        halvings: int = 0,
    ) -> None:
        """Nothing is tilted.

        Args:
            around: What tiles see, at the resolution at which slices are blurred.
            blocks: [K, rows, columns] bool, where every `stride`-th rung is in the frame.
            stride: In rungs.
            layer_of: See above.
            windows: See above.
            halvings: See above.
        """
        self.plan = [[k * stride for k in some] for some in around.plan]
        self.layer_of, self.windows, self.halvings = layer_of, windows, halvings
        self._around, self._blocks, self._stride = around, blocks, stride
        self._found: dict[Box, list[Box | None]] = {}
        self._leaning: Tensor | None = None
        self._planes: Planes | None = None

    def lean(self, leaning: Tensor, planes: Planes) -> None:
        """Tell that some are tilted.

        Args:
            leaning: [K, rows, columns] bool, where rungs have slopes.
            planes: Those that have the same all over.
        """
        self._leaning, self._planes = leaning, planes

    @property
    def shares(self) -> list[float]:
        """For each rung the share of the blocks of the frame that it is in."""
        found: list[float] = self._blocks.double().mean((1, 2)).tolist()
        return found

    def patches(self, rungs: list[int], tiles: list[int]) -> list[Patch | None]:
        """What tiles see of a layer, at the resolution at which it is blurred, by their numbers."""
        window, (blocks, every, _) = self.windows[rungs[0]], self._around
        margin = window.margin
        if window.halvings:  # it is read between cells
            margin = (margin + 2) << window.halvings
        some = blocks[[k // self._stride for k in rungs]].any(0)
        size = (some.shape[0] * BLOCK, some.shape[1] * BLOCK)
        (found,) = patches(some[None], [every[i] for i in tiles], [margin], size)
        return found

    def bounds(self, rung: int, box: Box) -> Box | None:
        """The rectangle in which a rung is, within one of the frame."""
        if box not in self._found:
            self._found[box] = self._bounds(box)
        return self._found[box][rung // self._stride]

    def _bounds(self, box: Box) -> list[Box | None]:
        rows, columns = _blocks_in(box)
        some = self._blocks[:, rows, columns]
        ends = [
            (here.long().argmax(1).tolist(), here.flip(1).long().argmax(1).tolist(), here.shape[1])
            for here in (some.any(2), some.any(1))
        ]
        found: list[Box | None] = []
        for k, exists in enumerate(some.flatten(1).any(1).tolist()):
            (top, below), (left, beside) = (
                (first[k] * BLOCK, (count - last[k]) * BLOCK) for first, last, count in ends
            )
            whole = Box(rows.start * BLOCK + top, columns.start * BLOCK + left, below - top, 0)
            whole = whole._replace(width=beside - left)
            found.append(whole.grown(0, box) if exists else None)
        return found

    def leaning(self, rungs: list[int], box: Box) -> list[int]:
        """Which of some rungs have slopes within a rectangle, and not the same all over."""
        if self._leaning is None or self._planes is None:
            return []
        rows, columns = _blocks_in(box)
        some = self._leaning[rungs, rows, columns].flatten(1).any(1).tolist()
        tilted = [rung for rung, leans in zip(rungs, some, strict=True) if leans]
        slopes = self._planes.slopes(tilted, box)
        return [rung for rung, slope in zip(tilted, slopes, strict=True) if slope is None]


class Presence:
    """Which slices reach which tiles.

    Attributes:
        frame: Of which this is told.
        visible: The surfaces that are seen.
        hidden: What is invented behind them, a cover for each layer.
        edges: Pixels on edges of depth.
        behind: Pixels behind which something is invented, of all layers.
    """

    def __init__(self, frame: Frame, signed_radius: Pixels, tiles: list[Box]) -> None:
        self.frame, self._tiles = frame, tiles
        H, W = frame.size
        step = _step(H * W)
        rows, self.edges = [], 0
        for strip, inner in _strips(signed_radius) if frame.edges else ():
            if frame.mending.antialiased is not None:
                steps = without_averages(strip, frame.mending.antialiased)
            else:
                steps = without_ramps(strip) if self._is_soft else strip
            least, most = (
                extreme_around(steps[inner], 1, end) for end in (torch.minimum, torch.maximum)
            )
            self.edges += int((most - least > EDGE).sum())
            rows.append(steps[inner][::step, ::step].clone())
        radius = torch.cat(rows) if rows else signed_radius[::step, ::step].detach()
        everywhere = torch.ones_like(radius, dtype=torch.bool)
        blocks = self._blocks(radius, everywhere, step, 1, (H, W))
        around = _Around(blocks.cpu(), tiles, visible_slices(blocks, frame.reaches, tiles))
        self.visible = Cover(around, blocks.cpu(), 1, frame.layers, frame.windows)
        if frame.tilted:  # lengths and radii shrink alike: slopes stay as they are
            lean = slopes(radius / step, frame.quality.least_slope)
            if lean is not None:
                leaning = self._blocks(radius, lean.any(0), step, 1, (H, W))
                places = position(radius, frame.radii)
                planes = Planes(lean, places, blocks.cpu(), BLOCK // step)
                self.visible.lean(leaning.cpu(), planes)
        fill = frame.invented
        self.behind = 0.0
        layers = self._behind(signed_radius) if frame.edges else []
        self.hidden = [
            Cover(
                self._around_behind(blocks),
                blocks.cpu(),
                fill.stride,
                fill.layers,
                fill.windows,
                fill.halvings,
            )
            for blocks in layers
        ]

    @property
    def _is_soft(self) -> bool:
        """Whether there are ramps of depth in the place of edges."""
        return self.frame.mending.ramps or self.frame.mending.has_edges

    def _blocks(
        self, radius: Tensor, some: Tensor, step: int, stride: int, size: tuple[int, int]
    ) -> Tensor:
        """Blocks [K, rows, columns] in which pixels, every `step`-th of a frame, have a rung."""
        radii = self.frame.radii[::stride]
        places = position(radius[some], radii)
        return blocks_at(places, torch.nonzero(some) * step, len(radii), size)

    def _around_behind(self, blocks: Tensor) -> _Around:
        """What tiles see of what is invented, of blocks of the frame that it is in."""
        frame, fill = self.frame, self.frame.invented
        tiles, fine = self._tiles, axes(frame.size)
        if fill.halvings:
            blocks = pad(blocks, (0, blocks.shape[2] % 2, 0, blocks.shape[1] % 2))
            blocks = blocks[:, ::2] | blocks[:, 1::2]
            blocks = blocks[..., ::2] | blocks[..., 1::2]
            down, across = (halves(n, axis).axis for n, axis in zip(frame.size, fine, strict=True))
            tiles = [cells_read(tile, fine, (down, across), 1) for tile in tiles]
        plan = visible_slices(blocks, fill.cells[:: fill.stride], tiles)
        return _Around(blocks.cpu(), tiles, plan)

    def _behind(self, signed_radius: Pixels) -> list[Tensor]:
        """Blocks [K, rows, columns] of each layer in which what is invented has a rung it uses.

        What is behind an edge is as wide as the radii differ: the greater, the coarser a sample
        shows it. Where it would still be too large, bands of tiles are looked at, and those between
        them are taken for alike.
        """
        (H, W), stride = self.frame.size, self.frame.invented.stride
        span = self.frame.radii[-1] - self.frame.radii[0]
        step = 1
        while step < BLOCK and step <= span / _WIDE and _SAMPLE * step**2 < H * W:
            step *= 2
        bands = max(1, math.ceil(H * W / step**2 / _SAMPLE_BEHIND))
        height = -(-H // bands // TILE) * TILE
        around = -(-math.ceil(2 * span) // BLOCK) * BLOCK
        quality = self.frame.quality
        found: list[list[Tensor]] = [[] for _ in range(quality.hidden_layers)]
        for top in range(0, H, height):
            looked_at = min(height, H - top, TILE if bands > 1 else H)
            above = min(top, around)
            wide = signed_radius[top - above : top + looked_at + around : step, ::step].detach()
            small = without_ramps(wide / step) if self._is_soft else wide / step
            inner = slice(above // step, -(-(above + looked_at) // step))
            share = min(height, H - top) / looked_at
            rows = -(-min(height, H - top) // BLOCK)
            layers = hidden_layers(small[None], small, further=quality.further)
            for i, bands_of in enumerate(found):
                far, some = small * step, torch.zeros_like(small, dtype=torch.bool)
                if i < len(layers):
                    far, some = layers[i].signed_radius * step, layers[i].mask
                self.behind += share * step**2 * int(some[inner].sum())
                blocks = self._blocks(far[inner], some[inner], step, stride, (looked_at, W))
                bands_of += [blocks] * (rows // blocks.shape[1])
                bands_of.append(blocks[:, : rows % blocks.shape[1]])
        return [torch.cat(bands_of, 1) for bands_of in found]


def _step(pixels: int) -> int:
    """Every how many pixels, on both axes, a frame is sampled: a power of two, a block at most."""
    step = 1
    while pixels > _SAMPLE * step * step and step < BLOCK:
        step *= 2
    return step


def _strips(signed_radius: Pixels) -> Iterator[tuple[Tensor, slice]]:
    """Some rows with a few around them, and which of them are the strip's own."""
    H, W = signed_radius.shape
    height = max(BLOCK, _STRIP // W // BLOCK * BLOCK)
    for top in range(0, H, height):
        above = min(top, _OVERLAP)
        strip = signed_radius[top - above : top + height + _OVERLAP].detach()
        yield strip, slice(above, above + min(height, H - top))


def _blocks_in(box: Box) -> tuple[slice, slice]:
    """Rows and columns of the blocks that a rectangle touches."""
    rows, columns = (
        slice(max(start // BLOCK, 0), max(-(-(start + length) // BLOCK), 0))
        for start, length in ((box.top, box.height), (box.left, box.width))
    )
    return rows, columns

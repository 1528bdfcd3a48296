"""Which slices of a picture reach which of its tiles, from a sample of its pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from defocus_core.backdrop import halvings_for, level_of
from defocus_core.continuation import REACH
from defocus_core.frame import Frame
from defocus_core.hidden import FINE, hidden_layer
from defocus_core.ramps import without_ramps
from defocus_core.slicing import position
from defocus_core.slopes import slopes
from defocus_core.source import Pixels
from defocus_core.tiling import BLOCK, TILE, blocks_at, visible_slices

# Pixels of a sample at most, of one that shows what is hidden, and of the strips in which all are
# looked at.
_SAMPLE, _SAMPLE_BEHIND, _STRIP = 1 << 18, 1 << 20, 1 << 20
# Px of hidden content behind an edge that each pixel of a sample may stand for.
_WIDE = 16
# The share of the way from near to far radii in which one border does for several of them.
_BETWEEN = 0.3
# Px of overlap of strips: soft edges are as wide as that.
_OVERLAP = 12
# Range of radii between neighbours on an edge, and how many pixels wide it is.
_EDGE, _EDGE_WIDTH = 1.5, 2


class Presence:
    """Which slices reach which tiles.

    Attributes:
        frame: Of which this is told.
        visible: For each tile the rungs of the ladder that reach it.
        tilted: Those of them that have slopes there.
        hidden: For each tile the rungs of what is invented behind its surfaces.
        edges: Pixels on edges of depth.
        continued: Pixels of the blocks from which hidden content is continued.
    """

    def __init__(self, frame: Frame, signed_radius: Pixels) -> None:
        self.frame = frame
        H, W = frame.size
        step = _step(H * W)
        rows, self.edges = [], 0
        for strip, inner in _strips(signed_radius) if frame.edges else ():
            for jump in (strip[inner.start : inner.stop + 1].diff(dim=0), strip[inner].diff(dim=1)):
                self.edges += _EDGE_WIDTH * int((jump.abs() > _EDGE).sum())
            rows.append(without_ramps(strip)[inner][::step, ::step].clone())
        radius = torch.cat(rows) if rows else signed_radius[::step, ::step].detach()
        everywhere = torch.ones_like(radius, dtype=torch.bool)
        self.visible = self._tiles(self._blocks(radius, everywhere, step, 1, (H, W)), 1)
        self.tilted: list[list[int]] = [[] for _ in self.visible]
        if frame.tilted:  # lengths and radii shrink alike: slopes stay as they are
            lean = slopes(radius / step, frame.quality.least_slope)
            if lean is not None:
                self.tilted = self._tiles(self._blocks(radius, lean.any(0), step, 1, (H, W)), 1)
        self.hidden: list[list[int]] = [[] for _ in self.visible]
        self.continued = 0.0
        if frame.edges:
            self.hidden = self._behind(signed_radius)

    def _blocks(
        self, radius: Tensor, some: Tensor, step: int, stride: int, size: tuple[int, int]
    ) -> Tensor:
        """Blocks [K, rows, columns] in which pixels, every `step`-th of a frame, have a rung."""
        radii = self.frame.radii[::stride]
        places = position(radius[some], radii)
        return blocks_at(places, torch.nonzero(some) * step, len(radii), size)

    def _tiles(self, blocks: Tensor, stride: int) -> list[list[int]]:
        """For each tile the rungs that reach it, numbered as in the whole ladder."""
        found = visible_slices(blocks, self.frame.reaches[::stride], self.frame.grid.tiles)
        return [[k * stride for k in some] for some in found]

    def _behind(self, signed_radius: Pixels) -> list[list[int]]:
        """For each tile the rungs of what is invented there.

        What is behind an edge is as wide as the radii differ: the greater, the coarser a sample
        shows it. Where it would still be too large, bands of tiles are looked at, and those between
        them are taken for alike.
        """
        (H, W), stride = self.frame.size, self.frame.stride
        span = self.frame.radii[-1] - self.frame.radii[0]
        step = 1
        while step < BLOCK and step <= span / _WIDE and _SAMPLE * step**2 < H * W:
            step *= 2
        bands = max(1, math.ceil(H * W / step**2 / _SAMPLE_BEHIND))
        height = -(-H // bands // TILE) * TILE
        around = -(-math.ceil(2 * span) // BLOCK) * BLOCK
        found: list[Tensor] = []
        for top in range(0, H, height):
            looked_at = min(height, H - top, TILE if bands > 1 else H)
            above = min(top, around)
            wide = signed_radius[top - above : top + looked_at + around : step, ::step].detach()
            small = without_ramps(wide / step)
            inner = slice(above // step, -(-(above + looked_at) // step))
            behind = hidden_layer(small[None], small)
            far, some = small * step, torch.zeros_like(small, dtype=torch.bool)
            if behind:
                far, some = behind.signed_radius * step, behind.mask
            share = min(height, H - top) / looked_at
            hidden = _continued(small[inner] * step, far[inner], some[inner], step)
            self.continued += share * hidden
            blocks = self._blocks(far[inner], some[inner], step, stride, (looked_at, W))
            rows = -(-min(height, H - top) // BLOCK)
            found += [blocks] * (rows // blocks.shape[1])
            found.append(blocks[:, : rows % blocks.shape[1]])
        return self._tiles(torch.cat(found, 1), stride)


def _continued(near: Tensor, far: Tensor, some: Tensor, step: int) -> float:
    """Pixels of the blocks from which hidden content is continued.

    Args:
        near: [h, w] px, every `step`-th pixel.
        far: [h, w] px, what lies behind.
        some: [h, w] bool, where anything does.
        step: In px.
    """
    near, far, at = near[some], far[some], torch.nonzero(some) * step
    unit = ((far - near) * _BETWEEN).log2().floor().exp2()
    border = ((near + (far - near) / 4) / unit).round() * unit
    levels = level_of(far - near).clamp(min=FINE)
    total = 0.0
    for level in torch.unique(levels).tolist():
        side, here = 2 * REACH << level, levels == level
        cells = at[here].div(side, rounding_mode="floor")
        blocks = len(torch.unique(torch.cat([cells, border[here, None]], 1), dim=0))
        total += blocks * (1.5 * side) ** 2 / (4 ** halvings_for(level) if level > FINE else 1)
    return total


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

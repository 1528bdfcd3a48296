"""What blurring the slices of a picture amounts to: samples of transforms, calls, bytes.

It follows the steps of `blur` and of `reduced`: slices of small radii tile by tile, those of large
ones a region at once, within the rectangle that they cover.
"""

from __future__ import annotations

import math

from defocus_core.frame import Frame
from defocus_core.patches import patch_of
from defocus_core.presence import Cover
from defocus_core.spans import Span
from defocus_core.tiling import Box, Grid
from defocus_core.windows import Window

# Of these loads something is done for a region as a whole, and something for each of its tiles.
_LOADS = ("calls", "averaged", "forward", "products", "inverse", "composited")
# A sample of a kernel takes as long as so many of its transform, per level of this.
_SAMPLED = 400.0


class Workload:
    """Counts that grow as surfaces of regions are added.

    Attributes:
        of_regions: Loads of regions as a whole, in samples of one channel and one part.
        of_tiles: Loads of tiles, likewise.
        widest: Samples of the transforms of a tile that are held at once, at most.
        reduced: Samples of the layers of a region at reduced resolution, at most.
        done: Slices of tiles that are computed.
        read: Those of them that are only read, at reduced resolution.
    """

    def __init__(self, frame: Frame, tiles: list[Box]) -> None:
        self._frame, self._parts = frame, len(frame.parts)
        self.of_regions, self.of_tiles = (dict.fromkeys(_LOADS, 0.0) for _ in range(2))
        self.widest = self.reduced = 0.0
        self.done = self.read = 0
        self._spectra: set[tuple[int, int, tuple[int, int], bool]] = set()
        self._kernels: dict[tuple[int, int], int] = {}
        self._tiles, self._number = tiles, {tile: i for i, tile in enumerate(tiles)}

    def add(self, grid: Grid, surfaces: list[Cover]) -> None:
        """A region that is not a copy, and its surfaces."""
        tiles, reduced = [self._number[tile] for tile in grid.tiles], 0.0
        for surface in surfaces:
            self.done += sum(len(surface.plan[i]) for i in tiles)
            present = {k for i in tiles for k in surface.plan[i]}
            for number in sorted({surface.layer_of[k] for k in present}):
                rungs = sorted(k for k in present if surface.layer_of[k] == number)
                self._add_tiles(surface, tiles, rungs)
                if surface.windows[rungs[0]].halvings:
                    reduced += self._add_reduced(surface, grid.box, rungs)
        self.reduced = max(self.reduced, reduced)

    def _add_tiles(self, surface: Cover, tiles: list[int], rungs: list[int]) -> None:
        """A layer, where tiles see it."""
        loads, window = self.of_tiles, surface.windows[rungs[0]]
        for i, patch in zip(tiles, surface.patches(rungs, tiles), strict=True):
            some = [k for k in rungs if k in surface.plan[i]]
            if not some or patch is None:
                continue
            if window.halvings or surface.halvings:
                self.read += len(some)
            loads["calls"] += 1
            loads["composited"] += patch.seen.area * self._parts
            if window.halvings:
                continue
            loads["calls"] += 1 + len(some)
            if not window.margin:  # copied
                continue
            box = self._tiles[i].around(window.margin)
            tilted = surface.leaning(some, box)
            size = window.fitting(patch.least)
            self._learn(window, size, some, tilted)
            loads["calls"] += 2 * len(tilted)
            self._transformed(loads, size, len(some) + 2 * len(tilted))

    def _add_reduced(self, surface: Cover, core: Box, rungs: list[int]) -> float:
        """A layer that is blurred at reduced resolution; returns its samples."""
        frame, loads, window = self._frame, self.of_regions, surface.windows[rungs[0]]
        step, margin = 1 << window.halvings + surface.halvings, window.margin
        inner = core.grown(frame.farthest, frame.box)
        rows, columns = (span.grown(1) for span in _cells(core, step, frame.size))
        boxes = [box for k in rungs if (box := surface.bounds(k, inner))]
        if not boxes:
            return 0.0
        patch = patch_of(_cells(_joined(boxes), step, frame.size), (rows, columns), margin)
        if patch is None:
            return 0.0
        size = window.fitting(patch.least)
        tilted = surface.leaning(rungs, core.around((margin + 3) * step))
        self._learn(window, size, rungs, tilted)
        terms = len(rungs) + 2 * len(tilted)
        loads["calls"] += 2 * len(rungs) + terms + 1
        share = terms / len(rungs)
        samples = sum(box.area for box in boxes)
        loads["averaged"] += share * samples / 4**surface.halvings
        self._transformed(loads, size, terms)
        return patch.seen.area * self._parts

    def _transformed(self, loads: dict[str, float], size: tuple[int, int], terms: int) -> None:
        """Transforms of a layer."""
        area = size[0] * size[1]
        loads["forward"] += terms * area * math.log2(area)
        loads["products"] += terms * area * self._parts
        loads["inverse"] += area * math.log2(area) * self._parts
        if loads is self.of_tiles:
            self.widest = max(self.widest, (terms + self._parts) * area)

    def _learn(
        self, window: Window, size: tuple[int, int], rungs: list[int], leaning: list[int]
    ) -> None:
        """Kernels, and spectra of these, which are made once."""
        self._kernels |= {(id(window), k): (2 * window.margin + 1) ** 2 for k in rungs}
        self._spectra |= {(id(window), k, size, False) for k in rungs}
        self._spectra |= {(id(window), k, size, True) for k in leaning}

    def kernels(self) -> tuple[float, float, float]:
        """What kernels and their spectra take.

        Returns:
            To make them; samples of all that are kept; and of those made at once, at most.
        """
        areas = [
            ((1 + leaning) * self._parts * size[0] * size[1], math.log2(size[0] * size[1]))
            for _, _, size, leaning in self._spectra
        ]
        sampled = _SAMPLED * self._parts * sum(self._kernels.values())
        work = sampled + math.fsum(samples * levels for samples, levels in areas)
        kept = [float(samples) for samples, _ in areas]
        return work, sum(kept), max(kept, default=0.0)


def _joined(boxes: list[Box]) -> Box:
    """The rectangle that holds some others."""
    top, left = min(box.top for box in boxes), min(box.left for box in boxes)
    below = max(box.top + box.height for box in boxes)
    beside = max(box.left + box.width for box in boxes)
    return Box(top, left, below - top, beside - left)


def _cells(box: Box, step: int, size: tuple[int, int]) -> tuple[Span, Span]:
    """The cells of a frame of some size between which pixels lie, along both axes."""
    found = []
    for n, side in zip(size, box.sides, strict=True):
        offset = (1 - n % 2) / 2
        first, last = (
            math.floor((at - n // 2 + offset) / step - offset) for at in (side.first, side.end - 1)
        )
        found.append(Span(first, last + 2))
    return found[0], found[1]

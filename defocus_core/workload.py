"""What blurring the slices of a picture amounts to: samples of transforms, calls, bytes.

It follows the steps of `blur` and of `reduced`: slices of small radii tile by tile, those of large
ones a region at once, within the rectangle that they cover.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from defocus_core.frame import Frame
from defocus_core.presence import Cover
from defocus_core.tiling import Box, Grid
from defocus_core.windows import Window

# Of these loads something is done for a region as a whole, and something for each of its tiles.
_LOADS = ("calls", "averaged", "forward", "products", "inverse", "composited")
_Span = tuple[int, int]


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

    def __init__(self, frame: Frame, channels: int) -> None:
        self._frame, self._parts = frame, len(frame.parts)
        self._channels = channels
        self.of_regions, self.of_tiles = (dict.fromkeys(_LOADS, 0.0) for _ in range(2))
        self.widest = self.reduced = 0.0
        self.done = self.read = 0
        self._spectra: set[tuple[int, tuple[int, int], bool]] = set()
        self._number = {tile: i for i, tile in enumerate(frame.grid.tiles)}

    def add(self, grid: Grid, surfaces: list[Cover]) -> None:
        """A region that is not a copy, and its surfaces."""
        reduced = 0.0
        for surface in surfaces:
            plans = [surface.plan[self._number[tile]] for tile in grid.tiles]
            self.done += sum(map(len, plans))
            for i, tile in enumerate(grid.tiles):
                self._add_tile(surface, tile, plans[i])
            reduced += self._add_region(surface, grid, plans)
        self.reduced = max(self.reduced, reduced)

    def _add_tile(self, surface: Cover, tile: Box, rungs: list[int]) -> None:
        loads, area = self.of_tiles, tile.height * tile.width
        for window, some in _by_window(surface.windows, rungs):
            layers = len({surface.layer_of[k] for k in some})
            loads["calls"] += layers
            loads["composited"] += layers * area * self._parts
            if window.halvings or surface.halvings:
                self.read += len(some)
            if window.halvings:
                continue
            loads["calls"] += 1 + len(some)
            if not window.margin:  # copied
                continue
            tilted, planar = surface.leaning(some, tile.around(window.margin))
            self._learn(window.size, some, [*tilted, *planar])
            loads["calls"] += 2 * len(tilted) + len(planar)
            terms = len(some) + 2 * len(tilted)
            self._transformed(loads, window.size, terms, len(planar), layers)

    def _add_region(self, surface: Cover, grid: Grid, plans: list[list[int]]) -> float:
        """What is blurred at reduced resolution; returns the samples of its layers."""
        frame, loads, held = self._frame, self.of_regions, 0.0
        present = sorted({k for rungs in plans for k in rungs})
        core = grid.box
        inner = core.grown(frame.farthest, frame.box)
        for window, some in _by_window(surface.windows, present):
            if not window.halvings:
                continue
            step, margin = 1 << window.halvings + surface.halvings, window.margin
            around = [_grown(span, 1) for span in _cells(core, step, frame.size)]
            for number in dict.fromkeys(surface.layer_of[k] for k in some):
                rungs = [k for k in some if surface.layer_of[k] == number]
                boxes = [box for k in rungs if (box := surface.bounds(k, inner))]
                if not boxes:
                    continue
                lit = [
                    _within(one, _grown(other, margin))
                    for one, other in zip(
                        _cells(_joined(boxes), step, frame.size), around, strict=True
                    )
                ]
                seen = [
                    _within(_grown(one, margin), other)
                    for one, other in zip(lit, around, strict=True)
                ]
                if any(end <= first for first, end in (*lit, *seen)):
                    continue
                size = window.fitting(
                    [
                        max(there[1] - here[0], here[1] - there[0]) + margin
                        for here, there in zip(lit, seen, strict=True)
                    ]
                )
                tilted, planar = surface.leaning(rungs, core.around((margin + 3) * step))
                self._learn(size, rungs, [*tilted, *planar])
                terms = len(rungs) + 2 * len(tilted)
                loads["calls"] += 2 * len(rungs) + terms + len(planar) + 1
                share = terms / len(rungs)
                samples = sum(box.height * box.width for box in boxes)
                loads["averaged"] += share * samples / 4**surface.halvings
                self._transformed(loads, size, terms, len(planar), 1)
                held += (seen[0][1] - seen[0][0]) * (seen[1][1] - seen[1][0]) * self._parts
        return held

    def _transformed(
        self, loads: dict[str, float], size: tuple[int, int], terms: int, planar: int, results: int
    ) -> None:
        """Transforms of a size; kernels of planes are tilted before they are multiplied."""
        area = size[0] * size[1]
        loads["forward"] += terms * area * math.log2(area)
        loads["products"] += (terms + 2 * planar / self._channels) * area * self._parts
        loads["inverse"] += results * area * math.log2(area) * self._parts
        if loads is self.of_tiles:
            self.widest = max(self.widest, (terms + results * self._parts) * area)

    def _learn(self, size: tuple[int, int], rungs: list[int], leaning: list[int]) -> None:
        """Spectra of kernels, which are made once."""
        self._spectra |= {(k, size, False) for k in rungs} | {(k, size, True) for k in leaning}

    def kernels(self) -> tuple[float, float, float]:
        """What spectra of kernels take.

        Returns:
            To make them; samples of all that are kept; and of those made at once, at most.
        """
        work = kept = most = 0.0
        for _, size, leaning in self._spectra:
            area = size[0] * size[1]
            samples = (1 + leaning) * self._parts * area
            work += samples * math.log2(area)
            kept, most = kept + samples, max(most, samples)
        return work, kept, most


def _by_window(windows: list[Window], rungs: list[int]) -> Iterator[tuple[Window, list[int]]]:
    """The rungs that share each window."""
    found: dict[int, list[int]] = {}
    for k in rungs:
        found.setdefault(id(windows[k]), []).append(k)
    for some in found.values():
        yield windows[some[0]], some


def _joined(boxes: list[Box]) -> Box:
    """The rectangle that holds some others."""
    top, left = min(box.top for box in boxes), min(box.left for box in boxes)
    below = max(box.top + box.height for box in boxes)
    beside = max(box.left + box.width for box in boxes)
    return Box(top, left, below - top, beside - left)


def _cells(box: Box, step: int, size: tuple[int, int]) -> list[_Span]:
    """The cells of a frame of some size between which pixels lie, along both axes."""
    found = []
    for n, start, length in zip(size, box[:2], box[2:], strict=True):
        offset = (1 - n % 2) / 2
        first, last = (
            math.floor((at - n // 2 + offset) / step - offset) for at in (start, start + length - 1)
        )
        found.append((first, last + 2))
    return found


def _grown(span: _Span, by: int) -> _Span:
    return span[0] - by, span[1] + by


def _within(one: _Span, other: _Span) -> _Span:
    return max(one[0], other[0]), min(one[1], other[1])

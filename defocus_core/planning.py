"""What rendering a picture will take, counted without rendering it.

A plan follows the renderer's own rules, on every pixel of a small frame and on a sample of a large
one: which slices there are, which tiles they reach, through which windows, what lies hidden, which
pixels are lights. Its loads are proportional to time, its bytes to memory; how much of each there
is to a load differs from machine to machine and is for the caller to measure.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import torch

from defocus_core.aperture import Aperture
from defocus_core.frame import Frame, frame_of
from defocus_core.highlights import reached_by
from defocus_core.presence import Presence
from defocus_core.quality import find
from defocus_core.region import in_focus
from defocus_core.source import Pixels, banded, bands
from defocus_core.tiling import Grid, regions
from defocus_core.windows import Window

# Loads of the tiles of a region, and of a region as a whole; what remains is the frame's.
TILE_LOADS = ("calls", "forward", "products", "inverse")
REGION_LOADS = ("regions", "around", "hidden", "edges", "lights")
LOADS = ("frame", "pixels", "kernels", *REGION_LOADS, *TILE_LOADS)
# Bytes of the coarse picture of the frame and the spectra of kernels, of each region, of what is
# made of each, and of each tile in work.
BYTES = ("backdrop", "spectra", "region", "result", "tile")


@dataclass(frozen=True)
class Plan:
    """Counts, as `Rendering.stats` has them, and what they amount to.

    Attributes:
        slices: Of the ladder.
        tiles: Of the frame.
        regions: That its tiles are put into.
        slice_tiles: What a renderer that skips nothing would do.
        slice_tiles_done: What is done.
        tiles_with_hidden: Tiles behind whose surface something is invented.
        loads: By the names in `LOADS`.
        bytes: By the names in `BYTES`; those of one region and of one tile are the most of any.
    """

    slices: int
    tiles: int
    regions: int
    slice_tiles: int
    slice_tiles_done: int
    tiles_with_hidden: int
    loads: dict[str, float]
    bytes: dict[str, float]


def plan(
    signed_radius: Pixels,
    *,
    image: Pixels | None = None,
    channels: int = 3,
    aperture: Aperture | None = None,
    quality: str = "standard",
    left_right: bool = False,
    tile: int | None = None,
) -> Plan:
    """Count what `render` would do.

    Args:
        signed_radius: [H, W] px, finite.
        image: [C, H, W], linear light; None if it is not known: then it has no lights.
        channels: C, if there is no image.
        aperture: The pupil, a round one by default.
        quality: As for `render`.
        left_right: As for `render`.
        tile: As for `render`.

    Raises:
        ValueError: If the quality is unknown or the frame is not [H, W].
    """
    if len(signed_radius.shape) != 2 or 0 in signed_radius.shape:
        raise ValueError(f"signed_radius must be [H, W], got {tuple(signed_radius.shape)}")
    if image is None:
        image = torch.zeros((1, 1, 1), device=signed_radius.device)
        image = image.expand(channels, *signed_radius.shape)
    frame = frame_of(
        image,
        signed_radius,
        aperture=aperture or Aperture(),
        quality=find(quality),
        left_right=left_right,
        num_layers=None,
        psf_ks=None,
        hidden=None,
        threads=1,
        tile=tile,
    )
    scene = Presence(frame, signed_radius)
    every = [grid for row in regions(frame.grid, frame.margin) for grid in row]
    grids = [grid for grid in every if not in_focus(frame, grid.box, signed_radius)]
    blurred = {tile for grid in grids for tile in grid.tiles}
    for plans in (scene.visible, scene.tilted, scene.hidden):
        plans[:] = [
            some if tile in blurred else []
            for tile, some in zip(frame.grid.tiles, plans, strict=True)
        ]
    work = _Work(scene, grids)
    around = [
        _area(grid, frame.margin, frame) + _area(grid, frame.farthest, frame) for grid in grids
    ]
    (H, W), channels = frame.size, image.shape[0]
    pixels, parts, size = H * W, len(frame.parts), frame.dtype.itemsize
    samples = (channels + 1) * size / 4
    discs, blocks = _lights(frame, image, signed_radius, grids, scene.visible)
    repeated = sum(around) / (2 * pixels)
    loads = {
        "frame": 1.0,
        "pixels": pixels * samples,
        "kernels": work.kernels * parts,
        "regions": float(len(grids)),
        "around": sum(around) * samples,
        "hidden": (scene.continued * repeated + blocks) * samples,
        "edges": scene.edges * repeated,
        "lights": discs,
        "calls": work.calls,
        "forward": work.forward * samples,
        "products": work.products * samples * parts,
        "inverse": work.inverse * samples * parts,
    }
    held = {
        "backdrop": pixels * (1 + (channels + 2) * size / 16) if frame.edges else 0.0,
        "spectra": work.spectra * parts * 2 * size,
        "region": 4 * max(around, default=0.0) * samples * (1 + bool(discs)),
        "result": max(_area(grid, 0, frame) for grid in every)
        * (channels * (3 if left_right else 1) + 1)
        * size,
        "tile": 4 * work.widest * samples,
    }
    return Plan(
        slices=len(frame.radii),
        tiles=len(frame.grid.tiles),
        regions=len(every),
        slice_tiles=2 * len(frame.radii) * len(frame.grid.tiles),
        slice_tiles_done=sum(map(len, [*scene.visible, *scene.hidden])),
        tiles_with_hidden=sum(1 for some in scene.hidden if some),
        loads=loads,
        bytes=held,
    )


class _Work:
    """What the slices of a scene amount to: samples of transforms, counts of calls."""

    def __init__(self, scene: Presence, grids: list[Grid]) -> None:
        frame, windows = scene.frame, scene.frame.windows
        self._frame, self._parts = frame, len(frame.parts)
        self.calls = self.forward = self.products = self.inverse = self.widest = 0.0
        number = {tile: i for i, tile in enumerate(frame.grid.tiles)}
        for grid in grids:
            tiles = [number[tile] for tile in grid.tiles]
            for plan, together in ((scene.visible, False), (scene.hidden, True)):
                for i in tiles:
                    self._add_tile(plan[i], [] if together else scene.tilted[i], together)
                self._add_region(
                    [plan[i] for i in tiles],
                    [scene.tilted[i] for i in tiles if not together],
                    _area(grid, frame.farthest, frame),
                    together,
                )
        kinds = 3 if any(scene.tilted) else 1
        areas = [w.size[0] * w.size[1] for w in windows if w.margin]
        self.spectra = kinds * sum(areas) / 2
        self.kernels = kinds * sum(area * math.log2(area) for area in areas)

    def _add_tile(self, rungs: list[int], tilted: list[int], together: bool) -> None:
        """A tile of a surface whose layers add up together, or do not."""
        leaning = set(tilted)
        for window, some in _by_window(self._frame.windows, rungs):
            results = 1 if together else len({self._frame.layers[k] for k in some})
            if window.halvings:  # only read
                self.calls += results
                self.products += results * self._frame.grid.side**2
                continue
            lean = 0 if together else len(leaning.intersection(some))
            self.calls += len(some) + 2 * lean + results
            if window.margin:  # else copied
                self._add(window.size[0] * window.size[1], len(some) + 2 * lean, results)

    def _add_region(
        self, plans: list[list[int]], tilted: list[list[int]], pixels: float, together: bool
    ) -> None:
        """What is blurred at reduced resolution, for some tiles at once.

        A slice is averaged and transformed within what it covers, about the share of tiles that it
        reaches.
        """
        reached = Counter(k for rungs in plans for k in rungs)
        leaning = {k for rungs in tilted for k in rungs}
        for window, some in _by_window(self._frame.windows, sorted(reached)):
            if not window.halvings:
                continue
            share = max(reached[k] for k in some) / len(plans)
            lean = len(leaning.intersection(some))
            results = 1 if together else len({self._frame.layers[k] for k in some})
            self.calls += len(some) + 2 * lean + results
            self.products += (
                pixels
                * sum((3 if k in leaning else 1) * reached[k] for k in some)
                / (len(plans) * self._parts)
            )
            self._add(share * window.size[0] * window.size[1], len(some) + 2 * lean, results)

    def _add(self, area: float, terms: int, results: int) -> None:
        """Transforms of so many samples."""
        self.forward += terms * area * math.log2(area)
        self.products += terms * area
        self.inverse += results * area * math.log2(area)
        self.widest = max(self.widest, (terms + results * self._parts) * area)


def _by_window(windows: list[Window], rungs: list[int]) -> Iterator[tuple[Window, list[int]]]:
    """The rungs that share each window."""
    found: dict[int, list[int]] = {}
    for k in rungs:
        found.setdefault(id(windows[k]), []).append(k)
    for some in found.values():
        yield windows[some[0]], some


def _lights(
    frame: Frame, image: Pixels, radius: Pixels, grids: list[Grid], visible: list[list[int]]
) -> tuple[float, float]:
    """What lights ask for, in all regions that they reach.

    Returns:
        Samples of their discs, as often as parts and nearer slices look at them; and pixels of the
        blocks from which what surrounds them is continued.
    """
    found = []
    for (top, _), some, r in zip(bands(*frame.size), banded(image), banded(radius), strict=True):
        rows, columns = torch.nonzero(some.amax(0) > frame.limit).unbind(1)
        found.append((torch.stack([rows + top, columns], 1), r[rows, columns]))
    at, r = map(torch.cat, zip(*found, strict=True))
    if not len(at):
        return 0.0, 0.0
    spread = (r.abs() - 0.5).ceil().clamp(0, max(frame.size))
    present = sorted({k for some in visible for k in some})
    nearer = r.new_tensor([frame.radii[k] for k in present]) < r[:, None] - 1.5
    samples = (2 * spread + 1) ** 2 * (nearer.sum(1) + len(frame.parts))
    side = 2 * reached_by(0)
    discs = blocks = 0.0
    for grid in grids:
        first = at.new_tensor(grid.box[:2])
        last = first + at.new_tensor(grid.box[2:]) - 1
        far = torch.maximum(first - at, at - last).amax(1)
        discs += float(samples[far <= spread].sum())
        cells = at[far <= frame.margin].div(side, rounding_mode="floor")
        blocks += len(torch.unique(cells, dim=0)) * (1.5 * side) ** 2
    return discs, blocks


def _area(grid: Grid, margin: int, frame: Frame) -> float:
    """Pixels of a region with a margin."""
    box = grid.box.grown(margin, frame.box)
    return float(box.height * box.width)

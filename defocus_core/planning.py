"""What rendering a picture will take, counted without rendering it.

A plan follows the renderer's own rules, on every pixel of a small frame and on a sample of a large
one: which slices there are, which tiles they reach, through which windows, what lies hidden, which
pixels are lights. Its loads are proportional to time, its bytes to memory; how much of each there
is to a load differs from machine to machine and is for the caller to measure.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from defocus_core.aperture import Aperture, parts
from defocus_core.convolution import reach, transform_length
from defocus_core.hidden import hidden_layer
from defocus_core.highlights import split
from defocus_core.quality import Quality, find
from defocus_core.ramps import without_ramps
from defocus_core.slicing import layers, position, rungs
from defocus_core.slopes import slopes
from defocus_core.tiling import BLOCK, TILE, Grid, blocks_at, grid_over, visible_slices

# Pixels of a sample at most, of one that shows what is hidden, and of the strips in which all are
# looked at.
_SAMPLE, _SAMPLE_BEHIND, _STRIP = 1 << 18, 1 << 20, 1 << 20
# Px of hidden content behind an edge that each pixel of a sample may stand for.
_WIDE = 16
# Px of overlap of strips: soft edges are as wide as that.
_OVERLAP = 12
# Pixels beyond which nothing of a frame stays in a cache, and each array is mapped anew.
_LARGE = 1 << 20
# Range of radii between neighbours on an edge, and how many pixels wide it is.
_EDGE, _EDGE_WIDTH = 1.5, 2
# Loads that are work on tiles, done by all threads.
TILE_LOADS = ("calls", "forward", "products", "inverse")
LOADS = ("frame", "pixels", "large", *TILE_LOADS, "kernels", "hidden", "edges", "lights")
# Bytes that frame, spectra of kernels, and each thread hold.
BYTES = ("pixels", "hidden", "lights", "spectra", "tile")


@dataclass(frozen=True)
class Plan:
    """Counts, as `Rendering.stats` has them, and what they amount to.

    Attributes:
        slices: Of the ladder.
        tiles: Of the frame.
        slice_tiles: What a renderer that skips nothing would do.
        slice_tiles_done: What is done.
        tiles_with_hidden: Tiles behind whose surface something is invented.
        loads: By the names in `LOADS`.
        bytes: By the names in `BYTES`; those of "tile" are of one thread.
    """

    slices: int
    tiles: int
    slice_tiles: int
    slice_tiles_done: int
    tiles_with_hidden: int
    loads: dict[str, float]
    bytes: dict[str, float]


def plan(
    signed_radius: Tensor,
    *,
    image: Tensor | None = None,
    channels: int = 3,
    aperture: Aperture | None = None,
    quality: str = "standard",
    left_right: bool = False,
) -> Plan:
    """Count what `render` would do.

    Args:
        signed_radius: [H, W] px, finite.
        image: [C, H, W], linear light; None if it is not known: then it has no lights.
        channels: C, if there is no image.
        aperture: The pupil, a round one by default.
        quality: As for `render`.
        left_right: As for `render`.

    Raises:
        ValueError: If the quality is unknown or the frame is not [H, W].
    """
    if signed_radius.dim() != 2 or not signed_radius.numel():
        raise ValueError(f"signed_radius must be [H, W], got {tuple(signed_radius.shape)}")
    settings = find(quality)
    channels = channels if image is None else image.shape[0]
    scene = _Scene(signed_radius, settings, aperture or Aperture(), left_right)
    work = _Work(scene)
    count, double = (0.0, False) if image is None else scene.lights(image)
    size = 8 if double else 4
    samples = (channels + 1) * size / 4
    pixels = scene.pixels * samples
    loads = {
        "frame": 1.0,
        "pixels": pixels,
        "large": pixels * min(scene.pixels / _LARGE, 1.0),
        "calls": work.calls,
        "forward": work.forward * samples,
        "products": work.products * samples * scene.parts,
        "inverse": work.inverse * samples * scene.parts,
        "kernels": work.kernels * scene.parts,
        "hidden": pixels * scene.hidden_share,
        "edges": float(scene.edges),
        "lights": count,
    }
    held = {
        "pixels": 4 * pixels,
        "hidden": 4 * pixels * bool(scene.hidden_share),
        "lights": 4 * pixels * scene.parts * bool(count) + 8 * min(count, 1 << 21),
        "spectra": work.spectra * scene.parts * 2 * size,
        "tile": work.widest * 4 * samples,
    }
    with_hidden = sum(1 for some in scene.hidden if some)
    return Plan(
        slices=len(scene.radii),
        tiles=len(scene.grid.tiles),
        slice_tiles=2 * len(scene.radii) * len(scene.grid.tiles),
        slice_tiles_done=sum(map(len, [*scene.visible, *scene.hidden])),
        tiles_with_hidden=with_hidden,
        loads=loads,
        bytes=held,
    )


class _Scene:
    """Slices, and the tiles that they reach, from a sample of the pixels."""

    def __init__(
        self, signed_radius: Tensor, quality: Quality, aperture: Aperture, left_right: bool
    ) -> None:
        H, W = signed_radius.shape
        self.pixels = H * W
        self.quality = quality
        self.grid: Grid = grid_over(H, W)
        self.parts = len(parts(aperture, quality.parts))
        if left_right and self.parts == 1:
            self.parts += 2  # halves
        self.step = _step(H * W)
        rows, self.edges = [], 0
        least, most = math.inf, -math.inf
        for strip, inner in _strips(signed_radius.detach()):
            for step in (strip[inner.start : inner.stop + 1].diff(dim=0), strip[inner].diff(dim=1)):
                self.edges += _EDGE_WIDTH * int((step.abs() > _EDGE).sum())
            whole = without_ramps(strip)[inner]
            least, most = min(least, float(whole.min())), max(most, float(whole.max()))
            rows.append(whole[:: self.step, :: self.step])
        self.radius = torch.cat(rows)
        self.radii = rungs(least, most, quality)
        self.reaches = [reach(r, max(H, W) - 1) for r in self.radii]
        self.layers = layers(self.radii, quality)
        everywhere = torch.ones_like(self.radius, dtype=torch.bool)
        self.visible = self._reached(self.radius, everywhere, 1, (H, W))
        # lengths and radii shrink alike: slopes stay as they are
        lean = slopes(self.radius / self.step, quality.least_slope)
        self.tilted: list[list[int]] = [[] for _ in self.grid.tiles]
        if lean is not None:
            self.tilted = self._reached(self.radius, lean.any(0), 1, (H, W))
        self.hidden, self.hidden_share = self._behind(signed_radius.detach(), most - least)

    def _reached(
        self, radius: Tensor, some: Tensor, stride: int, size: tuple[int, int]
    ) -> list[list[int]]:
        """For each tile the rungs that some of the sampled pixels reach it with."""
        return self._tiles(self._blocks(radius, some, self.step, stride, size), stride)

    def _blocks(
        self, radius: Tensor, some: Tensor, step: int, stride: int, size: tuple[int, int]
    ) -> Tensor:
        """Blocks [K, rows, columns] in which pixels, every `step`-th of a frame, have a rung."""
        radii = self.radii[::stride]
        places = position(radius[some], radii)
        return blocks_at(places, torch.nonzero(some) * step, len(radii), size)

    def _tiles(self, blocks: Tensor, stride: int) -> list[list[int]]:
        """For each tile the rungs that reach it, numbered as in the whole ladder."""
        found = visible_slices(blocks, self.reaches[::stride], self.grid.tiles)
        return [[k * stride for k in some] for some in found]

    def _behind(self, signed_radius: Tensor, span: float) -> tuple[list[list[int]], float]:
        """For each tile the rungs of what is invented there; and the share of pixels that have it.

        What is behind an edge is as wide as the radii differ: the greater, the coarser a sample
        shows it. Where it would still be too large, bands of tiles are looked at, and those between
        them are taken for alike.
        """
        (H, W), stride = signed_radius.shape, self.quality.hidden_stride
        step = 1
        while step < BLOCK and step <= span / _WIDE and _SAMPLE * step**2 < H * W:
            step *= 2
        bands = max(1, math.ceil(H * W / step**2 / _SAMPLE_BEHIND))
        height = -(-H // bands // TILE) * TILE
        around = -(-math.ceil(2 * span) // BLOCK) * BLOCK
        found: list[Tensor] = []
        shares = []
        for top in range(0, H, height):
            looked_at = min(height, H - top, TILE if bands > 1 else H)
            above = min(top, around)
            wide = signed_radius[top - above : top + looked_at + around : step, ::step]
            small = without_ramps(wide / step)
            inner = slice(above // step, -(-(above + looked_at) // step))
            behind = hidden_layer(small[None], small)
            far, some = small * step, torch.zeros_like(small, dtype=torch.bool)
            if behind:
                far, some = behind.signed_radius * step, behind.mask
            shares.append(float(some[inner].double().mean()))
            blocks = self._blocks(far[inner], some[inner], step, stride, (looked_at, W))
            rows = -(-min(height, H - top) // BLOCK)
            found += [blocks] * (rows // blocks.shape[1])
            found.append(blocks[:, : rows % blocks.shape[1]])
        return self._tiles(torch.cat(found, 1), stride), sum(shares) / len(shares)

    def lights(self, image: Tensor) -> tuple[float, bool]:
        """Samples of the discs of all lights, and whether float32 does for the rest."""
        sample = image.detach()[:, :: self.step, :: self.step]
        rest, lights = split(sample, self.radius)
        brightness = rest.amax(0)
        lit = brightness[brightness > 0]
        double = bool(lit.numel()) and bool(brightness.max() > 1e3 * lit.median())
        if lights is None:
            return 0.0, double
        limit = max(self.grid.tiles[-1].top + BLOCK, self.grid.tiles[-1].left + BLOCK)
        extent = lights.signed_radius.abs().sub(0.5).ceil().clamp(0, limit)
        nearer = torch.tensor(self.radii).to(extent) < lights.signed_radius[:, None] - 1.5
        present = torch.zeros(len(self.radii), dtype=torch.bool)
        present[sorted({k for some in self.visible for k in some})] = True
        looks = (nearer & present.to(nearer.device)).sum(1) + self.parts
        return float(((2 * extent + 1) ** 2 * looks).sum()) * self.step**2, double


class _Work:
    """What the slices of a scene amount to: samples of transforms, counts of calls."""

    def __init__(self, scene: _Scene) -> None:
        tile = scene.grid.tiles[0]
        widest: dict[int, int] = {}
        for number, extent in zip(scene.layers, scene.reaches, strict=True):
            widest[number] = max(widest.get(number, 0), extent)
        shapes = [
            (
                transform_length(tile.height + 2 * widest[number]),
                transform_length(tile.width + 2 * widest[number]),
                widest[number] == 0,
            )
            for number in scene.layers
        ]
        area = {shape: shape[0] * shape[1] for shape in set(shapes)}
        logs = {shape: area[shape] * math.log2(area[shape]) for shape in area}
        self.calls = self.forward = self.products = self.inverse = self.widest = 0.0
        for visible, tilted, hidden in zip(scene.visible, scene.tilted, scene.hidden, strict=True):
            leaning = set(tilted)
            for rungs_, together in ((visible, False), (hidden, True)):
                groups: dict[tuple[int, int, bool], list[int]] = {}
                for k in rungs_:
                    groups.setdefault(shapes[k], []).append(k)
                for shape, some in groups.items():
                    lean = 0 if together else len(leaning.intersection(some))
                    results = 1 if together else len({scene.layers[k] for k in some})
                    terms = len(some) + 2 * lean
                    self.calls += terms + results
                    if shape[2]:  # copied
                        continue
                    self.forward += terms * logs[shape]
                    self.products += terms * area[shape]
                    self.inverse += results * logs[shape]
                    self.widest = max(self.widest, (terms + results * scene.parts) * area[shape])
        tilts = any(scene.tilted)
        blurred = [shape for shape in shapes if not shape[2]]
        self.spectra = sum(area[shape] / 2 for shape in blurred) * (3 if tilts else 1)
        self.kernels = sum(logs[shape] for shape in blurred) * (3 if tilts else 1)


def _step(pixels: int) -> int:
    """Every how many pixels, on both axes, a frame is sampled: a power of two, a block at most."""
    step = 1
    while pixels > _SAMPLE * step * step and step < BLOCK:
        step *= 2
    return step


def _strips(signed_radius: Tensor) -> Iterator[tuple[Tensor, slice]]:
    """Some rows with a few around them, and which of them are the strip's own."""
    H, W = signed_radius.shape
    height = max(BLOCK, _STRIP // W // BLOCK * BLOCK)
    for top in range(0, H, height):
        above = min(top, _OVERLAP)
        strip = signed_radius[top - above : top + height + _OVERLAP]
        yield strip, slice(above, above + min(height, H - top))

"""What rendering a picture will take, counted without rendering it.

A plan follows the renderer's own rules, on every pixel of a small frame and on a sample of a large
one: which slices there are, which tiles they reach, through which windows, what lies hidden, which
pixels are lights. Its loads are proportional to time, its bytes to memory; how much of each there
is to a load differs from machine to machine and is for the caller to measure.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from defocus_core.aperture import Aperture
from defocus_core.copying import blurred_part
from defocus_core.frame import Frame
from defocus_core.mending import Mending
from defocus_core.obstruction import nearer_than
from defocus_core.picture import Picture
from defocus_core.presence import Cover, Presence
from defocus_core.quality import find
from defocus_core.source import Pixels, banded, bands
from defocus_core.tiling import Grid, regions
from defocus_core.workload import Workload

# What takes time: for the frame, for a region as a whole, for its tiles.
LOADS = (
    *("frame", "pixels", "images", "doubled", "backdrop", "kernels"),
    *("regions", "around", "slopes", "edges", "behind", "lights"),
    *("calls", "averaged", "forward", "products", "inverse", "composited", "finished"),
)
# Bytes of the coarse picture of the frame; of the spectra of kernels, and of those that are made at
# once; of each region, of its layers at reduced resolution, of the lights in it that are drawn at
# once, of what is made of it, and of each tile in work; of what is made of rows of cells of two px.
BYTES = ("backdrop", "spectra", "making", "region", "layers", "discs", "result", "tile", "cells")
# Steps of a region in which something is hidden that no other load counts.
_STEPS = 80.0
# Bytes of a sample of the lights of a region, summed in double precision or kept twice in single;
# of one of a kernel, kept for each part; and of one of the kernel that is sampled.
_LIT, _KERNEL, _SAMPLED_KERNEL = 8, 4, 32


@dataclass(frozen=True)
class Plan:
    """Counts, as `Views.stats` has them, and what they amount to.

    Attributes:
        slices: Of the ladder.
        tiles: Of the frame.
        regions: That its tiles are put into.
        slice_tiles: What a renderer that skips nothing would do.
        slice_tiles_done: What is done, as long as nothing is culled.
        tiles_with_hidden: Tiles behind whose surface something is invented.
        of_frame: Loads of the frame as a whole, by the names in `LOADS`.
        of_regions: Those of regions, likewise: each is work for one thread.
        of_tiles: Those of tiles, likewise.
        bytes: By the names in `BYTES`; those of one region and of one tile are the most of any.
        cells: Bytes of the cells of a large draft, which are held if there is room for them.
        mending: What would be mended of the depth.
    """

    slices: int
    tiles: int
    regions: int
    slice_tiles: int
    slice_tiles_done: int
    tiles_with_hidden: int
    of_frame: dict[str, float]
    of_regions: dict[str, float]
    of_tiles: dict[str, float]
    bytes: dict[str, float]
    cells: float
    mending: Mending

    @property
    def loads(self) -> dict[str, float]:
        """All together."""
        parts = (self.of_frame, self.of_regions, self.of_tiles)
        return {name: sum(part[name] for part in parts) for name in LOADS}


def plan(
    signed_radius: Pixels,
    *,
    image: Pixels | None = None,
    channels: int = 3,
    aperture: Aperture | None = None,
    quality: str = "standard",
    left_right: bool = False,
    tile: int | None = None,
    infinity: float | None = None,
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
        infinity: As for `render`.

    Raises:
        ValueError: If the quality is unknown or the frame is not [H, W].
    """
    if len(signed_radius.shape) != 2 or 0 in signed_radius.shape:
        raise ValueError(f"signed_radius must be [H, W], got {tuple(signed_radius.shape)}")
    if image is None:
        image = torch.zeros((1, 1, 1), device=signed_radius.device)
        image = image.expand(channels, *signed_radius.shape)
    given = signed_radius.shape[0] * signed_radius.shape[1] * (image.shape[0] + 1)
    picture = Picture(
        image,
        signed_radius,
        aperture=aperture or Aperture(),
        quality=find(quality),
        left_right=left_right,
        tile=tile,
        infinity=infinity,
    )
    frame, image, signed_radius = picture.frame, picture.image, picture.signed_radius
    every = [grid for row in regions(frame.grid, frame.margin) for grid in row]
    parts = [blurred_part(frame, grid, signed_radius) for grid in every]
    grids = [part for part in parts if part]
    tiles = [tile for grid in grids for tile in grid.tiles]
    scene, work = Presence(frame, signed_radius, tiles), Workload(frame, tiles)
    for grid in grids:
        work.add(grid, [scene.visible, *scene.hidden])
    (H, W), channels = frame.size, image.shape[0]
    pixels, size = H * W, frame.dtype.itemsize
    samples = (channels + 1) * size / 4
    outer = [_area(grid, frame.margin, frame) for grid in grids]
    inner = [_area(grid, frame.farthest, frame) for grid in grids]
    around = [sum(areas) for areas in zip(outer, inner, strict=True)]
    repeated = sum(around) / (2 * pixels)
    lights, lit, widest = _lights(frame, image, signed_radius, grids, scene.visible)
    of_kernels, kept, made = work.kernels()
    images = channels * size / 4 * (3 if left_right else 1)
    finished = sum(_area(grid, 0, frame) for grid in grids) * images
    doubled = given * size / 4 * (3 if left_right else 1) * picture.at_half_size
    of_frame = {
        "frame": 1.0,
        "pixels": pixels * samples,
        "images": pixels * images,
        "doubled": doubled,
        "backdrop": pixels * samples * frame.edges,
        "kernels": of_kernels,
    }
    of_regions = {
        "regions": float(len(grids)),
        "around": sum(around) * samples,
        "backdrop": sum(outer) * samples * frame.edges,
        "slopes": sum(inner) * frame.tilted,
        "edges": scene.edges * repeated,
        "behind": scene.behind * repeated,
        "lights": lights,
        **_times(work.of_regions, samples),
    }
    of_regions["calls"] += _STEPS * len(grids) * frame.edges
    held = {
        "backdrop": pixels * (2 + (channels + 8) * size / 12) if frame.edges else 0.0,
        "spectra": kept * size,
        "making": made * 24,
        "region": 4 * max(around, default=0.0) * samples,
        "layers": 4 * work.reduced * samples,
        "discs": _LIT * lit + (_KERNEL * len(frame.parts) + _SAMPLED_KERNEL) * widest,
        "result": max(_area(grid, 0, frame) for grid in every)
        * (channels * (3 if left_right else 1) + 1)
        * size,
        "tile": 4 * work.widest * samples,
        "cells": _bytes_of_cells(picture, every, channels * (3 if left_right else 1) + 1),
    }
    hidden = scene.hidden[0].plan if scene.hidden else []
    return Plan(
        slices=len(frame.radii),
        tiles=len(frame.grid.tiles),
        regions=len(every),
        slice_tiles=2 * len(frame.radii) * len(frame.grid.tiles),
        slice_tiles_done=work.done,
        tiles_with_hidden=sum(1 for some in hidden if some),
        of_frame=_all(of_frame),
        of_regions=_all(of_regions),
        of_tiles=_all({**_times(work.of_tiles, samples), "finished": finished}),
        bytes=held,
        cells=_bytes_of_held(picture),
        mending=picture.mending,
    )


def _times(loads: dict[str, float], samples: float) -> dict[str, float]:
    """Loads of one channel, of all."""
    return {name: load * (1 if name == "calls" else samples) for name, load in loads.items()}


def _all(loads: dict[str, float]) -> dict[str, float]:
    return {name: float(loads.get(name, 0.0)) for name in LOADS}


def _lights(
    frame: Frame, image: Pixels, radius: Pixels, grids: list[Grid], visible: Cover
) -> tuple[float, float, float]:
    """Samples of the rims of discs, and of what nearer slices stop of them, in all regions.

    Returns:
        These together with the samples of regions in which they are summed; these of one region, at
        most; and the samples of the widest disc.
    """
    found = []
    for (top, _), some, r in zip(bands(*frame.size), banded(image), banded(radius), strict=True):
        rows, columns = torch.nonzero(some.amax(0) > frame.limit).unbind(1)
        found.append((torch.stack([rows + top, columns], 1), r[rows, columns]))
    at, r = map(torch.cat, zip(*found, strict=True))
    if not len(at):
        return 0.0, 0.0, 0.0
    spread = (r.abs() - 0.5).ceil().clamp(0, max(frame.size))
    nearer = r.new_tensor(frame.radii) < nearer_than(r)[:, None]
    stopped = (nearer * r.new_tensor(visible.shares)).sum(1).clamp(max=1)
    terms = image.shape[0] * len(frame.parts)
    samples = 12 * (spread + 1) * terms + (2 * spread + 1) ** 2 * stopped * (terms + 1)
    discs = lit = widest = 0.0
    for grid in grids:
        first = at.new_tensor(grid.box[:2])
        last = first + at.new_tensor(grid.box[2:]) - 1
        here = torch.maximum(first - at, at - last).amax(1) <= spread
        if bool(here.any()):
            canvas = float(grid.box.area * terms)
            discs += float(samples[here].sum()) + canvas / 2
            lit = max(lit, canvas)
            widest = max(widest, float((2 * spread[here].max() + 1) ** 2))
    return discs, lit, widest


def _bytes_of_cells(picture: Picture, grids: list[Grid], channels: int) -> float:
    """Of the cells of a picture that are kept, and of the results of a row of regions."""
    if not picture.at_half_size:
        return 0.0
    height, width = picture.frame.size
    results = max(grid.box.height for grid in grids) * width * channels
    kept = picture.image.shape[0] * height * width if isinstance(picture.image, Tensor) else 0
    return float((results + 2 * kept) * picture.frame.dtype.itemsize)


def _bytes_of_held(picture: Picture) -> float:
    """Of the cells that are held if there is room, while they are put together."""
    if not picture.at_half_size or isinstance(picture.image, Tensor):
        return 0.0
    (height, width), channels = picture.frame.size, picture.image.shape[0]
    return float(height * width * (2 * channels + 1) * picture.frame.dtype.itemsize)


def _area(grid: Grid, margin: int, frame: Frame) -> float:
    """Pixels of a region with a margin."""
    box = grid.box.grown(margin, frame.box)
    return float(box.height * box.width)

"""The cost of a rendering: its work and a bound of its memory beforehand, and its launches.

Slices, tiles and regions follow from the rules of the renderer. One pass over the radii tells which
slices reach which tiles, and counts the pixels at depth edges, behind which content is invented.
The unit of work is about that of copying one pixel; the caller measures how many units a machine
does in a second. The bound of memory holds for every picture.

Launches are what a rendering asks of a device, counted on any. A GPU takes some µs to begin an
operation, and a host that reads a value waits until all before it is done. Views are free. On a CPU
the numbers are those of its own plan, of smaller pieces.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.matting import EDGE
from defocus_core.renderer.blur.layer_blur import CORNERS
from defocus_core.renderer.engine.frame import SharedFrame
from defocus_core.renderer.engine.preparation import copies_of_tile
from defocus_core.renderer.engine.regions import blurred_part
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.renderer.layers.sliced_surface import blocks_of, visible_slices
from defocus_core.tensors.box import BLOCK, Box, Grid, regions
from defocus_core.tensors.device_plan import launches_cost
from defocus_core.tensors.neighbourhoods import extreme_around
from defocus_core.tensors.source import Pixels
from defocus_core.tensors.threads import AHEAD

# Units of work, fitted to the times of 42 pictures of seven kinds, within a factor of two: of a
# picture; of a sample (one channel of a pixel) that is computed, or enlarged by a draft, or in a
# slice of a tile; of a sample at an edge, for each px of blur, and how many times as much that is
# where hidden content is not halved.
_PICTURE, _COMPUTED, _ENLARGED, _SLICED, _BEHIND, _AT_FULL_SIZE = 3e6, 15.0, 4.0, 4.0, 66.0, 5.0
# Bytes of the program's own structures, and of the tile of each thread.
_FIXED, _OF_THREAD = 10e6, 24e6
# Copies of a region in memory while it is computed: of its pixels, of its hidden surfaces, and of
# its left and right views.
_COPIES, _HIDDEN_COPIES, _VIEW_COPIES = 9, 3, 3
# Copies of a region of each layer, of all windows that are sorted and sliced.
_COPIES_OF_LAYER = 8
# Work of slices by a pupil that changes over the frame, as a multiple of that of one pupil.
_FIELD = 3.0
# Work of layers as a multiple of that of their picture in focus.
_LAYERED = 3.0
_STRIP = 1 << 20  # pixels of the radii to read at once
# Operations whose result decides the size of a tensor, or is a number of the host.
_WAITED = {
    *("_local_scalar_dense", "nonzero", "masked_select", "equal", "bincount", "is_nonzero"),
    *("_unique", "_unique2", "unique_dim", "unique_consecutive"),
}
_INDEXED = {"index", "index_put", "index_put_", "_index_put_impl_"}
# Operations that compute nothing, though they are no views.
_FREE = {
    *("empty", "empty_like", "empty_strided", "new_empty", "new_empty_strided"),
    *("_unsafe_view", "lift_fresh", "_local_scalar_dense", "resolve_conj", "resolve_neg"),
}


def cost(renderer: Renderer) -> float:
    """Units of work of rendering a picture; its radii are read once."""
    frame, radius = renderer.frame, renderer.scene.signed_radius
    grids = _computed(renderer)
    tiles = [tile for grid in grids for tile in grid.tiles]
    blocks, edges = _visible_blocks(frame, radius)
    plan = visible_slices(blocks, frame.slices.visible.reaches, tiles) if tiles else []
    samples = renderer.scene.image.shape[0] + 1
    around = sum(_around(frame, grid).area for grid in grids)
    full_size = 1.0 if frame.quality.hidden_level else _AT_FULL_SIZE
    pixels = renderer.size[0] * renderer.size[1]
    sliced = _SLICED if frame.settings.field is None else _SLICED * _FIELD
    work = (
        pixels * frame.views
        + _COMPUTED * (1.4 if frame.settings.left_right else 1.0) * around
        + _ENLARGED * pixels * renderer.at_half_size
        + sliced * (1 + len(frame.division.parts) / 4) * _samples_sliced(frame, tiles, plan)
        + _BEHIND * full_size * edges * max(map(abs, frame.content.limits))
    )
    if renderer.scene.layered is not None and renderer.scene.layered.deepest > 1:
        work *= _LAYERED
    return _PICTURE + samples * work


def memory_bound(renderer: Renderer, threads: int, at_once: int) -> float:
    """Upper bound of the bytes that rendering takes beside its input and output."""
    frame, channels = renderer.frame, renderer.scene.image.shape[0]
    size = frame.dtype.itemsize
    sample = (channels + 1) * size
    pixels = frame.box.area
    grids = _computed(renderer)
    if launches_cost(renderer.scene.image.device):
        threads = at_once = 1
    at_once = max(1, min(at_once, len(grids)))
    copies = (
        _COPIES + _HIDDEN_COPIES * frame.content.edges + _VIEW_COPIES * frame.settings.left_right
    )
    if renderer.scene.layered is not None:
        copies += _COPIES_OF_LAYER * renderer.scene.layered.number
    region = max((_around(frame, grid).area for grid in grids), default=0) * sample * copies
    result = max((grid.box.area for grid in grids), default=0)
    result *= (channels * frame.views + 1) * size * (1 + AHEAD * (threads > 1))
    coarse = pixels * sample * frame.content.edges * 0.7
    in_memory = isinstance(renderer.scene.image, Tensor)
    enlarged = 3 * renderer.at_half_size * pixels * sample * in_memory
    # each region has kernels of its own where the pupil changes over the frame
    versions = 1 if frame.settings.field is None else CORNERS * at_once
    spectra = 2 * _bytes_of_spectra(frame) * versions
    repaired = renderer.size[0] * renderer.size[1] * size * (renderer.repair != DepthRepair())
    whole = _FIXED + coarse + enlarged + spectra + repaired + _bytes_of_fill(renderer, grids)
    return whole + threads * _bytes_of_tile(renderer) + at_once * (region + result)


def _bytes_of_tile(renderer: Renderer) -> float:
    """Bytes of a tile that is computed."""
    frame = renderer.frame
    if not launches_cost(renderer.scene.image.device):
        return _OF_THREAD
    sample = (renderer.scene.image.shape[0] + 1) * frame.dtype.itemsize * len(frame.division.parts)
    area = max(tile.area for tile in frame.grid.tiles)
    return float(area * sample * copies_of_tile(frame.slices.visible.layers))


def _bytes_of_fill(renderer: Renderer, grids: list[Grid]) -> float:
    """Bytes of what is continued for all colours, which is kept until each has taken it."""
    frame, fill = renderer.frame, renderer.scene.surfaces
    if fill is None or not fill.shared.keeps:
        return 0.0
    reach = frame.farthest + frame.farthest % 2
    area = sum(grid.box.grown(reach, frame.box).area for grid in grids)
    sample = (fill.shared.colors + 2) * frame.dtype.itemsize
    return float(area * sample / (1 << 2 * frame.slices.invented.level))


def coarse_bytes(shape: tuple[int, ...]) -> float:
    """Bytes of the coarse pixels of a draft of a picture [C, H, W], if they are kept."""
    channels, height, width = shape
    return 3.0 * (channels + 2) * (height // 2 + 1) * (width // 2 + 1) * 4


def _computed(renderer: Renderer) -> list[Grid]:
    """The regions that are computed, cut to their blurred parts; the others are copied."""
    frame, radius = renderer.frame, renderer.reaching
    every = [grid for row in regions(frame.grid, frame.margin) for grid in row]
    parts = (blurred_part(frame, grid, radius) for grid in every)
    return [part for part in parts if part]


def _around(frame: SharedFrame, grid: Grid) -> Box:
    """A region with the pixels around it that it depends on."""
    return grid.box.grown(frame.margin, frame.box)


def _visible_blocks(frame: SharedFrame, radius: Pixels) -> tuple[Tensor, int]:
    """Blocks [K, rows, columns] in which slices have pixels, and the number of pixels at edges."""
    (height, width), blocks, edges = frame.size, [], 0
    rows = max(1, _STRIP // width // BLOCK) * BLOCK
    for first in range(0, height, rows):
        band = radius[first : first + rows].detach()
        blocks.append(
            blocks_of(
                slice_position(band.to(frame.dtype), frame.slices.radii), len(frame.slices.radii)
            )
        )
        if frame.content.edges:
            minimum, maximum = (
                extreme_around(band, 1, end) for end in (torch.minimum, torch.maximum)
            )
            edges += int((maximum - minimum > EDGE).sum())
    return torch.cat(blocks, 1), edges


def _samples_sliced(frame: SharedFrame, tiles: list[Box], plan: list[list[int]]) -> float:
    """Pixels of tiles with margins, at the resolution of each slice that reaches them."""
    total = 0.0
    for tile, slice_indices in zip(tiles, plan, strict=True):
        for slice_index in slice_indices:
            window = frame.slices.visible.windows[slice_index]
            if window.margin:
                step, margin = 1 << window.level, 2 * window.margin
                total += (tile.height / step + margin) * (tile.width / step + margin)
    return total


def _bytes_of_spectra(frame: SharedFrame) -> float:
    """Bytes of the spectra of the kernels of all slices, visible and hidden."""
    slices, invented = frame.slices, frame.slices.invented
    hidden = invented.windows[:: invented.stride] if frame.content.edges else []
    sizes = (window.size for window in [*slices.visible.windows, *hidden] if window.margin)
    return float(
        sum(
            2 * h * (w // 2 + 1) * len(frame.division.parts) * frame.dtype.itemsize
            for h, w in sizes
        )
    )


class Launches(TorchDispatchMode):
    """Counts what the thread that enters it asks of a device.

    Attributes:
        launches: Number of operations that compute or copy.
        waits: How often the host waits for a value or for the size of a result.
        written: Bytes of the results.
    """

    def __init__(self, device: torch.device | str) -> None:
        """Count from 0."""
        super().__init__()  # type: ignore[no-untyped-call]
        self._kind = torch.device(device).type
        self.launches = self.waits = self.written = 0

    def __torch_dispatch__(
        self,
        func: Any,
        types: Any,
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> object:
        """Run an operation, and count it if it is one of the device."""
        kwargs = kwargs or {}
        result = func(*args, **kwargs)
        name = func.overloadpacket.__name__
        inputs, outputs = self._tensors((args, kwargs)), self._tensors(result)
        if inputs and (self._is_waited(name, args) or self._is_copied_away(name, result, args)):
            self.waits += 1
        elif not inputs and outputs and name == "_to_copy" and not kwargs.get("non_blocking"):
            self.waits += 1  # a copy from the host
        if (inputs or outputs) and not func.is_view and name not in _FREE:
            self.launches += 1
            self.written += sum(x.numel() * x.element_size() for x in outputs)
        return result

    def _tensors(self, values: object) -> list[Tensor]:
        """The tensors of the device among some values."""
        tensors = (x for x in tree_leaves(values) if isinstance(x, Tensor))
        return [x for x in tensors if x.device.type == self._kind]

    @staticmethod
    def _is_waited(name: str, args: tuple[Any, ...]) -> bool:
        by_mask = name in _INDEXED and any(
            x.dtype == torch.bool for x in tree_leaves(args[1]) if isinstance(x, Tensor)
        )
        return by_mask or name in _WAITED

    def _is_copied_away(self, name: str, result: object, args: tuple[Any, ...]) -> bool:
        into = args[0] if name == "copy_" else result
        if name not in ("copy_", "_to_copy") or not isinstance(into, Tensor):
            return False
        return into.device.type != self._kind

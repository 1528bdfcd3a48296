"""The cost of a rendering: its work beforehand, and its launches.

Slices, tiles and regions follow from the rules of the renderer. One pass over the radii tells which
slices reach which tiles, and counts the pixels at depth edges, behind which content is invented.
The unit of work is about that of copying one pixel; the caller measures how many units a machine
does in a second.

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

from defocus_core.depth.matting import EDGE
from defocus_core.renderer.engine.frame import SharedFrame
from defocus_core.renderer.engine.memory_bound import around, computed_regions
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.layers.slice_radii import slice_position
from defocus_core.renderer.layers.sliced_surface import blocks_of, visible_slices
from defocus_core.tensors.box import BLOCK, Box
from defocus_core.tensors.neighbourhoods import extreme_around
from defocus_core.tensors.source import Pixels

# Units of work, fitted to the times of 42 pictures of seven kinds, within a factor of two: of a
# picture; of a sample (one channel of a pixel) that is computed, or in a slice of a tile; of a
# sample at an edge, for each px of blur, and how many times as much that is where hidden content
# is not halved.
_PICTURE, _COMPUTED, _SLICED, _BEHIND, _AT_FULL_SIZE = 3e6, 15.0, 4.0, 66.0, 5.0
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
    grids = computed_regions(renderer)
    tiles = [tile for grid in grids for tile in grid.tiles]
    blocks, edges = _visible_blocks(frame, radius)
    plan = visible_slices(blocks, frame.slices.visible.reaches, tiles) if tiles else []
    samples = renderer.scene.image.shape[0] + 1
    read = sum(around(frame, grid).area for grid in grids)
    full_size = 1.0 if frame.quality.hidden_level else _AT_FULL_SIZE
    pixels = renderer.size[0] * renderer.size[1]
    sliced = _SLICED if frame.settings.field is None else _SLICED * _FIELD
    work = (
        pixels * frame.views
        + _COMPUTED * (1.4 if frame.settings.left_right else 1.0) * read
        + sliced * (1 + len(frame.division.parts) / 4) * _samples_sliced(frame, tiles, plan)
        + _BEHIND * full_size * edges * max(map(abs, frame.content.limits))
    )
    if renderer.scene.layered is not None and renderer.scene.layered.deepest > 1:
        work *= _LAYERED
    return _PICTURE + samples * work


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

"""How much is computed at once on a device: bytes, tiles, bands of rows.

On a CPU, pieces have fixed sizes that fit into its cache, so that the result does not depend on the
machine. Other devices need some µs to start an operation, however small, so pieces are as large as
a share of the memory of the device allows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

from defocus_core.tensors.box import Box, Span
from defocus_core.tensors.later import Tensor, torch
from defocus_core.tensors.threads import threaded

# Memory in bytes that is assumed of a device that torch cannot ask.
_UNKNOWN = 8 << 30
# Shares of the memory of a device for a tile with all its layers, and for pieces of lists, several
# of which are held at once.
_TILE, _PIECE = 1 / 2, 1 / 8
# Bytes of a piece on a CPU.
_CACHED = 1 << 25


def launches_cost(device: torch.device) -> bool:
    """Whether a device is slow to start operations and to wait for: all but the CPU."""
    return device.type != "cpu"


def sent(values: Tensor | Sequence[Any] | float, like: Tensor) -> Tensor:
    """`values` as a tensor of the dtype and device of `like`, copied without synchronisation.

    An ordinary copy would wait until the device has finished all earlier work.
    """
    if not isinstance(values, Tensor):
        values = torch.tensor(values, dtype=like.dtype, device="cpu")
    # Metal may read the memory of the host after it was freed
    return values.to(like.device, like.dtype, non_blocking=like.device.type != "mps")


def pieces(device: torch.device, bytes_each: int, on_cpu: int | None = None) -> int:
    """The number of pixels, or other items of `bytes_each` bytes, to compute at once on a device.

    `on_cpu`: the number on a CPU; None for as many as fit into its cache.
    """
    on_cpu = _CACHED // bytes_each if on_cpu is None else on_cpu
    if not launches_cost(device):
        return on_cpu
    return max(on_cpu, int(memory_of(device) * _PIECE) // bytes_each)


def tile_pixels(device: torch.device, bytes_each: int) -> int:
    """The greatest number of pixels in a tile on a device other than the CPU.

    `bytes_each`: memory in bytes that a pixel needs with all its layers.
    """
    return int(memory_of(device) * _TILE) // bytes_each


@lru_cache
def memory_of(device: torch.device) -> int:
    """The total memory in bytes of a device other than the CPU; 8 GiB if torch cannot tell."""
    module = getattr(torch, device.type, None)
    if module is not None and hasattr(module, "get_device_properties") and module.is_available():
        return int(module.get_device_properties(device).total_memory)
    if device.type == "mps" and torch.backends.mps.is_available():
        return torch.mps.recommended_max_memory()
    return _UNKNOWN


# Greatest number of pixels and of rows in a band on a CPU; bytes of a pixel on other devices.
_PIXELS, _ROWS, _BYTES = 1 << 19, 256, 100


def bands_of(
    size: tuple[int, int], device: torch.device, minimum: int = 1
) -> list[tuple[int, int]]:
    """The first row and the end of each band of a frame of `size` (height, width).

    Bands have at least `minimum` rows, except for the last.
    """
    height, width = size
    rows = pieces(device, _BYTES, _PIXELS) // width
    rows = max(minimum, rows if launches_cost(device) else min(_ROWS, rows))
    return list(pairwise([*range(0, height, rows), height]))


def bands(picture: Tensor) -> list[tuple[int, int]]:
    """The first row and the end of each band of a picture [..., H, W]."""
    return bands_of((picture.shape[-2], picture.shape[-1]), picture.device)


# Least height of a band, as a multiple of the margin.
_BAND_OF_MARGIN = 6


def in_bands(
    function: Callable[[Box], Tensor],
    size: tuple[int, int],
    device: torch.device,
    *,
    margin: int = 0,
    threads: int = 1,
) -> Tensor:
    """A picture [..., H, W] of `size` (height, width), computed by `function` in bands of rows.

    `function`: gives the pixels of a box; `margin`: px around a box that these depend on.
    """
    rows = bands_of(size, device, _BAND_OF_MARGIN * margin)
    boxes = [Box.from_spans(Span(*band), Span(0, size[1])) for band in rows]
    return torch.cat(list(threaded(function, boxes, threads)), -2)


def repaired(
    signed_radius: Tensor,
    repair: Callable[..., Tensor],
    around: int,
    *others: Tensor,
    threads: int = 1,
) -> Tensor:
    """The result of `repair` for radii [H, W] px, computed band by band.

    `repair`: called with the radii and the pictures `others` in a window; each pixel of its result
    depends on pixels up to `around` px away.
    """
    height, width = signed_radius.shape[-2:]

    def of_box(box: Box) -> Tensor:
        window = box.grown(around, Box(0, 0, height, width))
        pictures = map(window.crop, (signed_radius, *others))
        return box.seen_from(window).crop(repair(*pictures))

    return in_bands(of_box, (height, width), signed_radius.device, margin=around, threads=threads)

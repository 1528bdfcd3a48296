"""One picture through the pipeline: slice, blur, composite, tile by tile.

Visible slices are blurred one by one and composited front to back, per part of the aperture.
Hidden slices fill only what is left, so they are summed while still transformed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.aperture import Aperture, parts
from defocus_core.compositing import add_behind, nothing, picture
from defocus_core.convolution import crop_inverse, kernel_spectra, reach, transform_length
from defocus_core.hidden import hidden_layer
from defocus_core.quality import Quality
from defocus_core.slicing import Slices, cut, evenly, membership, rungs
from defocus_core.tiling import TILE, Tile, tiles, visible_slices

# Slices that are blurred at once: what they take stays in the cache.
_BATCH = 4


def render_frame(
    pixels: Tensor,
    signed_radius: Tensor,
    *,
    aperture: Aperture,
    quality: Quality,
    num_layers: int | None = None,
    psf_ks: int | None = None,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Tensor, dict[str, int]]:
    """The left and the right image [2, C, H, W] of one picture, and counts of the work done.

    Args:
        pixels: [C, H, W], float32 or float64.
        signed_radius: [H, W] px, of the same dtype.
        aperture: The pupil.
        quality: Spacing of slices, parts of the aperture.
        num_layers: As for `render`.
        psf_ks: As for `render`.
        threads: As for `render`.
        progress: As for `render`.
    """
    frame = _Frame(pixels, signed_radius, aperture, quality, num_layers, psf_ks)
    done: list[Tensor] = []
    grad = torch.is_grad_enabled()

    def work(index: int) -> Tensor:
        with torch.set_grad_enabled(grad):
            return frame.tile(index)

    count = len(frame.grid)
    with ThreadPoolExecutor(threads) as pool:
        for result in pool.map(work, range(count)) if threads > 1 else map(work, range(count)):
            done.append(result)
            if progress:
                progress(len(done), count)
    rows = [
        torch.cat([done[i] for i in row], -1)
        for _, row in groupby(range(count), key=lambda i: frame.grid[i].top)
    ]
    return torch.cat(rows, -2), frame.counts()


class _Surface(NamedTuple):
    """A sliced layer with margins, and where it matters.

    Attributes:
        pixels: [C + 1, H + margins, W + margins], premultiplied, the last channel coverage.
        slices: Of the pixels, margins included.
        plan: For each tile the indices of the slices that reach it, nearest first.
    """

    pixels: Tensor
    slices: Slices
    plan: list[list[int]]


@dataclass(frozen=True)
class _Window:
    """The transform that slices of similar reach share.

    Attributes:
        margin: Px around a tile.
        size: (height, width) of the transform.
        slices: Indices of the slices that use it, ascending.
        spectra: [K, M, height, width // 2 + 1] of their kernels.
    """

    margin: int
    size: tuple[int, int]
    slices: list[int]
    spectra: Tensor


class _Frame:
    """Everything that the tiles of one picture share."""

    def __init__(
        self,
        pixels: Tensor,
        signed_radius: Tensor,
        aperture: Aperture,
        quality: Quality,
        num_layers: int | None,
        psf_ks: int | None,
    ) -> None:
        _, H, W = pixels.shape
        self.parts = parts(aperture, quality.parts)
        self.radii = _slice_radii(signed_radius.detach(), quality, num_layers, psf_ks)
        self.reaches = [reach(r, max(H, W) - 1) for r in self.radii]
        self.grid = tiles(H, W)
        self.side = (min(TILE, H), min(TILE, W))
        self.windows = self._windows(aperture, pixels)
        self.margin = max(w.margin for w in self.windows.values())
        hidden = hidden_layer(pixels, signed_radius)
        opaque = torch.ones_like(signed_radius, dtype=torch.bool)
        self.visible = self._surface(pixels, signed_radius, opaque)
        self.hidden = self._surface(hidden.color, hidden.signed_radius, hidden.mask)

    def _windows(self, aperture: Aperture, like: Tensor) -> dict[int, _Window]:
        """The window of each slice that is blurred at all; slices in one window share it."""
        sizes: dict[tuple[int, int], list[int]] = {}
        for k, spread in enumerate(self.reaches):
            size = tuple(transform_length(n + 2 * spread) for n in self.side)
            sizes.setdefault((size[0], size[1]), []).append(k)
        windows = {}
        for size, slices in sizes.items():
            extent = max(self.reaches[k] for k in slices)
            radii = torch.tensor([self.radii[k] for k in slices], dtype=torch.float64)
            spectra = kernel_spectra(radii, extent, size, aperture, self.parts)
            precision = torch.complex128 if like.dtype == torch.float64 else torch.complex64
            window = _Window(extent, size, slices, spectra.to(like.device, precision))
            windows.update(dict.fromkeys(slices, window))
        return windows

    def _surface(self, color: Tensor, radius: Tensor, mask: Tensor) -> _Surface:
        slices = cut(radius, self.radii)
        plan = visible_slices(slices, mask, self.reaches, self.grid)
        pixels = torch.cat([color, torch.ones_like(color[:1])]) * mask
        H, W = radius.shape
        longest = [max(w.size[i] for w in self.windows.values()) for i in (0, 1)]
        below = longest[0] + TILE * ((H - 1) // TILE) - H
        beside = longest[1] + TILE * ((W - 1) // TILE) - W
        margins = (self.margin, max(beside, 0), self.margin, max(below, 0))
        padded = Slices(self.radii, pad(slices.lower, margins), pad(slices.upper_share, margins))
        return _Surface(pad(pixels, margins), padded, plan)

    def tile(self, index: int) -> Tensor:
        """The left and the right image [2, C, h, w] of one tile."""
        box = self.grid[index]
        channels = self.visible.pixels.shape[0] - 1
        seen = nothing(len(self.parts), channels, (box.height, box.width), self.visible.pixels)
        for layers in self._blurred(self.visible, index):
            seen = add_behind(seen, layers)
        if behind := self._behind(index):
            seen = add_behind(seen, torch.stack(behind).sum(0, keepdim=True))
        return picture(seen)

    def _blurred(self, surface: _Surface, index: int) -> Iterator[Tensor]:
        """Slices [k, M, C + 1, h, w] of a surface over a tile, nearest first."""
        box = self.grid[index]
        for window, slices in self._batches(surface.plan[index]):
            layers = self._members(surface, box, window, slices)
            if window.margin == 0:
                inside = layers[..., : box.height, : box.width]
                yield inside[:, None].expand(-1, len(self.parts), -1, -1, -1)
            else:
                spectrum = torch.fft.rfft2(layers)[:, None] * self._kernels(window, slices)
                yield self._crop(spectrum, window, box)

    def _behind(self, index: int) -> list[Tensor]:
        """The hidden slices over a tile, summed by window: [M, C + 1, h, w] each."""
        box = self.grid[index]
        sums = []
        for key, group in groupby(self.hidden.plan[index], key=lambda k: id(self.windows[k])):
            del key
            slices = list(group)
            window = self.windows[slices[0]]
            layers = self._members(self.hidden, box, window, slices)
            if window.margin == 0:
                layer = layers.sum(0)[..., : box.height, : box.width]
                sums.append(layer.expand(len(self.parts), -1, -1, -1))
                continue
            kernels = self._kernels(window, slices)
            spectrum = (torch.fft.rfft2(layers)[:, None] * kernels).sum(0)
            sums.append(self._crop(spectrum, window, box))
        return sums

    def _batches(self, plan: list[int]) -> Iterator[tuple[_Window, list[int]]]:
        for _, group in groupby(plan, key=lambda k: id(self.windows[k])):
            slices = list(group)
            for start in range(0, len(slices), _BATCH):
                yield self.windows[slices[0]], slices[start : start + _BATCH]

    def _members(self, surface: _Surface, box: Tile, window: _Window, slices: list[int]) -> Tensor:
        """The pixels of slices within a window, [k, C + 1, height, width]."""
        top, left = (box.top + self.margin - window.margin, box.left + self.margin - window.margin)
        rows, columns = slice(top, top + window.size[0]), slice(left, left + window.size[1])
        index = torch.tensor(slices, device=surface.pixels.device)
        lower, share = surface.slices.lower[rows, columns], surface.slices.upper_share[rows, columns]
        return surface.pixels[:, rows, columns] * membership(lower, share, index)[:, None]

    def _kernels(self, window: _Window, slices: list[int]) -> Tensor:
        """Spectra [k, M, 1, height, width // 2 + 1]."""
        first = window.slices.index(slices[0])
        if window.slices[first : first + len(slices)] == slices:
            return window.spectra[first : first + len(slices), :, None]
        index = [window.slices.index(k) for k in slices]
        return window.spectra[index][:, :, None]

    def _crop(self, spectrum: Tensor, window: _Window, box: Tile) -> Tensor:
        wanted = (window.margin, window.margin, box.height, box.width)
        return crop_inverse(spectrum, window.size, wanted)

    def counts(self) -> dict[str, int]:
        """What was computed, out of what a renderer that skips nothing would."""
        plans = [*self.visible.plan, *self.hidden.plan]
        blurred = sum(1 for plan in plans for k in plan if self.reaches[k])
        return {
            "slices": len(self.radii),
            "tiles": len(self.grid),
            "slice_tiles": 2 * len(self.radii) * len(self.grid),
            "slice_tiles_done": sum(map(len, plans)),
            "slice_tiles_blurred": blurred,
            "tiles_with_hidden": sum(1 for plan in self.hidden.plan if plan),
        }


def _slice_radii(
    signed_radius: Tensor, quality: Quality, num_layers: int | None, psf_ks: int | None
) -> tuple[float, ...]:
    least, most = float(signed_radius.min()), float(signed_radius.max())
    if num_layers is not None:
        radii = evenly(least, most, num_layers)
    else:
        radii = rungs(least, most, quality)
    if psf_ks is None:
        return radii
    spread = max(abs(least), abs(most))
    needed = 2 * reach(spread, 1 << 30) + 1
    if needed > psf_ks:
        raise ValueError(
            f"psf_ks must be at least {needed} for the CoC radius of {spread:.2f} px, got {psf_ks}; "
            "leave it out to size kernels by the scene"
        )
    end = (psf_ks - 1) // 2 + 0.5
    return tuple(min(max(r, -end), end) for r in radii)

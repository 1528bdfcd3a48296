"""One picture through the pipeline: slice, blur, composite, tile by tile.

Visible slices are blurred one by one and composited front to back, per part of the aperture.
Hidden slices fill only what is left, so they are summed while still transformed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.aperture import LEFT, RIGHT, Aperture, parts
from defocus_core.compositing import add_behind, pair_of, picture
from defocus_core.convolution import crop_inverse, kernel_spectra, reach, transform_length
from defocus_core.hidden import hidden_layer
from defocus_core.highlights import draw, split
from defocus_core.quality import Quality
from defocus_core.slicing import evenly, layers, membership, position, rungs
from defocus_core.threads import threaded
from defocus_core.tiling import TILE, Tile, tiles, visible_slices


def render_frame(
    pixels: Tensor,
    signed_radius: Tensor,
    *,
    aperture: Aperture,
    quality: Quality,
    left_right: bool = False,
    num_layers: int | None = None,
    psf_ks: int | None = None,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Tensor, dict[str, int]]:
    """The centre image, or centre, left and right [1 or 3, C, H, W], and counts of the work done.

    Args:
        pixels: [C, H, W], float32 or float64.
        signed_radius: [H, W] px, of the same dtype.
        aperture: The pupil.
        quality: Spacing of slices, parts of the aperture.
        left_right: Whether left and right are wanted.
        num_layers: As for `render`.
        psf_ks: As for `render`.
        threads: As for `render`.
        progress: As for `render`.
    """
    frame = _Frame(
        pixels, signed_radius, aperture, quality, left_right, num_layers, psf_ks, threads
    )
    count = len(frame.grid)
    done: list[Tensor] = []
    for result in threaded(frame.tile, range(count), threads):
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
        places: [H + margins, W + margins], positions of the pixels on the ladder.
        stride: The ladder is every slice (1) or every other (2).
        plan: For each tile the indices of the slices that reach it, nearest first.
    """

    pixels: Tensor
    places: Tensor
    stride: int
    plan: list[list[int]]


@dataclass(frozen=True)
class _Window:
    """The transform that slices of similar reach share.

    Attributes:
        margin: Px around a tile.
        size: (height, width) of the transform.
        spectra: Of the kernels, by the index of the slice: [M, 1, height, width // 2 + 1].
    """

    margin: int
    size: tuple[int, int]
    spectra: dict[int, Tensor]


class _Frame:
    """Everything that the tiles of one picture share."""

    def __init__(
        self,
        pixels: Tensor,
        signed_radius: Tensor,
        aperture: Aperture,
        quality: Quality,
        left_right: bool,
        num_layers: int | None,
        psf_ks: int | None,
        threads: int,
    ) -> None:
        _, H, W = pixels.shape
        self.parts = parts(aperture, quality.parts)
        self.centre = len(self.parts)
        self.left_right = left_right
        self.signed = bool((pixels < 0).any())
        if left_right and self.centre == 1:
            self.parts = [*self.parts, LEFT, RIGHT]
        self.radii = _slice_radii(signed_radius.detach(), quality, num_layers, psf_ks)
        self.reaches = [reach(r, max(H, W) - 1) for r in self.radii]
        self.grid = tiles(H, W)
        self.side = (min(TILE, H), min(TILE, W))
        self.layers = layers(self.radii, quality)
        self.windows = self._windows(aperture, pixels)
        spans = list(dict.fromkeys(map(id, self.windows.values())))
        self.spans = [spans.index(id(self.windows[k])) for k in range(len(self.radii))]
        self.margin = max(w.margin for w in self.windows.values())
        pixels, highlights = split(pixels, signed_radius)
        hidden = hidden_layer(pixels, signed_radius, threads)
        stride = 1 if num_layers else quality.hidden_stride
        self.visible = self._surface(pixels, signed_radius, None, 1)
        self.hidden = self._surface(hidden.color, hidden.signed_radius, hidden.mask, stride)
        self.highlights = None
        if highlights:
            places = position(signed_radius, self.radii)
            self.highlights = draw(highlights, places, self.radii, aperture, self.parts)

    def _windows(self, aperture: Aperture, like: Tensor) -> dict[int, _Window]:
        """The window of each slice that is blurred at all; slices in one window share it."""
        sharing: dict[tuple[int, int, bool], list[int]] = {}
        for k in range(len(self.radii)):
            widest = max(self.reaches[j] for j, g in enumerate(self.layers) if g == self.layers[k])
            rows, columns = (transform_length(n + 2 * widest) for n in self.side)
            sharing.setdefault((rows, columns, widest == 0), []).append(k)
        windows = {}
        for (rows, columns, _), slices in sharing.items():
            extent = max(self.reaches[k] for k in slices)
            radii = torch.tensor([self.radii[k] for k in slices], dtype=torch.float64)
            precision = torch.complex128 if like.dtype == torch.float64 else torch.complex64
            spectra = kernel_spectra(radii, extent, (rows, columns), aperture, self.parts)
            spectra = spectra.to(like.device, precision)[:, :, None]
            window = _Window(extent, (rows, columns), dict(zip(slices, spectra, strict=True)))
            windows.update(dict.fromkeys(slices, window))
        return windows

    def _surface(self, color: Tensor, radius: Tensor, mask: Tensor | None, stride: int) -> _Surface:
        places = position(radius, self.radii[::stride])
        plan = visible_slices(places, mask, self.reaches[::stride], self.grid)
        plan = [[k * stride for k in slices] for slices in plan]
        pixels = torch.cat([color, torch.ones_like(color[:1])])
        pixels = pixels if mask is None else pixels * mask
        H, W = radius.shape
        longest = [max(w.size[i] for w in self.windows.values()) for i in (0, 1)]
        below = longest[0] + TILE * ((H - 1) // TILE) - H
        beside = longest[1] + TILE * ((W - 1) // TILE) - W
        margins = (self.margin, max(beside, 0), self.margin, max(below, 0))
        return _Surface(pad(pixels, margins), pad(places, margins), stride, plan)

    def tile(self, index: int) -> Tensor:
        """The centre, or the centre, left and right image [1 or 3, C, h, w] of one tile."""
        box = self.grid[index]
        shape = (len(self.parts), len(self.visible.pixels), box.height, box.width)
        seen = self.visible.pixels.new_zeros(shape)
        layers = self._blurred(self.visible, index, self.layers)
        for number in sorted(layers):
            seen = add_behind(seen, layers[number])
        if behind := self._blurred(self.hidden, index, self.spans):
            seen = add_behind(seen, torch.stack(list(behind.values())).sum(0))
        if self.highlights is not None:
            rows = slice(box.top, box.top + box.height)
            columns = slice(box.left, box.left + box.width)
            color = seen[:, :-1] + self.highlights[:, :, rows, columns]
            seen = torch.cat([color, seen[:, -1:]], 1)
        centre = picture(seen[: self.centre])
        if not self.left_right:
            return centre[None]
        left, right = map(picture, seen[-max(self.centre, 2) :].tensor_split(2))
        pair = pair_of(centre, left, right, signed=self.signed)
        return torch.cat([centre[None], pair])

    def _blurred(self, surface: _Surface, index: int, layer_of: list[int]) -> dict[int, Tensor]:
        """The layers of a surface over a tile, by number: sums of blurred slices.

        Args:
            surface: Visible or hidden.
            index: Of the tile.
            layer_of: For each slice the number of its layer. The slices of a layer share a window.

        Returns:
            [M, C + 1, h, w] each.
        """
        box = self.grid[index]
        by_window: dict[int, list[int]] = {}
        for k in surface.plan[index]:
            by_window.setdefault(id(self.windows[k]), []).append(k)
        layers: dict[int, Tensor] = {}
        for slices in by_window.values():
            window = self.windows[slices[0]]
            pixels = self._members(surface, box, window, slices)
            numbers = [layer_of[k] for k in slices]
            if window.margin == 0:
                inside = pixels[..., : box.height, : box.width]
                for number, layer in _sums(numbers, inside):
                    layers[number] = layer.expand(len(self.parts), -1, -1, -1)
                continue
            spectra = torch.fft.rfft2(pixels)
            kernels = [window.spectra[k] for k in slices]
            names, totals = zip(*_sums(numbers, spectra, kernels), strict=True)
            wanted = (window.margin, window.margin, box.height, box.width)
            blurred = crop_inverse(torch.stack(totals), window.size, wanted)
            layers.update(zip(names, blurred.unbind(), strict=True))
        return layers

    def _members(self, surface: _Surface, box: Tile, window: _Window, slices: list[int]) -> Tensor:
        """The pixels of slices within a window, [k, C + 1, height, width]."""
        top, left = box.top + self.margin - window.margin, box.left + self.margin - window.margin
        rows, columns = slice(top, top + window.size[0]), slice(left, left + window.size[1])
        rungs_of = [k // surface.stride for k in slices]
        index = torch.tensor(rungs_of, dtype=surface.places.dtype, device=surface.places.device)
        shares = membership(surface.places[rows, columns], index)
        return surface.pixels[:, rows, columns] * shares[:, None]

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


def _sums(
    numbers: list[int], slices: Tensor, factors: list[Tensor] | None = None
) -> Iterator[tuple[int, Tensor]]:
    """Slices of the same number, adjacent to each other, each times its factor, summed."""
    places = range(len(numbers))
    for number, group in groupby(places, key=lambda i: numbers[i]):
        first, *others = group
        if factors is None:
            total = slices[first]
            for i in others:
                total = total + slices[i]
        else:
            total = slices[first] * factors[first]
            for i in others:
                total = total.addcmul_(slices[i], factors[i])
        yield number, total


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
            f"psf_ks must be at least {needed} for a CoC radius of {spread:.2f} px, got {psf_ks}; "
            "leave it out to size kernels by the scene"
        )
    end = (psf_ks - 1) // 2 + 0.5
    return tuple(min(max(r, -end), end) for r in radii)

"""One picture through the pipeline: slice, blur, composite, tile by tile.

Visible slices are blurred one by one and composited front to back, per part of the aperture.
Hidden slices fill only what is left, so they are summed while still transformed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby

import torch
from torch import Tensor

from defocus_core.aperture import LEFT, RIGHT, Aperture, parts
from defocus_core.compositing import add_behind, pair_of, picture
from defocus_core.convolution import (
    crop_inverse,
    kernel_spectra,
    leaning_spectra,
    reach,
    transform_length,
)
from defocus_core.hidden import hidden_layer
from defocus_core.highlights import draw, split
from defocus_core.mixed import unmixed
from defocus_core.quality import Quality
from defocus_core.slicing import evenly, layers, position, rungs
from defocus_core.slopes import slopes
from defocus_core.surface import Ladder, Margins, Surface
from defocus_core.threads import threaded
from defocus_core.tiling import TILE, tiles


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


@dataclass(frozen=True)
class _Window:
    """The transform that slices of similar reach share.

    Attributes:
        margin: Px around a tile.
        size: (height, width) of the transform.
        spectra: Of the kernels, by the index of the slice: [M, 1, height, width // 2 + 1].
        leaning: The same times u.x and u.y: [2, M, 1, ...]; empty if no surface is tilted.
    """

    margin: int
    size: tuple[int, int]
    spectra: dict[int, Tensor]
    leaning: dict[int, Tensor]


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
        pixels, highlights = split(pixels, signed_radius)
        lean = slopes(signed_radius)
        lean = lean * ((lean * lean).sum(0) > quality.least_slope**2)
        self.windows = self._windows(aperture, pixels, tilted=bool(lean.any()))
        spans = list(dict.fromkeys(map(id, self.windows.values())))
        self.spans = [spans.index(id(self.windows[k])) for k in range(len(self.radii))]
        own, coverage, fringe = unmixed(pixels, signed_radius)
        hidden = hidden_layer(own, signed_radius, threads)
        stride = 1 if num_layers else quality.hidden_stride
        every = Ladder(self.radii, self.reaches)
        margins = self._margins(H, W)
        layer = torch.cat([own * coverage, coverage])
        self.visible = Surface(
            layer, signed_radius, every, self.grid, margins, fringe=fringe, slopes=lean
        )
        self.hidden = Surface(
            torch.cat([hidden.color, torch.ones_like(coverage)]),
            hidden.signed_radius,
            every._replace(stride=stride),
            self.grid,
            margins,
            mask=hidden.mask,
        )
        self.highlights = None
        if highlights:
            places = position(signed_radius, self.radii)
            self.highlights = draw(highlights, places, self.radii, aperture, self.parts)

    def _windows(self, aperture: Aperture, like: Tensor, *, tilted: bool) -> dict[int, _Window]:
        """The window of each slice that is blurred at all; slices in one window share it."""
        sharing: dict[tuple[int, int, bool], list[int]] = {}
        for k in range(len(self.radii)):
            widest = max(self.reaches[j] for j, g in enumerate(self.layers) if g == self.layers[k])
            rows, columns = (transform_length(n + 2 * widest) for n in self.side)
            sharing.setdefault((rows, columns, widest == 0), []).append(k)
        precision = torch.complex128 if like.dtype == torch.float64 else torch.complex64
        windows = {}
        for (rows, columns, _), slices in sharing.items():
            extent = max(self.reaches[k] for k in slices)
            radii = torch.tensor([self.radii[k] for k in slices], dtype=torch.float64)
            blur = (radii, extent, (rows, columns), aperture, self.parts)
            kinds = [kernel_spectra] + ([leaning_spectra] if tilted and extent else [])
            spectra, *leaning = (
                dict(zip(slices, kind(*blur).to(like.device, precision).unsqueeze(-3), strict=True))
                for kind in kinds
            )
            window = _Window(extent, (rows, columns), spectra, *(leaning or [{}]))
            windows.update(dict.fromkeys(slices, window))
        return windows

    def _margins(self, H: int, W: int) -> Margins:
        """As much that every window of every tile lies within."""
        longest = [max(w.size[i] for w in self.windows.values()) for i in (0, 1)]
        below = longest[0] + TILE * ((H - 1) // TILE) - H
        beside = longest[1] + TILE * ((W - 1) // TILE) - W
        before = max(w.margin for w in self.windows.values())
        return Margins(before, max(beside, 0), max(below, 0))

    def tile(self, index: int) -> Tensor:
        """The centre, or the centre, left and right image [1 or 3, C, h, w] of one tile."""
        box = self.grid[index]
        seen = self.visible.empty(len(self.parts), box)
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

    def _blurred(self, surface: Surface, index: int, layer_of: list[int]) -> dict[int, Tensor]:
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
            place = (index, box, window.margin, window.size)
            pixels = surface.members(*place, slices)
            if window.margin == 0:
                for k, sharp in zip(slices, pixels[..., : box.height, : box.width], strict=True):
                    others = layers.get(layer_of[k])
                    sharp = sharp.expand(len(self.parts), -1, -1, -1)
                    layers[layer_of[k]] = sharp if others is None else others + sharp
                continue
            terms = list(zip(slices, torch.fft.rfft2(pixels), strict=True))
            tilted = surface.tilted_plan[index]
            totals: dict[int, Tensor] = {}
            for k, spectrum in terms:
                _add(totals, layer_of[k], spectrum, window.spectra[k])
            if chosen := [i for i, k in enumerate(slices) if k in tilted]:
                lean = surface.slopes(*place[1:])[:, None] * pixels[chosen][:, None]
                for i, pair in zip(chosen, torch.fft.rfft2(lean), strict=True):
                    for spectrum, kernel in zip(pair, window.leaning[slices[i]], strict=True):
                        _add(totals, layer_of[slices[i]], spectrum, kernel)
            wanted = (window.margin, window.margin, box.height, box.width)
            blurred = crop_inverse(torch.stack(list(totals.values())), window.size, wanted)
            layers.update(zip(totals, blurred.unbind(), strict=True))
        return layers

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


def _add(totals: dict[int, Tensor], number: int, spectrum: Tensor, kernel: Tensor) -> None:
    """Add a slice's spectrum [C + 1, h, w] times a kernel's [M, 1, h, w] to a layer's."""
    if number in totals:
        totals[number] = totals[number].addcmul_(spectrum, kernel)
    else:
        totals[number] = spectrum * kernel


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

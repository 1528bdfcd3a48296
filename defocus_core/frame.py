"""One picture through the pipeline: slice, blur, composite, tile by tile.

Visible slices are blurred one by one and composited front to back, per part of the aperture.
Hidden slices fill only what is left, so they are summed while still transformed.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby

import torch
from torch import Tensor

from defocus_core.aperture import LEFT, RIGHT, Aperture, part_area, parts
from defocus_core.blur import Blur, Sliced
from defocus_core.compositing import add_behind, pair_of, picture
from defocus_core.convolution import reach
from defocus_core.hidden import HiddenLayer, hidden_layer
from defocus_core.highlights import draw, split
from defocus_core.mixed import unmixed
from defocus_core.quality import Quality
from defocus_core.ramps import without_ramps
from defocus_core.slicing import evenly, layers, position, rungs
from defocus_core.slopes import slopes
from defocus_core.surface import Samples
from defocus_core.threads import threaded
from defocus_core.tiling import grid_over
from defocus_core.windows import windows

# Brightness over the median beyond which float32 is not enough.
_RANGE = 1e3


def render_frame(
    pixels: Tensor,
    signed_radius: Tensor,
    *,
    aperture: Aperture,
    quality: Quality,
    left_right: bool = False,
    num_layers: int | None = None,
    psf_ks: int | None = None,
    hidden: HiddenLayer | None = None,
    threads: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Tensor, Tensor, dict[str, int]]:
    """Images, trust, and counts of the work done.

    The images are the centre, or centre, left and right: [1 or 3, C, H, W]; trust is [1, 1, H, W].

    Args:
        pixels: [C, H, W], float32 or float64.
        signed_radius: [H, W] px, of the same dtype.
        aperture: The pupil.
        quality: Spacing of slices, parts of the aperture.
        left_right: Whether left and right are wanted.
        num_layers: As for `render`.
        psf_ks: As for `render`.
        hidden: What is known behind the visible surface.
        threads: As for `render`.
        progress: As for `render`.
    """
    frame = _Frame(
        pixels, signed_radius, aperture, quality, left_right, num_layers, psf_ks, hidden, threads
    )
    count = len(frame.grid.tiles)
    done: list[tuple[Tensor, Tensor]] = []
    for result in threaded(frame.tile, range(count), threads):
        done.append(result)
        if progress:
            progress(len(done), count)
    rows = [list(row) for _, row in groupby(range(count), lambda i: frame.grid.tiles[i].top)]
    images, trust = (
        torch.cat([torch.cat([done[i][kind] for i in row], -1) for row in rows], -2)
        for kind in (0, 1)
    )
    return images, trust, frame.counts()


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
        known: HiddenLayer | None,
        threads: int,
    ) -> None:
        H, W = signed_radius.shape
        signed_radius = without_ramps(signed_radius)
        self.parts = parts(aperture, quality.parts)
        self.centre = len(self.parts)
        self.left_right = left_right
        self.signed = bool((pixels < 0).any())
        if left_right and self.centre == 1:
            self.parts = [*self.parts, LEFT, RIGHT]
        self.weights = [part_area(aperture, part) for part in self.parts]
        all_radii = [signed_radius.detach().flatten()]
        if known is not None:
            all_radii.append(known.signed_radius[known.mask])
        self.radii = _slice_radii(torch.cat(all_radii), quality, num_layers, psf_ks)
        reaches = [reach(r, max(H, W) - 1) for r in self.radii]
        self.size, self.farthest = (H, W), max(reaches)
        self.layers = layers(self.radii, quality)
        self.grid = grid_over(H, W)
        pixels, highlights = split(pixels, signed_radius)
        if _needs_double(pixels):
            pixels, signed_radius = pixels.double(), signed_radius.double()
            if known is not None:
                known = HiddenLayer(known.color.double(), known.signed_radius.double(), known.mask)
        own, coverage, fringe = unmixed(pixels, signed_radius)
        lean = slopes(signed_radius, quality.least_slope)
        side = (self.grid.tiles[0].height, self.grid.tiles[0].width)
        slices = (self.radii, reaches, self.layers, side)
        tilted = lean is not None
        self.windows = windows(*slices, aperture, self.parts, pixels, tilted=tilted)
        self.groups = [slice(0, self.centre)]
        if len(self.parts) > self.centre:
            self.groups.append(slice(self.centre, len(self.parts)))
        self.blur = Blur(self.windows, reaches, self.grid, self.groups)
        spans = list(dict.fromkeys(map(id, self.windows)))
        self.spans = [spans.index(id(window)) for window in self.windows]
        places = position(signed_radius, self.radii)
        visible = Samples(
            torch.cat([own * coverage, coverage]),
            places,
            fringe.at,
            fringe.layer,
            position(fringe.signed_radius, self.radii),
            lean,
        )
        self.blank = torch.zeros_like(visible.layer[None, :, :1, :1])
        self.visible = self.blur.sliced(visible, 1)
        # nothing is invented where something is known
        self.known: Sliced | None = None
        self.invented: Sliced | None = None
        stride = 1 if num_layers else quality.hidden_stride
        if hidden := hidden_layer(own, signed_radius, threads):
            invented = hidden.mask
            if known is not None:
                invented = hidden.mask & ~known.mask
                self.known = self._behind(known._replace(mask=hidden.mask & known.mask), 1)
            self.invented = self._behind(hidden._replace(mask=invented), stride)
        self.highlights = None
        if highlights:
            self.highlights = draw(
                highlights, signed_radius, places, self.radii, aperture, self.parts
            )

    def _behind(self, hidden: HiddenLayer, stride: int) -> Sliced | None:
        """A layer behind the visible one, None if it has no pixels."""
        if not bool(hidden.mask.any()):
            return None
        coverage = hidden.mask[None].to(hidden.color.dtype)
        layer = torch.cat([hidden.color * coverage, coverage])
        places = position(hidden.signed_radius, self.radii[::stride])
        nowhere = torch.zeros((0, 2), dtype=torch.long, device=places.device)
        samples = Samples(layer, places, nowhere, layer[:, :0, 0].T, places[0, :0], None)
        return self.blur.sliced(samples, stride)

    def tile(self, index: int) -> tuple[Tensor, Tensor]:
        """Of one tile the centre, or the centre, left and right, [1 or 3, C, h, w], and trust."""
        visible = self.blur.over_tile(self.visible, index, self.layers)
        nothing: list[dict[int, Tensor]] = [{} for _ in self.groups]
        known = invented = nothing
        if self.known:
            known = self.blur.over_tile(self.known, index, self.spans)
        if self.invented:
            invented = self.blur.over_tile(self.invented, index, self.spans)
        (whole, observed), *halves = (
            self._seen(*layers, index=index)
            for layers in zip(self.groups, visible, known, invented, strict=True)
        )
        trust = self._trust(whole[:, -1], observed, index)
        centre = picture(whole, self.weights[: self.centre])
        if not self.left_right:
            return centre[None], trust
        both = halves[0][0] if halves else whole
        first = self.groups[-1].start
        cut = sum(1 for part in self.parts[first:] if part.x1 <= 0)
        left = picture(both[:cut], self.weights[first : first + cut])
        right = picture(both[cut:], self.weights[first + cut :])
        pair = pair_of(centre, left, right, signed=self.signed)
        return torch.cat([centre[None], pair]), trust

    def _trust(self, covered: Tensor, observed: Tensor, index: int) -> Tensor:
        """The share of the aperture that saw the scene, [1, 1, h, w].

        Of what m parts covered [m, h, w] what they observed; as far from the border as light
        reaches at most, times what they covered: the rest lies outside the frame.
        """
        weights = observed.new_tensor(self.weights[: self.centre])[:, None, None]
        covered, observed = ((x * weights).sum(0) / weights.sum() for x in (covered, observed))
        box, (H, W) = self.grid.tiles[index], self.size
        y = torch.arange(box.top, box.top + box.height, device=covered.device)
        x = torch.arange(box.left, box.left + box.width, device=covered.device)
        down, across = torch.minimum(y, H - 1 - y), torch.minimum(x, W - 1 - x)
        inner = torch.minimum(down[:, None], across) >= self.farthest
        share = observed / covered * torch.where(inner, 1.0, covered)
        return share.clamp(0, 1)[None, None]

    def _seen(
        self,
        group: slice,
        visible: dict[int, Tensor],
        known: dict[int, Tensor],
        invented: dict[int, Tensor],
        *,
        index: int,
    ) -> tuple[Tensor, Tensor]:
        """What m parts of the aperture see of a tile [m, C + 1, h, w], and the share observed."""
        box = self.grid.tiles[index]
        seen = self.blank.expand(group.stop - group.start, -1, box.height, box.width).clone()
        for number in sorted(visible):
            seen = add_behind(seen, visible[number])
        if known:
            seen = add_behind(seen, torch.stack(list(known.values())).sum(0))
        observed = seen[:, -1].clone()
        if invented:
            seen = add_behind(seen, torch.stack(list(invented.values())).sum(0))
        if self.highlights is not None:
            rows = slice(box.top, box.top + box.height)
            columns = slice(box.left, box.left + box.width)
            color = seen[:, :-1] + self.highlights[group, :, rows, columns]
            seen = torch.cat([color, seen[:, -1:]], 1)
        return seen, observed

    def counts(self) -> dict[str, int]:
        """What was computed, out of what a renderer that skips nothing would."""
        sliced = [s for s in (self.visible, self.known, self.invented) if s]
        work = [
            self.windows[rung * stride]
            for surface, stride in sliced
            for rungs in surface.plan
            for rung in rungs
        ]
        invented = self.invented.surface.plan if self.invented else []
        copied = [
            box.height * box.width
            for i, box in enumerate(self.grid.tiles)
            if not any(
                self.windows[rung * stride].margin
                for surface, stride in sliced
                for rung in surface.plan[i]
            )
        ]
        return {
            "pixels": self.size[0] * self.size[1],
            "pixels_copied": sum(copied),
            "slices": len(self.radii),
            "tiles": len(self.grid.tiles),
            "slice_tiles": 2 * len(self.radii) * len(self.grid.tiles),
            "slice_tiles_done": len(work),
            "slice_tiles_blurred": sum(1 for window in work if window.margin),
            "tiles_with_hidden": sum(1 for rungs in invented if rungs),
        }


def _needs_double(pixels: Tensor) -> bool:
    """Whether the rounding of float32 transforms, 1e-7 of the brightest, would show in the dark."""
    brightness = pixels.detach().amax(0)
    some = brightness[::3, ::3].flatten()
    lit = some[some > 0]
    return bool(len(lit)) and bool(brightness.max() > _RANGE * lit.median())


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

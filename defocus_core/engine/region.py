"""A region of a picture through the pipeline: slice, blur, composite, tile by tile.

Slices of a layer are summed while still transformed; layers are composited front to back, per part
of the aperture. Hidden layers fill only what visible ones leave, but in focus, where they occlude.
"""

from __future__ import annotations

from torch import Tensor

from defocus_core.blur.layer_blur import Blur, Sliced
from defocus_core.compositing.aperture_views import Fronts
from defocus_core.compositing.bokeh_discs import draw
from defocus_core.compositing.frame_border import share_in_frame
from defocus_core.compositing.highlights import split
from defocus_core.compositing.saturating_sum import add_light, pair_of, picture
from defocus_core.engine.frame import FillSlices, Frame
from defocus_core.engine.hidden_fill import Filling
from defocus_core.engine.layer_order import Layer, add_in_order
from defocus_core.images.box import Box
from defocus_core.images.pyramid import axes
from defocus_core.images.source import Pixels
from defocus_core.images.tiling import Grid
from defocus_core.images.views import Views
from defocus_core.inpainting.frame_pyramid import Backdrop
from defocus_core.inpainting.hidden_layers import HiddenLayer, hidden_layer
from defocus_core.inpainting.known_layer import Behind, told_apart
from defocus_core.layers.ladder import position
from defocus_core.layers.matting import Unmixed, unmixed, whole
from defocus_core.layers.sliced_surface import Samples
from defocus_core.layers.slopes import AROUND as AROUND_SLOPES
from defocus_core.layers.slopes import slopes
from defocus_core.layers.subpixel_shifts import AROUND as AROUND_SHIFTS
from defocus_core.layers.subpixel_shifts import Shifts

# Px around a pixel that decide how it is tilted, and the gradient of its colours.
_AROUND = max(AROUND_SLOPES, AROUND_SHIFTS)
# Gaps between visible surfaces, as a share of the slopes that are neglected, that may be but errors
# of depth in few levels: half an aperture sees a surface of slope s too thin by 4 / 3 pi of s.
_DOUBT = 0.5


class Region:
    """Some tiles of a picture, and everything that they share."""

    def __init__(
        self,
        frame: Frame,
        grid: Grid,
        pixels: Pixels,
        signed_radius: Pixels,
        behind: Behind | None,
        beyond: Backdrop | None,
    ) -> None:
        """Find the surfaces of a region.

        Args:
            frame: It is a part of.
            grid: Its tiles.
            pixels: [C, H, W] of the frame, in any precision.
            signed_radius: [H, W] px of the frame.
            behind: What is known behind the visible surface of the frame.
            beyond: The frame seen coarsely; None if nothing in it is hidden.
        """
        self._frame = frame
        self._tiles = grid.tiles
        core = grid.box
        outer = core.grown(frame.margin, frame.box)
        inner = core.grown(frame.farthest + frame.farthest % 2, frame.box)  # it may be halved
        self._grid, self._inner = grid, inner
        self._inside = inner.seen_from(outer)
        self._blur = Blur(
            frame.windows,
            frame.reaches,
            grid.seen_from(inner),
            frame.groups,
            axes(frame.size, inner.top, inner.left),
        )

        pixels, signed_radius = (outer.of(x).to(frame.dtype) for x in (pixels, signed_radius))
        if frame.edges:  # pixels beside them are looked up by their numbers
            pixels, signed_radius = pixels.contiguous(), signed_radius.contiguous()
        pixels, highlights = split(pixels, signed_radius, frame.limit)
        self._in_frame: list[Tensor] | None = None  # what parts of the aperture see of it
        if not self._is_inside(core):
            radius = core.seen_from(outer).of(signed_radius)
            self._in_frame = [
                share_in_frame(radius, core, frame.size, frame.aperture, frame.parts[group])
                for group in frame.groups
            ]
        unmixes = frame.edges and frame.quality.unmixes
        own = (unmixed if unmixes else whole)(pixels, signed_radius)
        places = position(signed_radius, frame.radii) if highlights else None
        self._visible = self._in_front(own, signed_radius, places)
        # nothing is invented where something is known
        self._known: Filling | None = None
        self._invented: Filling | None = None
        if beyond is not None:
            halvings = frame.invented.halvings
            layer = hidden_layer(
                own.color, signed_radius, beyond, outer, self._inside, halvings=halvings
            )
            if layer and behind is not None:
                known = behind.within(inner, self._inside.of(signed_radius), frame.dtype)
                middle = axes(frame.size, inner.top, inner.left)
                known, layer = told_apart(known, layer, middle)
                self._known = self._filling(known, frame.known)
            if layer:
                self._invented = self._filling(layer, frame.invented)
        self._highlights = None
        if highlights and places is not None:
            aperture, parts, box = frame.aperture, frame.parts, core.seen_from(outer)
            self._highlights = draw(
                highlights, signed_radius, places, frame.radii, aperture, parts, box
            )

    def _in_front(self, own: Unmixed, signed_radius: Tensor, places: Tensor | None) -> Sliced:
        """The visible surfaces, from pixels, their radii, and their positions if known."""
        frame, inside = self._frame, self._inside
        around = inside.grown(_AROUND, Box(0, 0, *signed_radius.shape))
        inner, radius = inside.seen_from(around), around.of(signed_radius)
        places = position(radius, frame.radii) if places is None else around.of(places)
        lean = shifts = None
        if frame.tilted:
            lean = slopes(radius, frame.quality.least_slope)
        if frame.left_right and frame.sharp is not None:
            parts = frame.parts[frame.groups[-1]]
            color = around.of(own.color)
            shifts = Shifts(color, radius, places, inner, frame.radii, frame.aperture, parts)
        fringe = own.fringe
        at = fringe.at - fringe.at.new_tensor([inside.top, inside.left])
        here = (at >= 0).all(1) & (at[:, 0] < inside.height) & (at[:, 1] < inside.width)
        samples = Samples(
            inside.of(own.color),
            None if own.coverage is None else inside.of(own.coverage),
            inner.of(places),
            at[here],
            fringe.layer[here],
            position(fringe.signed_radius[here], frame.radii),
            None if lean is None else inner.of(lean),
            shifts,
        )
        return self._blur.sliced(samples, 1, frame.layers)

    def _filling(self, hidden: HiddenLayer, slices: FillSlices) -> Filling | None:
        """A layer behind the visible one, None if it has no pixels."""
        if not bool(hidden.mask.any()):
            return None
        return Filling(self._frame, self._grid, self._inner, hidden, slices)

    def tile(self, index: int) -> Views:
        """One of its tiles."""
        frame = self._frame
        fronts, culled = self._fronts(index)
        moved = fronts.moved
        whole, *halves = self._lit(fronts.seen, index)
        trust = self._trust(whole[:, -1], fronts.invented, index)
        stats, box = self._counts(index, culled), self._tiles[index]
        centre = picture(whole, frame.weights[: frame.centre], signed=frame.signed)
        if not frame.left_right:
            return Views([centre], trust, stats, box)
        both = halves[0] if halves else whole
        if moved is not None:
            both = add_light(both, moved)
        first = frame.groups[-1].start
        cut = sum(1 for part in frame.parts[first:] if part.x1 <= 0)
        left = picture(both[:cut], frame.weights[first : first + cut])
        right = picture(both[cut:], frame.weights[first + cut :])
        pair = pair_of(centre, left, right, signed=frame.signed)
        return Views([centre, *pair], trust, stats, box)

    def _trust(self, covered: Tensor, invented: Tensor | None, index: int) -> Tensor:
        """The share of the aperture that saw the scene, [1, h, w].

        Of what m parts covered [m, h, w] what is not invented, times what of them looks into the
        frame.
        """
        observed = covered if invented is None else covered - invented
        share, box = self._mean(observed) / self._mean(covered), self._tiles[index]
        if self._in_frame is not None and not self._is_inside(box):
            expected = box.seen_from(self._tiles[0]).of(self._in_frame[0])
            share = share * self._mean(expected[:, 0])
        return share.clamp(0, 1)[None]

    def _mean(self, parts: Tensor) -> Tensor:
        """Of what m parts of the aperture see for the centre image, [m, h, w]."""
        if len(parts) == 1:
            return parts[0]
        weights = parts.new_tensor(self._frame.weights[: self._frame.centre])[:, None, None]
        return (parts * weights).sum(0) / weights.sum()

    def _fronts(self, index: int) -> tuple[Fronts, tuple[int, ...]]:
        """What the parts of the aperture see of a tile, and what was not needed for that."""
        frame = self._frame
        doubt = _DOUBT * frame.quality.least_slope if frame.quantised else None
        visible = self._blur.over_tile(self._visible, index)
        firsts = [next(iter(layers.values())).layer for layers in visible]
        size = self._tiles[index][2:]
        blank = [layer.new_zeros(*layer.shape[:2], *size) for layer in firsts]
        fronts = Fronts(blank, self._full(index), doubt)
        reaching = [i for i, some in enumerate(self._hidden) if some.plan[index]]
        hidden = [Layer(self._hidden[i], self._hidden[i] is self._known) for i in reaching]
        needed = add_in_order(fronts, visible, hidden, frame, index)
        return fronts, tuple(layer for i, layer in enumerate(reaching) if i not in needed)

    @property
    def _hidden(self) -> list[Filling]:
        """What is known to lie behind, and what is invented."""
        return [some for some in (self._known, self._invented) if some]

    def _lit(self, seen: list[Tensor], index: int) -> list[Tensor]:
        """The same with highlights."""
        if self._highlights is None:
            return seen
        lit = self._tiles[index].seen_from(self._tiles[0]).of(self._highlights)
        groups = self._frame.groups
        return [add_light(some, lit[group]) for some, group in zip(seen, groups, strict=True)]

    def _is_inside(self, box: Box) -> bool:
        """Whether no light from beyond the frame reaches a part of it."""
        if self._frame.size == (1, 1):  # in which it spreads no farther, but is lost
            return False
        return box == box.grown(0, self._frame.box.shrunk(self._frame.farthest))

    def _full(self, index: int) -> list[Tensor | float]:
        """What is covered at most in a tile, for each group."""
        tile = self._tiles[index]
        if self._in_frame is None or not self._frame.edges or self._is_inside(tile):
            return [1.0 for _ in self._frame.groups]
        here = tile.seen_from(self._tiles[0])
        return [here.of(share) for share in self._in_frame]

    def _counts(self, index: int, culled: tuple[int, ...]) -> dict[str, int]:
        """What was computed for a tile, out of what a renderer that skips nothing would.

        Args:
            index: Of the tile.
            culled: The hidden layers that reach it but were not needed.
        """
        hidden, area = self._hidden, self._tiles[index].area
        planned = [self._frame.windows[rung] for rung in self._visible.surface.plan[index]]
        behind = [
            [(some.windows[rung], some.halvings) for rung in some.plan[index]] for some in hidden
        ]
        needed = [pair for i, layer in enumerate(behind) if i not in culled for pair in layer]
        work = [(window, window.halvings) for window in planned]
        work += [(window, more + window.halvings) for window, more in needed]
        reaching = sum(map(len, behind))
        spread = any(window.margin for window in planned)
        spread = spread or any(window.margin for layer in behind for window, _ in layer)
        pieces = self._visible.pieces[index]
        return {
            "pixels": area,
            "pixels_copied": 0 if spread else area,
            "tiles": 1,
            "slice_tiles": 2 * len(self._frame.windows),
            "slice_tiles_done": len(work),
            "slice_tiles_blurred": sum(1 for window, _ in work if window.margin),
            "slice_tiles_reduced": sum(1 for _, halvings in work if halvings),
            "slice_tiles_culled": reaching - len(needed),
            "layer_pixels": area * len(pieces),
            "layer_pixels_done": sum(piece.patch.seen.area for piece in pieces),
            "tiles_culled": int(bool(culled)),
            "tiles_with_hidden": int(bool(self._invented and self._invented.plan[index])),
        }

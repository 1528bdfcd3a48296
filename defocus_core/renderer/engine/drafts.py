"""Drafts: a picture at half size, enlarged, with the detail of pixels in focus.

Coarse pixels of two by two px are symmetric about the middle of the frame: of an odd number of rows
or columns every second is one, with half of those beside it, as if it were two.

The colour of a coarse pixel is the mean of its pixels. Where a depth edge runs through it, its
radius is that of the surface most of its light comes from, and of the nearer one of two alike.

Coarse pixels become pixels again so that their mean stays. To these the detail is added, the
difference between the picture and its own coarse pixels, as far as the blur leaves it and no nearer
surface hides it: beside its colours each coarse pixel is rendered with the share of detail that its
blur leaves, and what is shown of this share is what is shown of the detail.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial, reduce

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.renderer.compositing.saturating_sum import ColorRange, count_negative, pair_of
from defocus_core.renderer.engine.frame import SharedFrame
from defocus_core.renderer.engine.regions import in_rows
from defocus_core.renderer.engine.scene import Scene
from defocus_core.renderer.layers.slice_radii import SHARP, SOFT
from defocus_core.tensors.box import Box
from defocus_core.tensors.derived import Mapped, held
from defocus_core.tensors.neighbourhoods import halfway
from defocus_core.tensors.source import Pixels, banded
from defocus_core.tensors.threads import threaded
from defocus_core.tensors.ties import greater, lesser, tied, within
from defocus_core.tensors.torch_modes import recomputed
from defocus_core.tensors.views import Views, added, joined

# Greatest difference of radii in px within one surface in a coarse pixel.
_STEEP = 1.013
# A surface of this share of the light of a coarse pixel gives it its radius, however small.
_NEARLY_ALL = 0.8
# Value of the channel of detail where a coarse pixel has all of it: no light, and so little that it
# tells no surfaces apart, nor do its squares.
_UNIT = 2.0**-64
# Radius in px from which on no detail is left; up to there the share that is left falls as a disc
# leaves it of random textures, in the mean.
NO_DETAIL = 2.65
# A half of the lens shifts detail by its gradient times this many radii, from the first of these
# radii in px on, and in full from the second.
_SHIFT, _STILL = 0.8, (2 * SHARP, 2 * SOFT)
# Least share of detail by which its visible part is divided.
_MINIMUM = 0.05
# (height, width) in coarse pixels of tiles that are enlarged; coarse pixels around a coarse pixel
# that decide its pixels, and around a tile, for the gradients of detail.
_TILE, AROUND = (32, 512), 2
_WIDE = AROUND + 1


def parts_of(px: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """The pixels [n, ..., h, w] of coarse pixels: four, or those in the middle twice.

    `px`: [..., 2 h, 2 w], or one row or column more where it is odd.
    """
    parts = [px]
    for dim in (-2, -1):
        n = px.shape[dim] // 2
        firsts = (0, 1, 1, 2) if odd[dim] else (0, 1)
        cuts = (slice(first, first + 2 * n - 1, 2) for first in firsts)
        parts = [
            part[..., cut, :] if dim == -2 else part[..., cut] for cut in cuts for part in parts
        ]
    return torch.stack(parts)


def means(parts: Tensor) -> Tensor:
    """The mean of the pixels [n, ..., h, w] of each coarse pixel."""
    return _total(parts) / len(parts)


def _total(parts: Tensor) -> Tensor:
    """The sum [...] of values [n, ...], in one order whatever their place in memory."""
    return reduce(torch.add, parts.unbind())


def coarse_radii(parts: Tensor, pixels: Tensor) -> Tensor:
    """Radii [h, w] in coarse pixels of the surfaces that show, of px [n, h, w] and [n, C, h, w]."""
    there = torch.ones_like(parts, dtype=torch.bool)
    return majority(parts, there, pixels.detach().amax(1).clamp(min=0)) / 2


def majority(radii: Tensor, there: Tensor, light: Tensor) -> Tensor:
    """The mean radius [...] px of the surface that has most of the pixels of a coarse pixel.

    Or nearly all of its light, if there is such a one. `radii`, `there` and `light`: [n, ...], of
    its pixels, whether they exist, and their brightness.
    """
    minimum = torch.where(there, radii, torch.inf).amin(0).detach()
    maximum = torch.where(there, radii, -torch.inf).amax(0).detach()
    near = radii <= halfway(minimum, maximum)
    shares = torch.stack([there.to(light), light], 1)
    of_near, both = _total(shares * near[:, None]), _total(shares)
    has_more = 2 * of_near[0] >= both[0]
    has_more &= of_near[1] >= (1 - _NEARLY_ALL) * both[1]
    has_more |= of_near[1] > _NEARLY_ALL * both[1]
    chosen = there & ((near == has_more) | (maximum - minimum <= _STEEP))
    return _total(torch.where(chosen, radii, 0.0)) / chosen.sum(0).clamp(min=1)


def _with_detail(pixels: Tensor, radii: Tensor) -> Tensor:
    """Colours [C + 1, h, w] of coarse pixels, and the share of detail that is left in them."""
    return torch.cat([means(pixels), _UNIT * means(left_of_detail(radii))[None]])


def left_of_detail(signed_radius: Tensor) -> Tensor:
    """The share [...] of detail that a disc leaves, for radii [...] px: 1 in focus."""
    left = 1 + (SHARP**2 - signed_radius.square()) / NO_DETAIL**2
    return left.clamp(0, 1).square().square()


def in_coarse_pixels(merge: Callable[..., Tensor], *pictures: Pixels) -> Mapped:
    """Coarse pixels [..., ceil(H / 2), ceil(W / 2)] of pictures, merged when they are cut.

    `merge`: makes coarse pixels [..., h, w] of `parts_of` each picture, in float32 at least.
    """
    size = pictures[0].shape[-2:]
    odd = size[0] % 2 == 1, size[1] % 2 == 1

    def read(rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        return merge(*(parts_of(_px_of(x, rows, columns), odd) for x in pictures))

    first = read((0, 1), (0, 1))
    return Mapped(read, (*first.shape[:-2], -(-size[0] // 2), -(-size[1] // 2)), first)


def _px_of(picture: Pixels, *spans: tuple[int, int]) -> Tensor:
    """The px of a window of coarse pixels; beyond an odd frame those on its edge are repeated."""
    cuts, px = [], None
    wanted = [
        torch.arange(2 * first - n % 2, max(2 * end, 2 * first)).clamp(0, n - 1)
        for (first, end), n in zip(spans, picture.shape[-2:], strict=True)
    ]
    cuts = [slice(int(w[0]), int(w[-1]) + 1) if len(w) else slice(0) for w in wanted]
    px = picture[..., cuts[0], cuts[1]]
    for dim, (index, cut) in enumerate(zip(wanted, cuts, strict=True), -2):
        if len(index) > px.shape[dim]:
            px = px.index_select(dim, (index - cut.start).to(px.device))
    wide = torch.promote_types(px.dtype, torch.float32)
    return px if px.dtype == torch.bool else px.to(wide)


def doubled(coarse: Tensor, part: Box) -> Tensor:
    """Pixels [..., 2 h, 2 w] of a part of coarse pixels [..., h + a, w + b], two around it.

    The mean of the four pixels of a coarse pixel is the coarse pixel, and polynomials of fourth
    order along a row or a column are kept (Cohen, Daubechies and Feauveau 1992), as far as its
    pixels lie within the range of the coarse pixels around. Beyond the frame the last ones go on.
    """
    below, beside = (
        n - at - m for n, at, m in zip(coarse.shape[-2:], part[:2], part[2:], strict=True)
    )
    missing = [AROUND - n for n in (part.left, beside, part.top, below)]
    coarse = pad(coarse.flatten(0, -3)[None], missing, mode="replicate")[0].view(
        *coarse.shape[:-2], part.height + 2 * AROUND, part.width + 2 * AROUND
    )
    inner = slice(AROUND, -AROUND)
    middle, downwards = coarse[..., inner, inner], _rise(coarse, -2)
    down, bend = downwards[..., inner], _rise(downwards, -1)
    across = _rise(coarse[..., inner, :], -1)
    least = greatest = coarse[..., 1:-1, 1:-1]
    for dim in (-2, -1):
        n = least.shape[dim] - 2
        lows, highs = ([x.narrow(dim, k, n) for k in range(3)] for x in (least, greatest))
        least = lesser(lesser(lows[0], lows[1]), lows[2])
        greatest = greater(greater(highs[0], highs[1]), highs[2])
    rise = down.abs() + across.abs() + bend.abs()
    room = lesser(greatest - middle, middle - least)
    fraction = room / greater(rise, room).clamp(min=torch.finfo(rise.dtype).tiny)
    if fraction.requires_grad:  # in one colour nothing rises, but for rounding
        fraction = torch.where(tied(rise, 0.0), 1.0, fraction)
    down, across, bend = down * fraction, across * fraction, bend * fraction
    rows = [
        torch.stack([y - slope, y + slope], -1).flatten(-2)
        for y, slope in ((middle - down, across - bend), (middle + down, across + bend))
    ]
    return torch.stack(rows, -2).flatten(-3, -2)


def _rise(coarse: Tensor, dim: int) -> Tensor:
    """Half the difference of the pixels of each coarse pixel along an axis, borders left out."""
    n = coarse.shape[dim] - 2 * AROUND
    first, second, _, fourth, fifth = (coarse.narrow(dim, k, n) for k in range(5))
    return (fourth - second).mul_(22 / 128).add_(first - fifth, alpha=3 / 128)


def between(px: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """Px [..., H, W] between those of coarse pixels in whose middle a pixel lies: one less."""
    for dim in (-2, -1):
        if odd[dim]:
            n = px.shape[dim] - 1
            px = (px.narrow(dim, 0, n) + px.narrow(dim, 1, n)) / 2
    return px


def with_detail(
    views: Tensor, visible: Tensor, detail: Tensor, picture: Tensor, r: Tensor
) -> Tensor:
    """Views [k, C, H, W], the centre and maybe left and right, with the detail that they show.

    `visible`: [k, H, W], the share that no nearer surface hides; `detail`: [C, H, W], of the
    `picture` that has it; `r`: [H, W] px, its radii.
    """
    shown = (left_of_detail(r) * visible)[:, None] * detail
    if len(views) > 1:
        still = ((r.abs() - _STILL[0]) / (_STILL[1] - _STILL[0])).clamp(0, 1)
        beside = pad(detail, (1, 1), mode="replicate")
        slope = (beside[..., 2:] - beside[..., :-2]) / 2
        moved = _SHIFT * r * still * left_of_detail(r) * visible[0] * slope
        shown = shown + torch.stack([torch.zeros_like(moved), moved, -moved])
    shown = views + shown
    centre = within(shown[0], lesser(views[0], picture), greater(views[0], picture))
    return torch.cat([centre[None], shown[1:]])


class Draft:
    """A scene to be rendered in coarse pixels, and the enlargement of its views.

    Attributes:
        scene: The scene in coarse pixels, with the share of detail as a further channel.
    """

    def __init__(self, scene: Scene, threads: int, *, hold: bool) -> None:
        """Make the coarse pixels, in memory if there is room."""
        image, radius = scene.image, scene.signed_radius
        self._in_px, self._size = (image, radius), Box(0, 0, *radius.shape[-2:])
        self._odd = self._size.height % 2 == 1, self._size.width % 2 == 1

        def coarse(merge: Callable[..., Tensor], *pictures: Pixels) -> Pixels:
            mapped = in_coarse_pixels(merge, *pictures)
            return held(mapped, *pictures, threads=threads, hold=hold)

        self.scene = replace(
            scene,
            image=coarse(_with_detail, image, radius),
            signed_radius=coarse(coarse_radii, radius, image),
            matte=scene.matte if scene.matte is None else coarse(means, scene.matte),
            surfaces=None,
        )
        ends = [(band.amin((-2, -1)), band.amax((-2, -1))) for band in banded(image)]
        least, greatest = (torch.stack(each) for each in zip(*ends, strict=True))
        self._channels = [*zip(least.amin(0).tolist(), greatest.amax(0).tolist(), strict=True)]

    def enlarged(self, frame: SharedFrame, parts: Iterator[Views]) -> Iterator[Views]:
        """Tiles in pixels, from regions in coarse pixels; the last rows wait for those below."""
        done, kept = 0, list[list[Views]]()
        counts: dict[str, int] = {}
        height, width = frame.size
        for row in in_rows(parts):
            counts = added([counts, *map(self._counts, row)])
            coarse = joined([*kept, row])
            end = coarse.box.sides[0].end
            ready = end if end == height else end - _WIDE
            tiles = [
                Box(top, left, min(_TILE[0], ready - top), min(_TILE[1], width - left))
                for top in range(done, ready, _TILE[0])
                for left in range(0, width, _TILE[1])
            ]
            tile = recomputed(partial(self._tile, frame, coarse))
            for part in threaded(tile, tiles, frame.settings.threads):
                yield part._replace(stats=added([counts, part.stats]))
                counts = {}
            first = max(ready - _WIDE, coarse.box.top)
            done, kept = ready, [[coarse.within(Box(first, 0, end - first, width))]]

    def _tile(self, frame: SharedFrame, coarse: Views, tile: Box) -> Views:
        """A tile of coarse pixels in pixels, which counts those that are clamped."""
        wide = tile.grown(1, frame.box)  # for gradients of detail
        around = wide.grown(AROUND, frame.box)
        rendered, k = coarse.within(around), len(coarse.images)
        given = around.of(self.scene.image).to(rendered.trust.dtype)
        every = torch.cat([*rendered.images, given, rendered.trust])
        px = between(doubled(every, wide.seen_from(around)), self._odd)
        *views, own, trust = torch.split(px, [len(given)] * (k + 1) + [1])
        # between the middles of the first and the last coarse pixels if their number is odd
        top, left = 2 * wide.top, 2 * wide.left
        box = Box(top, left, *px.shape[-2:])
        picture, radius = (box.of(x).to(px.dtype) for x in self._in_px)
        share, visible = own[-1] / _UNIT, torch.stack([view[-1] for view in views]) / _UNIT
        visible = (1 - (share - visible) / share.clamp(min=_MINIMUM)).clamp(0, 1)
        images = torch.stack([view[:-1] for view in views])
        images = with_detail(images, visible, picture - own[:-1], picture, radius)
        outer, counts = self._px(tile), dict[str, int]()
        inner = outer.seen_from(box)
        images, minimum = inner.of(images), min(0.0, *(least for least, _ in self._channels))
        if k > 1:
            counts = count_negative(images[1:], frame.content.limit, minimum)
            fraction, centre = frame.division.left_fraction, images[0]
            pair = pair_of(*images, minimum=minimum, fraction=fraction)
            limits = ColorRange.of(self._channels, centre, minimum)
            images = torch.cat([images[:1], limits.bounded_pair(pair, centre, fraction)])
        return Views(list(images), inner.of(trust), counts, outer)

    def _px(self, coarse: Box) -> Box:
        """The pixels of a rectangle of coarse pixels."""
        return Box(*(2 * n for n in coarse)).grown(0, self._size)

    def _counts(self, part: Views) -> dict[str, int]:
        """The counts of a part in coarse pixels, with pixels counted in pixels."""
        pixels = self._px(part.box).area
        copied = part.stats["pixels_copied"] * pixels // part.box.area
        counts = {**part.stats, "pixels": pixels, "pixels_copied": copied}
        counts.pop("pixels_clamped", None)  # of coarse pixels
        return counts

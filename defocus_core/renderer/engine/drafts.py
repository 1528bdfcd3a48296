"""Drafts: a picture at half size, enlarged, with the detail of pixels in focus.

Coarse pixels of two by two px are symmetric about the middle of the frame, as in `tensors.pyramid`:
of an odd number of rows or columns every second is one, with half of those beside it.

The colour of a coarse pixel is the mean of its pixels. Where a depth edge runs through a coarse
pixel, its radius is that of the surface that has more of its pixels, and of the nearer one if both
have the same. But if a pixel is much brighter than the others, the coarse pixel has the radius of
this pixel, for most of its light comes from there.

Coarse pixels become pixels again so that the mean of two by two pixels is their coarse pixel. To
these pixels the detail is added, the difference between the picture and its own coarse pixels, as
far as the blur leaves it and no nearer surface hides it: beside its colours each coarse pixel is
rendered with the share of detail that its blur leaves. The part of this share that is shown
afterwards gives the share of detail that nearer surfaces hide.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad

from defocus_core.renderer.compositing.saturating_sum import ColorRange, count_negative, pair_of
from defocus_core.renderer.engine.frame import SharedFrame
from defocus_core.renderer.engine.regions import in_rows
from defocus_core.renderer.inpainting.hidden_layers import KnownLayer
from defocus_core.renderer.layers.slice_radii import SHARP, SOFT
from defocus_core.tensors.box import Box, Span
from defocus_core.tensors.derived import Mapped, held
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.neighbourhoods import halfway, range_of
from defocus_core.tensors.source import Pixels, banded
from defocus_core.tensors.sparse_masks import exceeding, positions_of
from defocus_core.tensors.threads import threaded
from defocus_core.tensors.ties import greater, lesser, positive, tied, within
from defocus_core.tensors.torch_modes import recomputed
from defocus_core.tensors.views import Views, added, joined

# Greatest difference of radii in px within one surface in a coarse pixel.
_STEEP = 1.013
# A pixel this many times as bright as the other three together gives the coarse pixel its radius.
_BRIGHTER = 4.0


def in_coarse_pixels(merge: Callable[..., Tensor], *pictures: Pixels) -> Mapped:
    """Coarse pixels [..., ceil(H / 2), ceil(W / 2)] of pictures, merged when they are cut.

    `merge`: makes coarse pixels [..., h, w] of the px of each picture, [..., 2 h, 2 w], or of one
    row or column more if it has an odd number of them, in float32 at least.
    """

    def read(rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        return merge(*(_px_of(x, rows, columns) for x in pictures))

    (H, W), first = pictures[0].shape[-2:], read((0, 1), (0, 1))
    return Mapped(read, (*first.shape[:-2], (H + 1) // 2, (W + 1) // 2), first)


def half_size(merge: Callable[..., Tensor], *pictures: Pixels, threads: int, hold: bool) -> Pixels:
    """The same, `held`."""
    return held(in_coarse_pixels(merge, *pictures), *pictures, threads=threads, hold=hold)


def hidden_at_half_size(hidden: KnownLayer, threads: int, *, hold: bool) -> KnownLayer:
    """A known layer in coarse pixels, with one more channel of 0."""
    color, radius, mask = hidden
    coarse = partial(half_size, threads=threads, hold=hold)
    return (
        coarse(_known_means, color, mask),
        coarse(_known_coarse_radii, radius, mask),
        coarse(_any_known, mask),
    )


def coarse_radii(signed_radius: Tensor, pixels: Tensor) -> Tensor:
    """`surface_radii` in coarse pixels."""
    return surface_radii(signed_radius, pixels) / 2


def means(values: Tensor) -> Tensor:
    """The mean [..., h, w] of each coarse pixel, of px as for `in_coarse_pixels`."""
    for dim in (-2, -1):
        first, *others = _along(values, dim)
        if len(others) == 1:
            values = (first + others[0]) / 2
        else:
            values = (first + others[1]) / 4 + others[0] / 2
    return values


def surface_radii(signed_radius: Tensor, pixels: Tensor) -> Tensor:
    """Radii [h, w] in px of the surfaces that coarse pixels show.

    `signed_radius`: [2 h, 2 w] px; `pixels`: [C, 2 h, 2 w]; or as for `in_coarse_pixels`.
    """
    radii, counts = _parts(signed_radius)
    steps = radii.detach().amax(0).sub_(radii.detach().amin(0))
    y, x = positions_of(exceeding(steps, _STEEP)).unbind(1)
    radii = radii[:, y, x]
    counts = counts[:, :, 0].expand(-1, len(y))
    light = counts * _parts(pixels.detach().amax(0))[0][:, y, x]
    brightest = light.amax(0)
    lone = brightest > _BRIGHTER * (_total(light) - brightest)
    counts = torch.where(lone, (light == brightest).to(counts), counts)
    return means(signed_radius).index_put((y, x), _majority_radius(radii, counts))


def _known_means(color: Tensor, known: Tensor) -> Tensor:
    """Means of the known px of each coarse px, 0 where none is known; and one more channel of 0."""
    fraction = means(known.to(color.dtype))
    coarse = means(torch.where(known.bool(), color, 0.0)) / torch.where(fraction > 0, fraction, 1.0)
    return torch.cat([coarse, torch.zeros_like(coarse[:1])])


def _known_coarse_radii(signed_radius: Tensor, known: Tensor) -> Tensor:
    """Radii in coarse pixels of the known surfaces of coarse pixels; 0 where no pixel is known."""
    (radii, counts), (shown, _) = map(_parts, (signed_radius, known.to(signed_radius)))
    return _majority_radius(torch.where(shown > 0, radii, 0.0), counts * shown) / 2


def _any_known(known: Tensor) -> Tensor:
    """Whether a pixel of each coarse pixel is known."""
    return means(known.float()) > 0


def _majority_radius(radii: Tensor, fraction: Tensor) -> Tensor:
    """The mean radius [...] in px of the surface that has most of the pixels of a coarse pixel.

    `radii`: [n, ...] px of the pixels; `fraction`: [n, ...], how often each counts.
    """
    minimum = torch.where(fraction > 0, radii, torch.inf).amin(0).detach()
    maximum = torch.where(fraction > 0, radii, -torch.inf).amax(0).detach()
    near = fraction * (radii <= halfway(minimum, maximum))
    larger = torch.where(2 * _total(near) >= _total(fraction), near, fraction - near)
    chosen = torch.where(maximum - minimum > _STEEP, larger, fraction)
    return _total(radii * chosen) / _total(chosen).clamp(min=1)


def _total(values: Tensor) -> Tensor:
    """The sum [...] of values [n, ...], in one order whatever their place in memory."""
    first, *others = values.unbind()
    for value in others:
        first = first + value
    return first


def _parts(px: Tensor) -> tuple[Tensor, Tensor]:
    """The n px of each coarse pixel, [n, ..., h, w], and how often each counts, [n, 1, 1]."""
    rows = _along(px, -2)
    parts = [part for row in rows for part in _along(row, -1)]
    down, across = ([1, 1] if n == 2 else [1, 2, 1] for n in (len(rows), len(parts) // len(rows)))
    counts = px.new_tensor([y * x for y in down for x in across])
    return torch.stack(parts), counts[:, None, None]


def _along(px: Tensor, dim: int) -> list[Tensor]:
    """The two px of each coarse pixel along an axis, or all three of an odd number of px."""
    every = px.movedim(dim, -1)
    n = every.shape[-1] // 2
    parts = [every[..., k : k + 2 * n : 2] for k in range(2 + px.shape[dim] % 2)]
    return [part[..., :n].movedim(-1, dim) for part in parts]


def _px_of(picture: Pixels, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
    """The px of a window of coarse pixels; beyond the frame those on its edge are repeated.

    They are in float32 at least, but for masks.
    """
    spans, missing = [], []
    for (first, end), count in zip((rows, columns), picture.shape[-2:], strict=True):
        wanted = Span(2 * first - count % 2, 2 * max(end, first))
        inside = wanted.within(Span(0, count))
        spans.append(inside)
        missing.append((inside.first - wanted.first, wanted.end - inside.end))
    px = picture[..., slice(*spans[0]), slice(*spans[1])]
    if px.dtype != torch.bool:
        px = px.to(torch.promote_types(px.dtype, torch.float32))
    for dim, (before, after) in zip((-2, -1), missing, strict=True):
        n = px.shape[dim]
        if n and (before or after):
            ends = [px.narrow(dim, 0, 1)] * before, [px.narrow(dim, n - 1, 1)] * after
            px = torch.cat([*ends[0], px, *ends[1]], dim)
    return px


# Radius in px from which on no detail is left; up to there the share that is left falls as a disc
# leaves it of random textures, in the mean.
NO_DETAIL = 2.65
# A half of the lens shifts detail by its gradient times this many radii, and leaves it as a disc of
# this many times the radius does.
_SHIFT = 0.8
# How often the share of detail is squared to give the share of the pixel itself that is copied.
_SQUARINGS = 4
# Allowed overshoot of a pixel, as a share of the range of the coarse pixels around.
_OVERSHOOT = 0.25
# Radii in px up to which detail is not shifted, and from which on it is shifted in full.
_STILL = (2 * SHARP, 2 * SOFT)
# Coarse pixels around a coarse pixel that decide its pixels.
AROUND = 2
# Share of each of the two coarse pixels beside a coarse pixel in a mean, along an axis.
_BESIDE = 1 / 8
# Relative rounding error of a share that is wholly in view.
_ROUNDING = 1e-5
# Least share of detail by which its visible part is divided.
_MINIMUM = 0.05


def left_of_detail(signed_radius: Tensor) -> Tensor:
    """The share [...] of detail that a disc leaves, for radii [...] px: 1 in focus."""
    whole = sent(1 + SHARP**2 / NO_DETAIL**2, signed_radius)
    left = torch.addcmul(whole, signed_radius, signed_radius, value=-1 / NO_DETAIL**2)
    return left.clamp(0, 1).square().square()


def fraction_left(signed_radius: Tensor) -> Tensor:
    """The mean [h, w] of `left_of_detail` in each coarse pixel, for radii [2 h, 2 w] px."""
    return means(left_of_detail(signed_radius))


class Original(NamedTuple):
    """A part of the picture before it is rendered."""

    coarse: Tensor  # [C, h, w], means of its pixels, with coarse pixels around
    fraction: Tensor  # [h, w], `fraction_left` of the same coarse pixels
    pixels: Tensor  # [C, H, W]
    signed_radius: Tensor  # [H, W] px
    # Whether the number of rows, and of columns, of the picture is odd
    odd: tuple[bool, bool] = (False, False)


def with_detail(
    images: Tensor, shown: Tensor, original: Original, part: Box, brightest: float = torch.inf
) -> Tensor:
    """Pixels [k, C, H, W] of the centre view, or of centre, left and right, from coarse ones.

    `images`: [k, C, h, w], the rendered coarse pixels, with coarse pixels around; `shown`: [k, h,
    w], the share of detail as it was rendered: nearer surfaces hide some of it.
    """
    pixels, r, odd = original.pixels, original.signed_radius, original.odd
    maxima = [brightest, *[2 * brightest] * (len(images) - 1)]
    if not float(original.fraction.detach().amax()) > 0:
        px = [doubled(x, part, limit) for x, limit in zip(images, maxima, strict=True)]
        return between(torch.stack(px), odd)
    in_view = [_is_in_view(image, original.fraction) for image in shown]
    if all(in_view) and _is_in_focus(r):
        return pixels.expand(len(images), *pixels.shape)
    # one by one: the rounding of the last numbers of a tensor depends on how many there are
    coarse = zip((*images, original.coarse), (*maxima, torch.inf), strict=True)
    *views, sharp = (between(doubled(x, part, limit), odd) for x, limit in coarse)
    visible = _visible(shown, original.fraction, in_view, part)
    visible = visible if all(in_view) else between(visible, odd)
    blurred, detail = views[0], pixels - sharp
    left = (left_of_detail(r) * visible)[:, None]
    # in full view and in focus the pixel itself, edges too
    copied = left[0].clamp(0, 1)
    for _ in range(_SQUARINGS):
        copied = copied.square()
    centre = torch.addcmul(blurred, left[0], detail).lerp_(pixels, copied)
    centre = within(centre, lesser(blurred, pixels), greater(blurred, pixels))
    if len(views) == 1:
        return centre[None]
    beside = _padded(detail, (1, 1, 0, 0))
    still, r = (r.abs() - _STILL[0]) / (_STILL[1] - _STILL[0]), _SHIFT * r
    moved = r * still.clamp(0, 1) * left_of_detail(r) * visible[0]
    moved = moved * (beside[..., 2:] - beside[..., :-2]) / 2
    halves = torch.stack(views[1:]) - blurred + (left[1:] - left[0]) * detail
    halves = halves + torch.stack([moved, -moved])
    return torch.cat([centre[None], centre + halves])


def _visible(shown: Tensor, fraction: Tensor, in_view: list[bool], part: Box) -> Tensor:
    """The share of the detail of each pixel that no nearer surface hides: [k, H, W] or [k, 1, 1].

    `fraction`: [h, w], the share of detail that the blur leaves.
    """
    if all(in_view):
        return shown.new_ones(len(shown), 1, 1)
    # hidden surfaces show there, too, and have no detail
    left, *visible = (
        smooth(x[None, None], part)[0, 0] for x in (fraction, *lesser(shown, fraction))
    )
    return torch.stack(
        [
            torch.ones_like(left) if whole else 1 - (left - x) / left.clamp(min=_MINIMUM)
            for whole, x in zip(in_view, visible, strict=True)
        ]
    )


def _is_in_view(shown: Tensor, fraction: Tensor) -> bool:
    """Whether no nearer surface hides detail; False if the answer would lose a gradient."""
    if shown.requires_grad or fraction.requires_grad:
        return False
    return float(torch.sub(shown, fraction, alpha=1 - _ROUNDING).amin()) >= 0


def _is_in_focus(signed_radius: Tensor) -> bool:
    """Whether all pixels are in focus; False if a copy would lose the gradient to the radius."""
    return not signed_radius.requires_grad and float(signed_radius.abs().amax()) <= SHARP


def doubled(coarse: Tensor, part: Box, brightest: float = torch.inf) -> Tensor:
    """Pixels [..., 2 h, 2 w] of a part of a picture in coarse pixels.

    The mean of the four pixels of a coarse pixel is the coarse pixel, and polynomials of fourth
    order along a row or a column are kept (Cohen, Daubechies and Feauveau 1992). But pixels do not
    ring: where the coarse pixels around differ by more than the coarse pixel itself, its pixels lie
    within their range.

    `coarse`: [..., h + a, w + b], the part with two rows and columns of coarse pixels around; where
    these lie beyond the frame they are missing, and the last ones are repeated.
    """
    below, beside = (
        whole - first - size
        for whole, first, size in zip(coarse.shape[-2:], part[:2], part[2:], strict=True)
    )
    left, right, above, below = (AROUND - n for n in (part.left, beside, part.top, below))
    coarse = _padded(coarse, (left, right, above, below))
    middle = coarse[..., AROUND:-AROUND, AROUND:-AROUND]
    downwards = _rise(coarse, -2)
    down, bend = downwards[..., AROUND:-AROUND], _rise(downwards, -1)
    across = _rise(coarse[..., AROUND:-AROUND, :], -1)
    minimum, maximum = _limits(coarse[..., 1:-1, 1:-1])
    rise = down.abs() + across.abs() + bend.abs()
    kept, differ = lesser(maximum - middle, middle - minimum), maximum - minimum
    beyond = positive(lesser(differ, middle.abs() - differ))
    bound = torch.add(kept, beyond, alpha=_OVERSHOOT)
    if brightest < torch.inf:
        bound = lesser(bound, positive(brightest - middle))
    fraction = bound / greater(rise, bound).clamp(min=torch.finfo(rise.dtype).tiny)
    if fraction.requires_grad:  # in one colour nothing rises, but for rounding
        fraction = torch.where(tied(rise, 0.0), 1.0, fraction)
    down, across, bend = down * fraction, across * fraction, bend * fraction
    *others, rows, columns = middle.shape
    px = coarse.new_empty((*others, 2 * rows, 2 * columns))
    for y, above_it in ((0, middle - down), (1, middle + down)):
        slope = across + (bend if y else -bend)
        px[..., y::2, ::2] = above_it - slope
        px[..., y::2, 1::2] = above_it + slope
    return px


def _rise(coarse: Tensor, dim: int) -> Tensor:
    """Half the difference of the pixels of each coarse pixel along an axis, borders left out."""
    n = coarse.shape[dim] - 2 * AROUND
    first, second, _, fourth, fifth = (coarse.narrow(dim, k, n) for k in range(5))
    return (fourth - second).mul_(22 / 128).add_(first - fifth, alpha=3 / 128)


def _limits(coarse: Tensor) -> tuple[Tensor, Tensor]:
    """Least and greatest of the three by three coarse pixels around each, borders left out."""
    minimum, maximum = coarse, coarse
    for dim in (-2, -1):
        n = coarse.shape[dim] - 2
        minimum, maximum = (
            pick(pick(x.narrow(dim, 0, n), x.narrow(dim, 1, n)), x.narrow(dim, 2, n))
            for pick, x in ((lesser, minimum), (greater, maximum))
        )
    return minimum, maximum


def between(px: Tensor, odd: tuple[bool, bool]) -> Tensor:
    """Px [..., H, W] between those of coarse pixels in whose middle a pixel lies: one less."""
    for dim in (-2, -1):
        if odd[dim]:
            n = px.shape[dim] - 1
            px = (px.narrow(dim, 0, n) + px.narrow(dim, 1, n)) / 2
    return px


def spread(coarse: Tensor) -> Tensor:
    """Means [..., h, w] of each coarse px with the two on each side that its pixels depend on."""
    for dim in (-2, -1, -2, -1):
        n = coarse.shape[dim]
        rim = [coarse.narrow(dim, 0, 1), coarse, coarse.narrow(dim, n - 1, 1)]
        around = torch.cat(rim, dim)
        beside = around.narrow(dim, 0, n) + around.narrow(dim, 2, n) - 2 * coarse
        coarse = torch.add(coarse, beside, alpha=_BESIDE)
    return coarse


def smooth(coarse: Tensor, part: Box) -> Tensor:
    """Pixels [N, C, 2 h, 2 w] of coarse pixels [N, C, ...], within the range of those beside."""
    minimum, maximum = range_of(coarse.detach()).tolist()
    if minimum == maximum and not coarse.requires_grad:
        return coarse[..., :1, :1].expand(*coarse.shape[:2], 2 * part.height, 2 * part.width)
    px = interpolate(coarse, scale_factor=2, mode="bilinear", align_corners=False)
    return Box(*(2 * n for n in part)).of(px)


def _padded(values: Tensor, by: tuple[int, int, int, int]) -> Tensor:
    """Values [..., h, w] with the first and last repeated so often: left, right, above, below."""
    if not any(by):
        return values
    *others, h, w = values.shape
    padded = pad(values.reshape(1, -1, h, w), by, mode="replicate")
    return padded.reshape(*others, *padded.shape[-2:])


_PX = 2  # pixels on a side of a coarse pixel
# Value of the channel of detail where a coarse pixel has all of it, as a share of the limit of
# highlights: so little that it does not distinguish surfaces.
_UNIT = 2.0**-12
# (height, width) in coarse pixels of tiles that are enlarged.
_TILE = (32, 512)
# Coarse pixels around a tile that decide its pixels.
_AROUND = AROUND + 1


class Enlarging:
    """A picture in coarse pixels to be rendered, and its enlargement afterwards.

    Attributes:
        coarse: [C + 1, h, w], the coarse pixels to render: colours, and the share of detail.
    """

    def __init__(
        self, frame: SharedFrame, image: Pixels, pixels: Pixels, signed_radius: Pixels
    ) -> None:
        """Add the channel of detail to the coarse pixels.

        `image`: [C, h, w] coarse pixels; `pixels`: [C, H, W] px of the picture; `signed_radius`:
        [H, W] px of the picture.
        """
        self._frame, self._threads = frame, frame.settings.threads
        height, width = self._size = signed_radius.shape[-2], signed_radius.shape[-1]
        self._odd = height % 2 == 1, width % 2 == 1
        limit = frame.content.limit
        # less than no light in a picture that has none
        unit = self._unit = _UNIT * limit if limit > 0 else -1.0
        self._in_px = (pixels, signed_radius)
        ends = [(band.amin((-2, -1)), band.amax((-2, -1))) for band in banded(pixels)]
        lows, highs = (torch.stack(each).detach() for each in zip(*ends, strict=True))
        channels = [*zip(lows.amin(0).tolist(), highs.amax(0).tolist(), strict=True)]
        self._minimum = min(0.0, *(darkest for darkest, _ in channels))
        self._maximum = max(brightest for _, brightest in channels)
        self._channels = [
            (min(least), max(greatest))
            for least, greatest in (
                zip(*each, strict=True)
                for each in zip(channels, frame.content.channels, strict=False)
            )
        ]

        def merged(px: Tensor, radius: Tensor) -> Tensor:
            return torch.cat([means(px), unit * fraction_left(radius)[None]])

        if isinstance(image, Tensor):
            fraction = in_coarse_pixels(fraction_left, signed_radius).at_once(self._threads)
            self.coarse: Pixels = torch.cat([image, unit * fraction[None]])
        else:
            self.coarse = in_coarse_pixels(merged, *self._in_px)

    def enlarged(self, parts: Iterator[Views]) -> Iterator[Views]:
        """Tiles in pixels, from regions in coarse pixels; the last rows wait for those below."""
        done, kept = 0, list[list[Views]]()
        counts: dict[str, int] = {}
        height, width = self._frame.size
        for row in in_rows(parts):
            counts = added([counts, *map(self._counts, row)])
            coarse = joined([*kept, row])
            end = coarse.box.sides[0].end
            ready = end if end == height else end - _AROUND
            tiles = [
                Box(top, left, min(_TILE[0], ready - top), min(_TILE[1], width - left))
                for top in range(done, ready, _TILE[0])
                for left in range(0, width, _TILE[1])
            ]
            tile = recomputed(partial(self._tile, coarse))
            for part in threaded(tile, tiles, self._threads):
                yield part._replace(stats=added([counts, part.stats]))
                counts = {}
            first = max(ready - _AROUND, coarse.box.top)
            done, kept = ready, [[coarse.within(Box(first, 0, end - first, width))]]

    def _tile(self, coarse: Views, tile: Box) -> Views:
        """A tile of coarse pixels in pixels, which counts those that are clamped."""
        wide = tile.grown(1, self._frame.box)  # for gradients of detail
        around = wide.grown(AROUND, self._frame.box)
        part, rendered = wide.seen_from(around), coarse.within(around)
        images = torch.stack(list(rendered.images))
        sharp = around.of(self.coarse).to(images.dtype)
        # between the middles of the first and the last coarse pixels if their number is odd
        top, left, height, width = (_PX * n for n in wide)
        wide_px = Box(top, left, height - self._odd[0], width - self._odd[1])
        px, radius = (wide_px.of(x).to(images.dtype) for x in self._in_px)
        original = Original(sharp[:-1], sharp[-1] / self._unit, px, radius, self._odd)
        images = with_detail(
            images[:, :-1], images[:, -1] / self._unit, original, part, self._maximum
        )
        content, counts, box = self._frame.content, dict[str, int](), self._px(tile)
        inner = box.seen_from(wide_px)
        if len(images) > 1:
            counts |= count_negative(inner.of(images[1:]), content.limit, self._minimum)
        limits = ColorRange.of(self._channels, images[0], self._minimum)
        centre = limits.bounded(images[0])
        images = torch.cat([centre[None], images[1:]])
        if len(images) > 1:
            fraction = self._frame.division.left_fraction
            pair = pair_of(*images, minimum=self._minimum, fraction=fraction)
            images = torch.cat([images[:1], limits.bounded_pair(pair, centre, fraction)])
        trust = between(smooth(spread(rendered.trust[None]), part)[0], self._odd)
        return Views(list(inner.of(images)), inner.of(trust), counts, box)

    def _px(self, coarse: Box) -> Box:
        """The pixels of a rectangle of coarse pixels."""
        return Box(*(_PX * n for n in coarse)).grown(0, Box(0, 0, *self._size))

    def _counts(self, part: Views) -> dict[str, int]:
        """The counts of a part in coarse pixels, with pixels counted in pixels."""
        pixels = self._px(part.box).area
        copied = part.stats["pixels_copied"] * pixels // part.box.area
        counts = {**part.stats, "pixels": pixels, "pixels_copied": copied}
        counts.pop("pixels_clamped", None)  # of coarse pixels
        return counts

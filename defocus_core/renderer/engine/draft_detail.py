"""Drafts: the detail of pixels in focus, which half size loses.

Coarse pixels become pixels again so that the mean of two by two pixels is their coarse pixel. To
these pixels the detail is added, the difference between the picture and its own coarse pixels, as
far as the blur leaves it and no nearer surface hides it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad

from defocus_core.renderer.engine.draft_coarse import means
from defocus_core.renderer.layers.slice_radii import SHARP, SOFT
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.neighbourhoods import range_of
from defocus_core.tensors.ties import greater, lesser, positive, tied, within

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

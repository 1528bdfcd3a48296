"""Drafts: the detail of what is in focus, which half size loses.

Cells become pixels again so that means of two by two stay what they are. To these is added what the
given picture has beyond its own cells, as far as its blur leaves it and nothing stands before it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad

from defocus_core.engine.draft_cells import means
from defocus_core.images.box import Box
from defocus_core.images.neighbourhoods import ends_of
from defocus_core.layers.ladder import SHARP, SOFT

# Radius in px from which on nothing is left of detail: until then it falls as the mean over random
# textures does of what a disc leaves of it.
NONE = 2.65
# What a half of the lens shifts of detail is its slope times so many radii, and is left as that of
# a radius this many times as large.
_SHIFT = 0.8
# How often the share that is left is squared: by that a pixel is as it was.
_AS_IT_WAS = 4
# By how much of what the cells around differ a pixel may lie beyond them.
_MOST = 0.25
# Radii in px up to which cells are in focus, and beyond which they are shifted as they should be.
_STILL = (2 * SHARP, 2 * SOFT)
# Cells around one that decide what its pixels are.
AROUND = 2
# What rounding leaves of a share that is shown whole.
_ROUNDING = 1e-5
# Shares of a cell below which it is hardly told how much of them is in view.
_LEAST = 0.05


def left_of_detail(signed_radius: Tensor) -> Tensor:
    """The share of detail that a disc leaves, of radii [...] px: 1 in focus."""
    whole = signed_radius.new_tensor(1 + SHARP**2 / NONE**2)
    left = torch.addcmul(whole, signed_radius, signed_radius, value=-1 / NONE**2)
    return left.clamp(0, 1).square().square()


def share_left(signed_radius: Tensor) -> Tensor:
    """Means of that in cells [h, w], of px [2 h, 2 w]."""
    return means(left_of_detail(signed_radius))


class Given(NamedTuple):
    """A part of the picture that was rendered.

    Attributes:
        cells: [C, h, w], means of its px, with some that lie around.
        share: [h, w], from `share_left`, of the same.
        pixels: [C, H, W] px.
        signed_radius: [H, W] px.
    """

    cells: Tensor
    share: Tensor
    pixels: Tensor
    signed_radius: Tensor


def with_detail(images: Tensor, shown: Tensor, given: Given, part: Box) -> Tensor:
    """Px [k, C, H, W] of the centre, or centre, left and right, of rendered cells.

    Args:
        images: [k, C, h, w], the cells, with some that lie around.
        shown: [k, h, w], what was rendered where the cells had their share.
        given: What they were rendered from.
        part: As for `doubled`.
    """
    height, width = given.signed_radius.shape
    if not float(given.share.detach().amax()) > 0:
        return doubled(images, part)[..., :height, :width]
    in_view = [_is_in_view(image, given) for image in shown]
    if all(in_view) and _is_in_focus(given):
        return given.pixels.expand(len(images), *given.pixels.shape)
    # one by one: the rounding of the last numbers of a tensor depends on how many there are
    *found, own = (doubled(x, part)[..., :height, :width] for x in (*images, given.cells))
    seen = shown.new_ones(len(images), 1, 1)
    if not all(in_view):  # hidden surfaces show there, too, and have no detail
        share, *visible = (
            smooth(x[None, None], part)[0, 0, :height, :width]
            for x in (given.share, *torch.minimum(shown, given.share))
        )
        seen = torch.stack(
            [
                torch.ones_like(share) if whole else 1 - (share - x) / share.clamp(min=_LEAST)
                for whole, x in zip(in_view, visible, strict=True)
            ]
        )
    pixels, r, blurred = given.pixels, given.signed_radius, found[0]
    detail = pixels - own
    left = (left_of_detail(r) * seen)[:, None]
    # in full view and in focus a pixel is as it was, edges too
    given_back = left[0].clamp(0, 1)
    for _ in range(_AS_IT_WAS):
        given_back = given_back.square()
    whole = torch.addcmul(blurred, left[0], detail).lerp_(pixels, given_back)
    whole.clamp_(torch.minimum(blurred, pixels), torch.maximum(blurred, pixels))
    if len(found) == 1:
        return whole[None]
    beside = _padded(detail, (1, 1, 0, 0))
    still, r = (r.abs() - _STILL[0]) / (_STILL[1] - _STILL[0]), _SHIFT * r
    moved = r * still.clamp(0, 1) * left_of_detail(r) * seen[0]
    moved = moved * (beside[..., 2:] - beside[..., :-2]) / 2
    halves = torch.stack(found[1:]) - blurred + (left[1:] - left[0]) * detail
    halves = halves + torch.stack([moved, -moved])
    return torch.cat([whole[None], whole + halves])


def _is_in_view(shown: Tensor, given: Given) -> bool:
    """Whether nothing stands before what has detail; that has no slope in what is shown."""
    if shown.requires_grad or given.share.requires_grad:
        return False
    return float(torch.sub(shown, given.share, alpha=1 - _ROUNDING).amin()) >= 0


def _is_in_focus(given: Given) -> bool:
    """Whether all is in focus; a copy has no slope in the radius."""
    r = given.signed_radius
    return not r.requires_grad and float(r.abs().amax()) <= SHARP


def doubled(cells: Tensor, part: Box) -> Tensor:
    """Px [..., 2 h, 2 w] of a part of some cells.

    The mean of four px is their cell, and polynomials of fourth order along a row or a column stay
    what they are (Cohen, Daubechies and Feauveau 1992) as far as they do not ring: where what lies
    around a cell differs by more than the cell has, its px lie between that.

    Args:
        cells: [..., h + a, w + b].
        part: Of size h, w; of the two rows and columns of cells around it those may be missing that
            lie beyond the border of a frame: its last ones are repeated.
    """
    below, beside = (
        whole - first - size
        for whole, first, size in zip(cells.shape[-2:], part[:2], part[2:], strict=True)
    )
    missing = (part.left, beside, part.top, below)
    left, right, above, below = (AROUND - there for there in missing)
    cells = _padded(cells, (left, right, above, below))
    middle = cells[..., AROUND:-AROUND, AROUND:-AROUND]
    downwards = _rise(cells, -2)
    down, bend = downwards[..., AROUND:-AROUND], _rise(downwards, -1)
    across = _rise(cells[..., AROUND:-AROUND, :], -1)
    least, most = _ends(cells[..., 1:-1, 1:-1])
    rise = down.abs() + across.abs() + bend.abs()
    kept, differ = torch.minimum(most - middle, middle - least), most - least
    beyond = torch.minimum(differ, middle.abs() - differ).clamp(min=0)
    bound = torch.add(kept, beyond, alpha=_MOST)
    share = bound / torch.maximum(rise, bound).clamp(min=torch.finfo(rise.dtype).tiny)
    down, across, bend = down * share, across * share, bend * share
    *others, rows, columns = middle.shape
    px = cells.new_empty((*others, 2 * rows, 2 * columns))
    for y, above_it in ((0, middle - down), (1, middle + down)):
        slope = across + (bend if y else -bend)
        px[..., y::2, ::2] = above_it - slope
        px[..., y::2, 1::2] = above_it + slope
    return px


def _rise(cells: Tensor, dim: int) -> Tensor:
    """Half of what pixels of a cell differ along one axis, of cells with all that lie around."""
    n = cells.shape[dim] - 2 * AROUND
    first, second, _, fourth, fifth = (cells.narrow(dim, k, n) for k in range(5))
    return (fourth - second).mul_(22 / 128).add_(first - fifth, alpha=3 / 128)


def _ends(cells: Tensor) -> tuple[Tensor, Tensor]:
    """The least and the greatest of three by three cells [..., h, w], without those at borders."""
    least, most = cells, cells
    for dim in (-2, -1):
        n = cells.shape[dim] - 2
        least, most = (
            pick(pick(x.narrow(dim, 0, n), x.narrow(dim, 1, n)), x.narrow(dim, 2, n))
            for pick, x in ((torch.minimum, least), (torch.maximum, most))
        )
    return least, most


def smooth(cells: Tensor, part: Box) -> Tensor:
    """Px [N, C, 2 h, 2 w] of a part of cells [N, C, ...], never beyond those beside them."""
    least, most = ends_of(cells.detach()).tolist()
    if least == most and not cells.requires_grad:
        return cells[..., :1, :1].expand(*cells.shape[:2], 2 * part.height, 2 * part.width)
    px = interpolate(cells, scale_factor=2, mode="bilinear", align_corners=False)
    return Box(*(2 * n for n in part)).of(px)


def _padded(values: Tensor, by: tuple[int, int, int, int]) -> Tensor:
    """Values [..., h, w] with the first and last ones repeated: left, right, above, below."""
    if not any(by):
        return values
    *others, h, w = values.shape
    padded = pad(values.reshape(1, -1, h, w), by, mode="replicate")
    return padded.reshape(*others, *padded.shape[-2:])

"""What a picture rendered at half of its size lacks: the detail of what is in focus.

Cells become pixels again so that means of two by two stay what they are. To these is added what the
given picture has beyond its own cells, as far as its blur leaves it and nothing stands before it.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad

from defocus_core.half_size import means
from defocus_core.slicing import SHARP, SOFT

# Radius in px from which on nothing is left of detail: until then it falls as the mean over random
# textures does of what a disc leaves of it.
NONE = 2.65
# What a half of the lens shifts of detail is its slope times so many radii, and is left as that of
# a radius this many times as large.
_SHIFT = 0.8
# Power of the share that is left by which a pixel is as it was.
_AS_IT_WAS = 16
# By how much of what the cells around differ a pixel may lie beyond them.
_MOST = 0.25
# Radii in px up to which cells are in focus, and beyond which they are shifted as they should be.
_STILL = (2 * SHARP, 2 * SOFT)
# Cells above and below those that become pixels.
AROUND = 2
# Least share of a cell that can be told to be in focus.
_LEAST = 0.05


def left_of_detail(signed_radius: Tensor) -> Tensor:
    """The share of detail that a disc leaves, of radii [...] px: 1 in focus."""
    beyond = (signed_radius.square() - SHARP**2).clamp(min=0)
    return (1 - beyond / NONE**2).clamp(min=0).square().square()


def share_left(signed_radius: Tensor) -> Tensor:
    """Means of that in cells [h, w], of px [2 h, 2 w]."""
    return means(left_of_detail(signed_radius))


class Given(NamedTuple):
    """Rows of the picture that was rendered.

    Attributes:
        cells: [C, n, w], means of its px.
        share: [n, w], from `share_left`.
        pixels: [C, h, w] px.
        signed_radius: [h, w] px.
    """

    cells: Tensor
    share: Tensor
    pixels: Tensor
    signed_radius: Tensor


def with_detail(images: Tensor, shown: Tensor, given: Given, above: int, below: int) -> Tensor:
    """Px [k, C, h, w] of the centre, or centre, left and right, of rendered cells.

    Args:
        images: [k, C, n, w], the cells.
        shown: [k, n, w], what was rendered where the cells had their share.
        given: What they were rendered from.
        above: As for `doubled`.
        below: The same.
    """
    height, width = given.signed_radius.shape
    found = doubled(images, above, below)[..., :height, :width]
    columns = torch.nonzero(given.share.detach().amax(0)).flatten()
    if not len(columns):
        return found
    first, last = max(int(columns[0]) - AROUND, 0), int(columns[-1]) + 1 + AROUND
    few, px = slice(first, last), slice(2 * first, 2 * last)
    pixels, r, blurred = given.pixels[..., px], given.signed_radius[..., px], found[..., px]
    h, w = r.shape
    visible = torch.cat([given.share[None], shown])[..., few]
    visible = smooth(visible, above, below)[..., :h, :w]
    seen = visible[1:] / visible[:1].clamp(min=_LEAST)
    detail = pixels - doubled(given.cells[..., few], above, below)[..., :h, :w]
    left = (left_of_detail(r) * seen)[:, None]
    added = left * detail
    # in full view and in focus a pixel is as it was, edges too
    whole = torch.lerp(blurred[0] + added[0], pixels, left[0].clamp(0, 1) ** _AS_IT_WAS)
    whole = whole.clamp(torch.minimum(blurred[0], pixels), torch.maximum(blurred[0], pixels))
    added = added + (whole - blurred[0] - added[0])
    if len(found) > 1:
        beside = _padded(detail, (1, 1, 0, 0))
        still, r = (r.abs() - _STILL[0]) / (_STILL[1] - _STILL[0]), _SHIFT * r
        moved = (
            r
            * still.clamp(0, 1)
            * left_of_detail(r)
            * seen[0]
            * (beside[..., 2:] - beside[..., :-2])
            / 2
        )
        added = added + torch.stack([torch.zeros_like(moved), moved, -moved])
    shown = torch.cat([whole[None], blurred[1:] + added[1:]])
    return torch.cat([found[..., : px.start], shown, found[..., px.stop :]], -1)


def doubled(cells: Tensor, above: int, below: int) -> Tensor:
    """Px [..., 2 n, 2 w] of cells [..., above + n + below, w].

    The mean of four px is their cell, and polynomials of fourth order along a row or a column stay
    what they are (Cohen, Daubechies and Feauveau 1992), unless they rise so fast that light would
    become negative.

    Args:
        cells: Rows of cells of a frame, with all columns.
        above: How many of the rows lie above those that are wanted, 2 at most: the first one is
            repeated for those that the frame does not have.
        below: The same below.
    """
    cells = _padded(cells, (AROUND, AROUND, AROUND - above, AROUND - below))
    middle = cells[..., AROUND:-AROUND, AROUND:-AROUND]
    down = _rise(cells[..., AROUND:-AROUND], -2)
    across = _rise(cells[..., AROUND:-AROUND, :], -1)
    bend = _rise(_rise(cells, -2), -1)
    least, most = _ends(cells[..., 1:-1, 1:-1])
    rise = down.abs() + across.abs() + bend.abs()
    kept = torch.minimum(most - middle, middle - least)
    beyond = torch.minimum(most - least, middle.abs() - (most - least)).clamp(min=0)
    bound = kept + beyond * _MOST
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


def smooth(cells: Tensor, above: int, below: int) -> Tensor:
    """Rows [N, 2 n, 2 w] px of cells [N, above + n + below, w], never beyond those beside them."""
    px = interpolate(cells[None], scale_factor=2, mode="bilinear", align_corners=False)[0]
    return px[:, 2 * above : px.shape[1] - 2 * below]


def _padded(values: Tensor, by: tuple[int, int, int, int]) -> Tensor:
    """Values [..., h, w] with the first and last ones repeated: left, right, above, below."""
    if not any(by):
        return values
    *others, h, w = values.shape
    padded = pad(values.reshape(1, -1, h, w), by, mode="replicate")
    return padded.reshape(*others, *padded.shape[-2:])

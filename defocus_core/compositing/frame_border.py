"""The share of the aperture that sees the frame rather than past its border.

Beyond the frame a surface goes on, but has no pixels. The share of the aperture that sees it there
must not be filled by surfaces behind it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.images.box import Box
from defocus_core.optics.aperture import Aperture, Part

# Up to a radius of _FROM px a pixel sees the frame alone; from _TO px on, the share that geometry
# gives. Between them the share is smooth, for gradients of depth and lens pass through it.
_FROM, _TO = 1.5, 2.5
# Least share: a disc much larger than the frame would divide by nearly 0.
_LEAST_SHARE = 0.01
# Number of intervals of u in which shares are linear.
_STEPS = 1024


def share_observed(covered: Tensor, expected: Tensor, box: Box, size: tuple[int, int]) -> Tensor:
    """The share of parts of the aperture [m, h, w] that looks at a frame.

    It is the expected share; beside a border, where small radii have no expected share, at most the
    coverage.

    Args:
        covered: [m, h, w], coverage of the parts.
        expected: [m, h, w], from `share_in_frame`.
        box: The place of these pixels in the frame.
        size: (height, width) of the frame.
    """
    down, across = (
        torch.minimum(at, length - 1 - at)
        for at, length in zip(
            (torch.arange(s.first, s.end, device=covered.device) for s in box.sides),
            size,
            strict=True,
        )
    )
    beside = torch.minimum(down[:, None], across) < _TO
    return torch.where(beside, torch.minimum(covered, expected), expected)


def share_in_frame(
    signed_radius: Tensor,
    box: Box,
    size: tuple[int, int],
    farthest: int,
    aperture: Aperture,
    parts: list[Part],
) -> Tensor:
    """The share of parts of the aperture that sees pixels' own surfaces within the frame.

    Lens point u shows pixel q at q + r u: at x it sees x - r u.

    Args:
        signed_radius: [h, w] px of the pixels.
        box: The place of these pixels in the frame.
        size: (height, width) of the frame.
        farthest: Greatest blur radius in px.
        aperture: The pupil; a gaussian one counts as evenly lit.
        parts: M parts of the pupil.

    Returns:
        [M, 1, h, w] in [0.01, 1].
    """
    borders = _borders(size, farthest)
    share = signed_radius.new_ones(len(parts), *signed_radius.shape)
    for border in borders:
        _without_what_passes(share, signed_radius, box, border, aperture, parts)
    row, column = _where_two_are_passed(signed_radius.detach(), box, borders)
    if len(row):
        index = row * box.width + column
        r = signed_radius.flatten().index_select(0, index)
        at = (row.to(r) + (box.top + 0.5), column.to(r) + (box.left + 0.5))
        share.view(len(parts), -1).index_copy_(1, index, _at_corners(r, at, size, aperture, parts))
    return share.clamp_(min=_LEAST_SHARE)[:, None]


class _Border(NamedTuple):
    """A border of a frame.

    Attributes:
        dim: The axis that crosses it: 0 for the upper and the lower border.
        at: Its place on this axis in px from the first corner of the frame.
        last: Whether it is the lower or the right border.
        strip: Pixels whose light may pass it.
    """

    dim: int
    at: int
    last: bool
    strip: Box


def _borders(size: tuple[int, int], farthest: int) -> list[_Border]:
    """The four borders of a frame whose blur radius is at most `farthest` px."""
    (H, W), deep = size, farthest + 1
    return [
        _Border(0, 0, False, Box(0, 0, min(deep, H), W)),
        _Border(0, H, True, Box(max(H - deep, 0), 0, min(deep, H), W)),
        _Border(1, 0, False, Box(0, 0, H, min(deep, W))),
        _Border(1, W, True, Box(0, max(W - deep, 0), H, min(deep, W))),
    ]


def _without_what_passes(
    share: Tensor,
    signed_radius: Tensor,
    box: Box,
    border: _Border,
    aperture: Aperture,
    parts: list[Part],
) -> None:
    """Take off the share [M, h, w] of light that passes a border."""
    strip = border.strip.grown(0, box)
    if min(strip[2:]) <= 0:
        return
    here = strip.seen_from(box)
    r = here.of(signed_radius)
    size, away = r.abs(), _away(border, strip, r)
    # smaller radii have weight 0
    u = (away / size.clamp(min=_FROM).copysign(r)).clamp_(-1, 1)
    weight = _weight(size)
    for m, part in enumerate(parts):
        here.of(share[m]).sub_(_past(aperture, part, border.dim, u) * weight)


def _away(border: _Border, strip: Box, like: Tensor) -> Tensor:
    """How many px behind a border pixels of a strip are, [h, 1] or [w]; less than 0 before it."""
    side = strip.sides[border.dim]
    away = torch.arange(side.first, side.end, device=like.device).to(like) + (0.5 - border.at)
    return away[:, None] if border.dim == 0 else away


def _where_two_are_passed(
    signed_radius: Tensor, box: Box, borders: list[_Border]
) -> tuple[Tensor, Tensor]:
    """Rows and columns [n] of pixels whose light passes borders along both axes."""
    corners = []
    for level in (border for border in borders if border.dim == 0):
        for upright in (border for border in borders if border.dim == 1):
            corner = level.strip.grown(0, box).grown(0, upright.strip)
            if min(corner[2:]) <= 0:
                continue
            here = corner.seen_from(box)
            size = here.of(signed_radius).abs()
            passed = [
                size > _away(border, corner, size).abs().clamp(min=_FROM)
                for border in (level, upright)
            ]
            at = torch.nonzero(passed[0] & passed[1])
            corners.append(at + at.new_tensor(here[:2]))
    if not corners:
        none = torch.zeros(0, dtype=torch.long, device=signed_radius.device)
        return none, none
    row, column = torch.cat(corners).unbind(1)
    return row, column


def _at_corners(
    r: Tensor,
    at: tuple[Tensor, Tensor],
    size: tuple[int, int],
    aperture: Aperture,
    parts: list[Part],
) -> Tensor:
    """The share [M, n] for n radii in px at rows and columns counted from the frame's corner."""
    down, across = (
        (torch.stack([place, place - length], -1) / r[:, None]).sort(-1).values.clamp(-1, 1)
        for place, length in zip(at, size, strict=True)
    )
    within = [aperture.share_between(part, across, down).to(r.dtype) for part in parts]
    return 1 - _weight(r.abs()) * (1 - torch.stack(within))


def _weight(size: Tensor) -> Tensor:
    """The weight [...] in [0, 1] of the geometric share, for radii in px."""
    t = (size - _FROM).div_(_TO - _FROM).clamp(0, 1)
    return t * t * (3 - 2 * t)


def _past(aperture: Aperture, part: Part, dim: int, u: Tensor) -> Tensor:
    """The share of a part that lies farther out than a coordinate u.x (dim 1) or u.y (dim 0) [...].

    Farther out is below u where u is negative, and above u elsewhere.
    """
    starts, slopes = _shares(aperture, part, dim).to(u).unbind()
    place = (u + 1).mul_(_STEPS / 2)
    lower = place.detach().floor().clamp_(max=_STEPS - 1)
    first = lower.int().flatten()
    start, slope = (of.index_select(0, first).view_as(u) for of in (starts, slopes))
    return torch.addcmul(start, place - lower, slope)


@lru_cache(maxsize=256)
def _shares(aperture: Aperture, part: Part, dim: int) -> Tensor:
    """The values of `_past` at the lower ends of `_STEPS` even intervals, and its slopes."""
    with torch.inference_mode(False):  # it is cached for calls that need gradients, too
        ends = torch.linspace(-1, 1, _STEPS + 1, dtype=torch.float64)
        up_to = torch.stack([torch.full_like(ends, -1), ends], -1)
        whole = torch.tensor([-1.0, 1.0], dtype=torch.float64).expand_as(up_to)
        below = aperture.share_between(part, *((up_to, whole) if dim == 1 else (whole, up_to)))
        sign = torch.ones(_STEPS, dtype=torch.float64)
        sign[_STEPS // 2 :] = -1  # above 0 the share above u counts
        return torch.stack(
            [(below[:-1] * sign).where(sign > 0, 1 - below[:-1]), below.diff() * sign]
        )

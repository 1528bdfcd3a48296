"""Anti-aliased depth made hard again: pixels on edges hold averages of both surfaces.

Who filters depth like colours, or resizes it, writes depths at which no surface is. Pixels would be
drawn with radii between those of both surfaces; and as most averages of distance have nearly the
radius of the farther one, near surfaces would lose a pixel all around. Each average is given to
the surface it is closer to, again and again (Kramer and Bruckner 1975). That is compared as what
was averaged, distance or disparity: as there are as many averages on either side of an edge, they
lie in the middle of it in the mean.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from defocus_core.images.neighbourhoods import extreme_around, halfway, squares_around, steps_beside
from defocus_core.images.sparse_masks import places_of

# Range of radius in px, within 3 px of each other, that matters.
_MATTERS = 1.013
# Px around an edge in which both surfaces are seen, and rounds in which averages become theirs.
_BESIDE, _ROUNDS = 3, 2
# A step that goes on by as much of itself is a slope: its pixels are no averages.
_SLOPE = 0.4013
# The share of the range over 7 px that 3 of them have at least on an edge: on a slope they have a
# third. On a wide edge the share of the range over 5 px, beside a bend: a pixel that is so far off
# the middle of the range over 3 px, as a share of this.
_ABRUPT, _WIDE, _BENT = 0.3613, 0.2513, 0.3013
# To tell such depth: the first share above, between which places on an edge a pixel is an average,
# and how level the pixels beside a hard step are.
_SURELY, _AVERAGE, _LEVEL = 0.5, 0.1, 0.1
# Every how many rows and columns from either end are looked at for that; how many averages there
# are at least, for each hard step, and for each pixel on a wide edge.
EVERY, _LEAST, _EACH, _WIDER = 16, 8, 2, 0.25
# Px of radius from that of infinity within which all is as far.
_INFINITE = 2.0**-12
# Px around a pixel that decide what it becomes.
AROUND = _BESIDE + 1 + 2 * _ROUNDS


def averages(
    signed_radius: Tensor, rows: list[int], columns: list[int], infinity: float | None
) -> Tensor:
    """What some rows and columns of radii [H, W] px tell: [2, 4], of disparity and of distance.

    How many pixels of narrow edges are averages, the sum of their places on these from 0 to 1, how
    many pixels are on wide edges, and how many hard steps there are.

    Args:
        signed_radius: [H, W] px.
        rows: The numbers of those that are looked at, one in EVERY / 2.
        columns: The same.
        infinity: Signed radius in px of what is infinitely far; None if that is not known.
    """
    r = signed_radius.detach()
    across, down = (
        r.index_select(dim, torch.tensor(some, device=r.device))
        for dim, some in enumerate((rows, columns))
    )
    return _along(across, infinity) + _along(down.mT.contiguous(), infinity)


def averaged_from(found: Tensor, infinity: float | None, soft: int) -> float | None:
    """Of what the depth of a frame holds averages.

    Args:
        found: [2, 4], the sum of its `averages`.
        infinity: As for them.
        soft: How many pixels of it lie on edges that are several px wide.

    Returns:
        `infinity` if of distance, math.inf if of disparity, None if edges are mostly hard or soft.
    """
    most, _, wide, _ = max(found.tolist())
    if most <= max(_WIDER * wide, _LEAST, 4 * soft / EVERY):
        return None
    mostly = [
        (abs(place / count - 0.5), of)
        for (count, place, _, hard), of in zip(found.tolist(), (math.inf, infinity), strict=True)
        if count > _EACH * hard
    ]
    return min(mostly, key=lambda one: one[0])[1] if mostly else None


def without_averages(signed_radius: Tensor, infinity: float) -> Tensor:
    """Radii [H, W] px of which those of averages are those of surfaces beside them.

    Args:
        signed_radius: [H, W] px.
        infinity: From `averaged_from`.
    """
    radii = signed_radius.detach()
    at = places_of(_edges(radii, infinity))
    if not len(at):
        return signed_radius
    H, W = radii.shape
    around, index = squares_around(at, (H, W), 2), at[:, 0] * W + at[:, 1]
    next_to = around[:, 1:-1, 1:-1].flatten(1)
    values = _as_averaged(radii, infinity).flatten()
    source = torch.arange(H * W, device=at.device)
    for _ in range(_ROUNDS):
        own, least, most = values[index], *torch.aminmax(values[around.flatten(1)], dim=1)
        beside = values[next_to]
        (near, first), (far, last) = beside.min(1), beside.max(1)
        is_near = own <= halfway(near, far)
        step = torch.where(is_near, own - near, far - own)
        further = torch.where(is_near, near - least, most - far)
        place = next_to.gather(1, torch.where(is_near, first, last)[:, None])[:, 0]
        place = torch.where(further > _SLOPE * step, index, place)
        values = values.index_copy(0, index, values[place])
        source = source.index_copy(0, index, source[place])
    taken = signed_radius.flatten()
    return taken.index_copy(0, index, taken[source[index]]).reshape(H, W)


def _as_averaged(radii: Tensor, infinity: float) -> Tensor:
    """What is proportional to disparity, or to distance if that of infinity is finite."""
    if math.isinf(infinity):
        return radii
    return (infinity - radii).clamp(min=_INFINITE).reciprocal()


def _as_radii(values: Tensor, infinity: float) -> Tensor:
    """The radii in px of which something is `_as_averaged`."""
    return values if math.isinf(infinity) else infinity - values.reciprocal()


def _edges(radii: Tensor, infinity: float) -> Tensor:
    """The pixels [H, W] of edges and next to them."""
    if min(radii.shape) <= _BESIDE:
        return torch.zeros_like(radii, dtype=torch.bool)
    values = _as_averaged(_going_on(radii), infinity)
    least, most, ranges = values, values, []
    for _ in range(_BESIDE):  # of 3, 5 and 7 px on a side
        least = extreme_around(least, 1, torch.minimum)
        most = extreme_around(most, 1, torch.maximum)
        ranges.append(most - least)
        if len(ranges) == 1:
            bent = (values - (least + most) / 2).abs_() > _BENT * ranges[0]
    matters = _as_radii(most, infinity) - _as_radii(least, infinity) > _MATTERS
    bent = extreme_around(bent, 1, torch.maximum) & (ranges[0] > _WIDE * ranges[1])
    found = matters & (bent | (ranges[0] > _ABRUPT * ranges[2]))
    return found[_BESIDE:-_BESIDE, _BESIDE:-_BESIDE]


def _going_on(values: Tensor) -> Tensor:
    """Values [H, W] with those that would follow beyond the borders: slopes go on as slopes."""
    for dim in (0, 1):
        n = values.shape[dim]
        first, last = values.narrow(dim, 0, 1), values.narrow(dim, n - 1, 1)
        before = 2 * first - values.narrow(dim, 1, _BESIDE).flip(dim)
        after = 2 * last - values.narrow(dim, n - 1 - _BESIDE, _BESIDE).flip(dim)
        values = torch.cat([before, values, after], dim)
    return values


def _along(rows: Tensor, infinity: float | None) -> Tensor:
    """What rows [n, L] tell by themselves."""
    found = rows.new_zeros((2, 4), dtype=torch.float64)
    if rows.shape[1] <= 2 * _BESIDE:
        return found
    apart = (rows[:, 2 * _BESIDE :] - rows[:, : -2 * _BESIDE]).abs() > _MATTERS
    radii = rows.unfold(1, 2 * _BESIDE + 1, 1)[apart]
    for told, limit in zip(found, (math.inf, infinity), strict=True):
        if limit is not None:
            before, here, after = steps_beside(_as_averaged(rows, limit), 1)
            step = here if math.isinf(limit) else steps_beside(rows, 1)[1]
            level = _LEVEL * here - torch.maximum(before, after)
            hard = torch.count_nonzero(torch.minimum(step - _MATTERS, level) > 0)
            place, average, wide = _on_edges(_as_averaged(radii, limit))
            told.copy_(torch.stack([average.sum(), (place * average).sum(), wide.sum(), hard]))
    return found


def _on_edges(values: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of the middle ones of 7 values [m, 7]: where on an edge, from 0 to 1, they are.

    And which are on a narrow one, which on a wide one. The values around these go up or go down
    only, and level off at an end.
    """
    close, near, all_seven = (
        torch.aminmax(values[:, _BESIDE - by : _BESIDE + by + 1], dim=1) for by in (1, 2, _BESIDE)
    )
    within, size, whole = (ends.max - ends.min for ends in (close, near, all_seven))
    place = (values[:, _BESIDE] - near.min) / torch.where(size > 0, size, 1.0)
    step, level = values.diff(dim=1), _LEVEL * whole
    least, most = torch.aminmax(step[:, 1:-1], dim=1)
    some = (place > _AVERAGE) & (place < 1 - _AVERAGE)
    some &= (least >= -level) | (most <= level)
    some &= torch.minimum(step[:, 0].abs(), step[:, -1].abs()) < level
    abrupt = within > _SURELY * whole
    return place, some & abrupt, some & ~abrupt

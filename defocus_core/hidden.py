"""What the pinhole does not see but the aperture does: surfaces behind depth edges.

Neighbouring pixels whose radii differ by more than one px hold a depth edge: with |∇r| < 1 the map
from a lens point's picture to the pinhole's is one to one, beyond that a surface hides another.
From the whole aperture the farther surface shows up to r_far - r_near px behind the edge. There it
is continued by the colour and radius of what lies farther, near by first.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.continuation import continued, pooled, quartered
from defocus_core.threads import threaded

# Edges of radius, in px per pixel, above which one surface hides another.
_EDGE = 1.0
# Decay of the reach per px of |dx| + |dy|: 1 / √2 reaches as far on diagonals as it must.
_DECAY = 0.70710678
# How much farther, in px of radius, than the surface in front of it hidden content must be.
_STEP = 0.5
# The middle share of the distance from a near to a far radius, in which a border tells them apart.
_WELL_BETWEEN = 0.9
# The share of its radius by which a surface must be farther for a border to be made for it.
_CLOSE = 0.2
# Radii are compared in units of 1 / 8 px.
_GRAINS = 8


class HiddenLayer(NamedTuple):
    """The surface behind the visible one, where the aperture may see it or where it is known.

    Attributes:
        color: [C, H, W].
        signed_radius: [H, W] px.
        mask: [H, W] bool.
    """

    color: Tensor
    signed_radius: Tensor
    mask: Tensor


def hidden_layer(image: Tensor, signed_radius: Tensor, threads: int = 1) -> HiddenLayer | None:
    """Continue farther surfaces behind nearer ones, as far as the aperture sees them.

    Args:
        image: [C, H, W] linear.
        signed_radius: [H, W] px.
        threads: Borders between near and far radii that are continued at once.

    Returns:
        None if nothing is hidden.
    """
    r = signed_radius.detach()
    shown = revealed(r)
    wanted = shown > r + _STEP
    at = torch.nonzero(wanted)
    if not len(at):
        return None
    near, far = r[wanted], shown[wanted]
    values = torch.cat([image, signed_radius[None], torch.ones_like(image[:1])])
    found = values[:-1, at[:, 0], at[:, 1]].T  # stays where nothing is farther
    borders = _borders(near, far)
    choice = _nearest(borders, (near + far) / 2)
    quarters = quartered(values)
    radii = [torch.where(q[-1] > 0, q[-2] / q[-1], -torch.inf).detach() for q in quarters]

    def behind(index: int) -> tuple[Tensor, Tensor]:
        here = torch.nonzero(choice == index)[:, 0]
        beyond = [x > borders[index] for x in radii]
        return here, continued(pooled(quarters, beyond), at[here], r.shape)

    for here, values_there in threaded(behind, range(len(borders)), threads):
        found = found.index_put((here,), values_there)
    index = at[:, 0] * r.shape[1] + at[:, 1]
    color = torch.zeros_like(image).flatten(1).index_copy(1, index, found[:, :-1].T)
    radius = signed_radius.flatten().index_copy(0, index, found[:, -1]).reshape(r.shape)
    return HiddenLayer(color.reshape(image.shape), radius, wanted & (radius.detach() > r + _STEP))


def _borders(near: Tensor, far: Tensor) -> list[float]:
    """Few radii, ascending, of which one lies well between each pair of near and far ones.

    Pairs are told apart to 1/8 px, or to 1/8 of their distance. Pairs that are close make no
    border of their own.
    """
    if not near.numel():
        return []
    apart = far - near > ((near + far).abs() * (_CLOSE / 2)).clamp(min=_EDGE)
    near, far = (near[apart], far[apart]) if bool(apart.any()) else (near, far)
    unit = (far - near).log2().floor().sub(3).exp2().clamp(min=1 / _GRAINS)
    low = ((near / unit).ceil() * unit * _GRAINS).long()
    high = ((far / unit).floor() * unit * _GRAINS).long()
    pairs = torch.unique((low << 32) + high).cpu()
    high = (pairs << 32) >> 32
    low = (pairs - high) >> 32
    middle, reach = (high + low) / 2, (high - low) * (_WELL_BETWEEN / 2)
    least, most = (middle - reach).tolist(), (middle + reach).tolist()
    borders: list[float] = []
    for i in sorted(range(len(most)), key=most.__getitem__):
        if not borders or borders[-1] < least[i]:
            borders.append(most[i])
    return [border / _GRAINS for border in borders]


def _nearest(borders: list[float], wanted: Tensor) -> Tensor:
    """For each wanted radius the index of the border nearest to it."""
    ladder = torch.tensor(borders, dtype=wanted.dtype, device=wanted.device)
    if len(borders) < 2:
        return torch.zeros_like(wanted, dtype=torch.long)
    return torch.bucketize(wanted, (ladder[1:] + ladder[:-1]) / 2)


def revealed(r: Tensor) -> Tensor:
    """The farthest radius [H, W] that the aperture may show at each pixel, -inf where none.

    A far pixel beside an edge shows until its radius, less the distance, falls to the near one's:
    the greatest of r_far - |q - far| over all of them (a dilation by a cone).
    """
    shown = torch.full_like(r, -torch.inf)
    if not any(bool((r.diff(dim=dim).abs() > _EDGE).any()) for dim in (0, 1)):
        return shown
    for dim in (0, 1):
        n = r.shape[dim] - 1
        if n < 1:
            continue
        step = r.diff(dim=dim)
        before, after = r.narrow(dim, 0, n), r.narrow(dim, 1, n)
        first, second = shown.narrow(dim, 0, n), shown.narrow(dim, 1, n)
        first.copy_(torch.where(step < -_EDGE, torch.maximum(first, before), first))
        second.copy_(torch.where(step > _EDGE, torch.maximum(second, after), second))
    span = float(r.max() - r.min()) / _DECAY
    reached, stride = 0, 1
    while reached < span:
        for dim in (0, 1):
            shown = _dilate(shown, dim, stride)
        reached, stride = reached + stride, 2 * stride
    return shown


def _dilate(shown: Tensor, dim: int, stride: int) -> Tensor:
    n = shown.shape[dim] - stride
    if n < 1:
        return shown
    result = shown.clone()
    fallen = shown - stride * _DECAY
    for target, source in ((0, stride), (stride, 0)):
        side = result.narrow(dim, target, n)
        side.copy_(torch.maximum(side, fallen.narrow(dim, source, n)))
    return result

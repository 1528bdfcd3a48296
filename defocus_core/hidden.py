"""What the pinhole does not see but the aperture does: surfaces behind depth edges.

Neighbouring pixels whose radii differ by more than one px hold a depth edge: with |∇r| < 1 the map
from a lens point's picture to the pinhole's is one to one, beyond that a surface hides another.
From the whole aperture the farther surface shows up to r_far - r_near px behind the edge. There it
is continued by the colour and radius of what lies farther, near by first.
"""

from __future__ import annotations

from itertools import pairwise
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
# How far beyond a range of near radii, at most, the radii begin that are farther than all of it.
_MARGIN = 1.0


class HiddenLayer(NamedTuple):
    """The surface behind the visible one, where the aperture may see it.

    Attributes:
        color: [C, H, W].
        signed_radius: [H, W] px.
        mask: [H, W] bool.
    """

    color: Tensor
    signed_radius: Tensor
    mask: Tensor


def hidden_layer(image: Tensor, signed_radius: Tensor, threads: int = 1) -> HiddenLayer:
    """Continue farther surfaces behind nearer ones, as far as the aperture sees them.

    Args:
        image: [C, H, W] linear.
        signed_radius: [H, W] px.
        threads: Ranges of radius that are continued at once.
    """
    r = signed_radius.detach()
    shown = revealed(r)
    wanted = shown > r + _STEP
    at = torch.nonzero(wanted)
    near, far = r[wanted], shown[wanted]
    values = torch.cat([image, signed_radius[None], torch.ones_like(image[:1])])
    found = values[:-1, at[:, 0], at[:, 1]].T  # stays where nothing is farther
    bands = []
    for low, high in _bands(near):
        here = (near >= low) & (near < high)
        beyond = _between_surfaces(near[here], far[here], high + _MARGIN)
        if bool((r > beyond).any()):
            bands.append((here, beyond))

    quarters = quartered(values)
    radii = [torch.where(q[-1] > 0, q[-2] / q[-1], -torch.inf).detach() for q in quarters]

    def behind(band: tuple[Tensor, float]) -> Tensor:
        here, beyond = band
        return continued(pooled(quarters, [x > beyond for x in radii]), at[here], r.shape)

    for (here, _), values_there in zip(bands, threaded(behind, bands, threads), strict=True):
        found = found.index_put((here,), values_there)
    place = (at[:, 0], at[:, 1])
    color = torch.zeros_like(image.movedim(0, -1)).index_put(place, found[:, :-1]).movedim(-1, 0)
    radius = signed_radius.index_put(place, found[:, -1])
    return HiddenLayer(color, radius, wanted & (radius.detach() > r + _STEP))


def revealed(r: Tensor) -> Tensor:
    """The farthest radius [H, W] that the aperture may show at each pixel, -inf where none.

    A far pixel beside an edge shows until its radius, less the distance, falls to the near one's:
    the greatest of r_far - |q - far| over all of them (a dilation by a cone).
    """
    shown = torch.full_like(r, -torch.inf)
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


def _between_surfaces(near: Tensor, far: Tensor, at_most: float) -> float:
    """A radius beyond which lies what is farther than all near pixels, midway to what they show."""
    nearest, farthest = float(near.max()), float(far.min())
    return min((nearest + farthest) / 2, at_most) if nearest < farthest else at_most


def _bands(r: Tensor) -> list[tuple[float, float]]:
    """Ranges of radius that share one notion of what is farther: 3 px or half of r wide."""
    if not r.numel():
        return []
    least, most = float(r.min()), float(r.max())
    side = [0.0]
    while side[-1] <= max(abs(least), abs(most)):
        side.append(side[-1] + max(3.0, 0.5 * side[-1]))
    ladder = [-x for x in reversed(side[1:])] + side
    counts = torch.histogram(r.flatten().double().cpu(), torch.tensor(ladder).double()).hist
    return [pair for pair, count in zip(pairwise(ladder), counts.tolist(), strict=True) if count]

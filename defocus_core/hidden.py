"""What the pinhole does not see but the aperture does: surfaces behind depth edges.

Neighbouring pixels whose radii differ by more than one px hold a depth edge: with |∇r| < 1 the map
from a lens point's picture to the pinhole's is one to one, beyond that a surface hides another.
From the whole aperture the farther surface shows up to r_far - r_near px behind the edge. There it
is continued by the colour and radius of what lies farther, near by first (a push-pull pyramid
after Gortler et al. 1996, with supports that mirror with the frame).
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate

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

    def behind(band: tuple[Tensor, float]) -> Tensor:
        here, beyond = band
        return continued(values * (r > beyond).to(values.dtype), at[here])

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


def continued(weighted: Tensor, at: Tensor) -> Tensor:
    """A smooth continuation of values to pixels that have none.

    Args:
        weighted: [K + 1, H, W], values times weight, the last channel weight: 0 or 1.
        at: [n, 2] rows and columns of pixels of weight 0.

    Returns:
        [n, K].
    """
    size = (weighted.shape[-2], weighted.shape[-1])
    levels = []
    while max(weighted.shape[-2:]) > 1:
        pooled = _pooled(_pooled(weighted, -1), -2)
        weighted = pooled / pooled[-1:].clamp(min=1)
        levels.append(weighted)
    weight = levels[-1][-1:]
    found = levels.pop()[:-1] / torch.where(weight > 0, weight, 1.0)
    for level in reversed(levels):
        found = interpolate(found[None], size=level.shape[-2:], mode="bilinear")[0]
        found = level[:-1] + (1 - level[-1:]) * found
    return _bilinear(found, at, size)


def _pooled(values: Tensor, dim: int) -> Tensor:
    """Sums of two along -1 or -2; an odd length is covered evenly, as seen from both ends."""
    if values.shape[dim] % 2 == 0:
        n = values.shape[dim] // 2
        shape = [n, 2, values.shape[-1]] if dim == -2 else [values.shape[-2], n, 2]
        first, second = values.reshape(-1, *shape).unbind(dim)
        return first + second
    rows, columns = values.shape[-2:]
    size = ((rows + 1) // 2, columns) if dim == -2 else (rows, (columns + 1) // 2)
    return 2 * adaptive_avg_pool2d(values, size)


def _bilinear(coarse: Tensor, at: Tensor, size: tuple[int, int]) -> Tensor:
    """Coarse values [K, h, w] at pixels [n, 2] of a frame of the given size: [n, K]."""
    (y0, y1, fy), (x0, x1, fx) = (
        _neighbours(at[:, d], coarse.shape[d + 1], size[d], coarse.dtype) for d in (0, 1)
    )
    above = coarse[:, y0, x0] * (1 - fx) + coarse[:, y0, x1] * fx
    below = coarse[:, y1, x0] * (1 - fx) + coarse[:, y1, x1] * fx
    return (above * (1 - fy) + below * fy).T


def _neighbours(
    index: Tensor, length: int, full: int, dtype: torch.dtype
) -> tuple[Tensor, Tensor, Tensor]:
    """The two coarse samples beside a pixel, and the share of the second."""
    place = (index.to(dtype) + 0.5) * (length / full) - 0.5
    first = place.floor().clamp(0, length - 1)
    share = (place - first).clamp(0, 1)
    return first.long(), (first.long() + 1).clamp(max=length - 1), share

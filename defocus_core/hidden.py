"""What the pinhole does not see but the aperture does: surfaces behind depth edges.

Neighbouring pixels whose radii differ by more than one px hold a depth edge: with |∇r| < 1 the map
from a lens point's picture to the pinhole's is one to one, beyond that a surface hides another.
From the whole aperture the farther surface shows up to r_far - r_near px behind the edge. There it
is continued by the colour and radius of what lies farther, near by first (a push-pull pyramid
after Gortler et al. 1996, with supports that mirror with the frame).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate

# Edges of radius, in px per pixel, above which one surface hides another.
_EDGE = 1.0
# Decay of the reach per px of |dx| + |dy|: 1 / √2 reaches as far on diagonals as it must.
_DECAY = 0.70710678
# How much farther, in px of radius, than the surface in front of it hidden content must be.
_STEP = 1.0


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


def hidden_layer(image: Tensor, signed_radius: Tensor) -> HiddenLayer:
    """Continue farther surfaces behind nearer ones, as far as the aperture sees them.

    Args:
        image: [C, H, W] linear.
        signed_radius: [H, W] px.
    """
    r = signed_radius.detach()
    wanted = revealed(r) > r + _STEP
    color, radius = image.new_zeros(image.shape), signed_radius.clone()
    values = torch.cat([image, signed_radius[None]])
    for low, high in _bands(r[wanted]):
        here = wanted & (r >= low) & (r < high)
        farther = r > high + _STEP
        found = _push_pull(values, farther.to(values.dtype)[None])
        color = torch.where(here, found[:-1], color)
        radius = torch.where(here, found[-1], radius)
    return HiddenLayer(color, radius, wanted & (radius.detach() > r + _STEP / 2))


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


def _bands(r: Tensor) -> list[tuple[float, float]]:
    """Ranges of radius that share one notion of what is farther: 2 px or a quarter of r wide."""
    if not r.numel():
        return []
    least, most = float(r.min()), float(r.max())
    side = [0.0]
    while side[-1] <= max(abs(least), abs(most)):
        side.append(side[-1] + max(2.0, 0.25 * side[-1]))
    ladder = [-x for x in reversed(side[1:])] + side
    counts = torch.histogram(r.flatten().double().cpu(), torch.tensor(ladder).double()).hist
    pairs = zip(ladder, ladder[1:], strict=False)
    return [pair for pair, count in zip(pairs, counts.tolist(), strict=True) if count]


def _push_pull(values: Tensor, weight: Tensor) -> Tensor:
    """Values [K, H, W] where weight [1, H, W] is 1, elsewhere a smooth continuation of them."""
    levels = [(values * weight, weight)]
    while max(levels[-1][1].shape) > 1:
        weighted, weight = levels[-1]
        size = tuple((n + 1) // 2 for n in weight.shape[-2:])
        pooled = 4 * adaptive_avg_pool2d(torch.cat([weighted, weight]), size)
        pooled = pooled / pooled[-1:].clamp(min=1)
        levels.append((pooled[:-1], pooled[-1:]))
    weighted, weight = levels.pop()
    found = weighted / torch.where(weight > 0, weight, 1.0)
    for weighted, weight in reversed(levels):
        found = interpolate(found[None], size=weight.shape[-2:], mode="bilinear")[0]
        found = weighted + (1 - weight) * found
    return found

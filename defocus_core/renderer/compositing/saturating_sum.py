"""The saturating sum: layers composited front to back by coverage, and limits of the result.

Coverage is the share of an aperture part that sees a slice. Slices of one continuous surface have
complementary coverage and must add up; separate surfaces must occlude. The saturating sum does
both: each slice adds its coverage until the whole part is covered.

A view is a mean of the light of a scene, so it is neither darker nor brighter than the scene.
Layers and discs of highlights lose and gain light by rounding and by clipping. So colours are
limited to the least and the greatest value of their channel, and an opaque alpha stays opaque.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.engine import limits
from defocus_core.renderer.layers.slopes import along_first
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.ties import tied, with_gradient
from defocus_core.tensors.validation import Scalar

# Least room that counts as left: it guards 0 / 0, and shows nothing, however bright.
_MIN_FRACTION = 1e-30
# Coverage below 1 / _STEEP is faded to 0, and negative coverage counts as 0.
_STEEP = 1e9
# Coverage below this many roundings is noise of the transforms: the share gets no gradient, for
# every further layer would multiply it.
_CERTAIN = 100
# Shares of the aperture that differ by less are equal.
EQUAL = 1e-6


def fraction_behind(front: Tensor, layer: Tensor, full: Tensor | float = 1.0) -> Tensor:
    """The share [M, 1, h, w] of a layer that shows behind the layers composited so far.

    The layer adds min(1, (1 - A) / a) of itself, where A is the coverage so far and a is the
    coverage of the layer: A grows by min(a, 1 - A). A negative a, by rounding or by overshoot,
    counts as 0.

    `front`, `layer`: [M, C + 1, h, w], colour premultiplied by coverage, then coverage in [0, 1];
    `full`: coverage of a pixel that is completely covered.
    """
    left, coverage = (full - front[:, -1:]).clamp_(min=_MIN_FRACTION), layer[:, -1:]
    added = (coverage * _STEEP).clamp_(left.new_zeros(()), left)
    greater = torch.maximum(coverage, left)
    if not torch.is_grad_enabled():
        return added / greater
    # coverage equal to the room left, except for rounding, shares the gradient with it
    mean = with_gradient(greater, (coverage + left) / 2)
    fraction = added / torch.where(tied(coverage, left), mean, greater)
    certain = torch.minimum(coverage, left) > _CERTAIN * torch.finfo(left.dtype).eps
    return torch.where(certain, fraction, fraction.detach())


def shown_behind(front: Tensor, layer: Tensor, full: Tensor | float = 1.0) -> tuple[Tensor, Tensor]:
    """A layer and its `fraction_behind`, with a gradient also where coverage is 0.

    Where the front leaves room, a layer whose coverage rises from 0 shows entirely, and so its
    whole gradient counts. There the first result is the layer times its share, and the
    second is 1, so that the product of both is the same.
    """
    fraction = fraction_behind(front, layer, full)
    if not (torch.is_grad_enabled() and layer.requires_grad):
        return layer, fraction
    noise = _CERTAIN * torch.finfo(layer.dtype).eps
    begins = (layer[:, -1:].detach().abs() <= noise) & (full - front[:, -1:].detach() > noise)
    begun = with_gradient(layer * fraction, layer)
    return torch.where(begins, begun, layer), torch.where(begins, 1.0, fraction)


def add_behind(front: Tensor, layer: Tensor, full: Tensor | float = 1.0) -> Tensor:
    """A front with a layer added behind the layers composited so far."""
    return front.addcmul(*shown_behind(front, layer, full))


def add_light(front: Tensor, light: Tensor) -> Tensor:
    """A front with light [M, C, h, w] added to its first channels; coverage does not change."""
    channels = light.shape[1]
    return torch.cat([front[:, :channels] + light, front[:, channels:]], 1)


def mean_of_parts(front: Tensor, weights: Sequence[Scalar] | None = None) -> Tensor:
    """The image [C, h, w] through all parts of the aperture, divided by coverage.

    `front`: [M, C + 1, h, w]; `weights`: each part's share of the aperture; None for equal shares.
    """
    if weights is not None:
        learn = any(isinstance(weight, Tensor) for weight in weights)
        if learn or max(weights) - min(weights) > EQUAL:
            front = front * along_first(weights, front)
    total = front.sum(0) if len(front) > 1 else front[0]
    return total[:-1] / total[-1:]


class ColorRange(NamedTuple):
    """The least and the greatest value of each channel, [C, 1, 1] each."""

    least: Tensor
    greatest: Tensor

    @classmethod
    def from_channels(
        cls, channels: Sequence[tuple[float, float]], like: Tensor, minimum: float
    ) -> ColorRange:
        """The range of the channels of a picture.

        `channels`: least and greatest value of the first channels; `like`: [C, h, w]; `minimum`:
        least value of all other channels, which have no greatest value.
        """
        others = len(like) - len(channels) if channels else 1
        every = [*channels, *[(minimum, torch.inf)] * others]
        return cls(*(sent(limits, like).view(-1, 1, 1) for limits in zip(*every, strict=True)))

    def bounded(self, picture: Tensor) -> Tensor:
        """A picture [C, h, w] clipped to the range, which is slightly widened for rounding."""
        slack = [limits.SLACK * torch.minimum(x.abs(), self.greatest - self.least) for x in self]
        return clamped(picture, self.least - slack[0], self.greatest + slack[1])


def clamped(values: Tensor, least: Tensor, greatest: Tensor) -> Tensor:
    """Values clipped to limits; values that exceed a limit only by rounding keep their gradient."""
    bounded = values.clamp(least, greatest)
    if not values.requires_grad:
        return bounded
    return torch.where(tied(values, bounded), with_gradient(bounded, values), bounded)

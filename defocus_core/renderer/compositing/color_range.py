"""The range of colours: what a lens sees is a mean of what there is, neither darker nor brighter.

Layers and discs of lights leave and add light by rounding, and where they are clipped; the detail
of a draft overshoots. So colours are bounded by the least and greatest value of their channel in
the picture: an opaque alpha stays opaque.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.compositing.saturating_sum import is_half
from defocus_core.tensors.device_plan import beside, sent
from defocus_core.tensors.source import Scalar
from defocus_core.tensors.ties import tied, with_gradient

# Share of its range by which detail as fine as a pixel may overshoot in a half of the lens.
_OVERSHOOT = 0.1
# Share of the least and the greatest value by which rounding may exceed them: bounding more would
# change the energy of discs.
_SLACK = 9e-5


class ColorRange(NamedTuple):
    """Least and greatest value of each channel, [C, 1, 1], or [C, 1, 1, 1] of a batch."""

    least: Tensor
    greatest: Tensor

    @classmethod
    def of(
        cls, channels: Sequence[tuple[float, float]], like: Tensor, minimum: float
    ) -> ColorRange:
        """The range of the channels of a picture.

        `like`: [C, ..., h, w]; others are bounded by the minimum alone.
        """
        others = len(like) - len(channels) if channels else 1
        every = [*channels, *[(minimum, torch.inf)] * others]
        shape = -1, *[1] * (like.dim() - 1)
        return cls(*(sent(limits, like).view(shape) for limits in zip(*every, strict=True)))

    def bounded(self, picture: Tensor) -> Tensor:
        """A picture [C, ..., h, w] within the range."""
        slack = [_SLACK * torch.minimum(x.abs(), self.greatest - self.least) for x in self]
        return _clamped(picture, self.least - slack[0], self.greatest + slack[1])

    def bounded_pair(self, pair: Tensor, centre: Tensor, fraction: Scalar) -> Tensor:
        """Left and right [2, C, ..., h, w] within the range and a tenth of it more on both sides.

        `centre`: [C, ..., h, w] within the range.
        """
        more = _OVERSHOOT * (self.greatest - self.least)
        more = torch.where(more < torch.inf, more, 0.0)
        least, greatest = self.least - more, self.greatest + more
        left = beside(fraction, centre)
        ratio = 1.0 if is_half(fraction) else (1 - left) / left
        # without a greatest value the least alone bounds, also in the gradient to the ratio
        above = torch.where(greatest < torch.inf, greatest - centre, 0.0)
        darkest = torch.where(greatest < torch.inf, centre - ratio * above, least)
        darkest = torch.maximum(darkest, least)
        brightest = torch.minimum(centre + ratio * (centre - least), greatest)
        added = _clamped(pair[0], darkest, brightest) - pair[0]
        return torch.stack([pair[0] + added, pair[1] - added / ratio])


def _clamped(values: Tensor, least: Tensor, greatest: Tensor) -> Tensor:
    bounded = values.clamp(least, greatest)
    if not values.requires_grad:
        return bounded
    return torch.where(tied(values, bounded), with_gradient(bounded, values), bounded)

"""The saturating sum: layers composited front to back by coverage, and the pictures of the sum.

Coverage is the share of an aperture part that sees a slice. Slices of one continuous surface have
complementary coverage and must add up; separate surfaces must occlude. The saturating sum does
both: each slice adds its coverage until the whole part is covered.

What a lens sees is a mean of what there is, neither darker nor brighter. Layers and discs of lights
leave and add light by rounding, and where they are clipped. So
colours are bounded by the least and greatest value of their channel: an opaque alpha stays opaque.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.renderer.layers.slopes import along_first
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import beside, sent
from defocus_core.tensors.source import Scalar
from defocus_core.tensors.ties import tied, with_gradient

# Least room that counts as left: it guards 0 / 0, and shows nothing, however bright.
_MIN_FRACTION = 1e-30
# Coverage below 1 / _STEEP is faded to 0, and negative coverage counts as 0.
_STEEP = 1e9
# Coverage below this many roundings is noise of the transforms: the share gets no gradient, for
# every further layer would multiply it.
_CERTAIN = 100
# Greatest error of full coverage by transforms, in roundings.
_FULL = 8
# Negative light of this share of the brightest pixel is not worth a warning.
_NEGLIGIBLE = 1e-3
# Shares of the aperture that differ by less are equal.
_EQUAL = 1e-6


def fraction_behind(front: Tensor, layer: Tensor, full: Tensor | float = 1.0) -> Tensor:
    """The share of a layer that shows behind the layers composited so far.

    The layer adds min(1, (1 - A) / a) of itself, where A is the coverage so far and a that of the
    layer: A grows by min(a, 1 - A). A negative a, by rounding or by overshoot, counts as 0.

    `front`: [M, C + 1, h, w], colour premultiplied by coverage, then coverage in [0, 1]. Returns
    [M, 1, h, w].
    """
    left, coverage = (full - front[:, -1:]).clamp_(min=_MIN_FRACTION), layer[:, -1:]
    added = (coverage * _STEEP).clamp_(left.new_zeros(()), left)
    greater = torch.maximum(coverage, left)
    if not torch.is_grad_enabled():
        return added / greater
    # full coverage and what is left tie but for rounding, and share the gradient
    mean = with_gradient(greater, (coverage + left) / 2)
    fraction = added / torch.where(tied(coverage, left), mean, greater)
    certain = torch.minimum(coverage, left) > _CERTAIN * torch.finfo(left.dtype).eps
    return torch.where(certain, fraction, fraction.detach())


def shown_behind(front: Tensor, layer: Tensor, full: Tensor | float = 1.0) -> tuple[Tensor, Tensor]:
    """A layer and its `fraction_behind`, with the gradient of coverage that is about to begin.

    Where there is room, all of a coverage of 0 shows as soon as there is one, and its gradient with
    it. What it shows now is rounding, and stays as it is: of this the share is 1.
    """
    fraction = fraction_behind(front, layer, full)
    if not (torch.is_grad_enabled() and layer.requires_grad):
        return layer, fraction
    noise = _CERTAIN * torch.finfo(layer.dtype).eps
    begins = (layer[:, -1:].detach().abs() <= noise) & (full - front[:, -1:].detach() > noise)
    begun = with_gradient(layer * fraction, layer)
    return torch.where(begins, begun, layer), torch.where(begins, 1.0, fraction)


def add_behind(front: Tensor, layer: Tensor, full: Tensor | float = 1.0) -> Tensor:
    """Add a layer behind the layers composited so far."""
    layer, fraction = shown_behind(front, layer, full)
    return (
        front.addcmul(layer, fraction)
        if torch.is_grad_enabled()
        else front.addcmul_(layer, fraction)
    )


def add_within(total: Tensor, box: Box, values: Tensor, fraction: Tensor | None = None) -> Tensor:
    """Add values [M, C, h, w] of a rectangle, times a share, to a total [M, C, H, W].

    The total is overwritten by the result unless gradients are enabled.
    """
    if not torch.is_grad_enabled():
        window = box.of(total)
        window.add_(values) if fraction is None else window.addcmul_(values, fraction)
        return total
    H, W = total.shape[-2:]
    limits = W - box.left - box.width, H - box.top - box.height
    around = (box.left, limits[0], box.top, limits[1])
    if fraction is None:
        return total + pad(values, around)
    return total.addcmul(pad(values, around), pad(fraction, around))


def add_light(front: Tensor, light: Tensor) -> Tensor:
    """Add light [M, C, h, w] that covers nothing to the first channels of [M, C + 1 or more, h, w].

    `front` is overwritten by the result unless gradients are enabled.
    """
    channels = light.shape[1]
    if torch.is_grad_enabled():
        return torch.cat([front[:, :channels] + light, front[:, channels:]], 1)
    front[:, :channels].add_(light)
    return front


def is_full(front: Tensor, full: Tensor | float = 1.0, gap: float = 0.0) -> bool:
    """Whether no coverage is left to fill, if testing it is worthwhile.

    False if `front` needs a gradient, for the coverage left has one; and on a GPU, where reading
    the answer stalls for longer than it takes to add a layer of share 0.

    `front`: [M, C + 1, h, w], as in `fraction_behind`.
    """
    if front.requires_grad or not front.is_cpu:
        return False
    return float((full - front[:, -1:]).amax()) <= max(gap, _FULL * torch.finfo(front.dtype).eps)


def shown_in_gaps(
    front: Tensor, layer: Tensor, full: Tensor | float, groups: list[slice]
) -> tuple[Tensor, Tensor] | None:
    """As `shown_behind`, of groups of parts that have a gap left; None where none has."""
    filled = [
        is_full(front[group], full[group] if isinstance(full, Tensor) else full) for group in groups
    ]
    if all(filled):
        return None
    layer, fraction = shown_behind(front, layer, full)
    for group, is_filled in zip(groups, filled, strict=True):
        if is_filled:  # the same to the last digit as where this group is alone
            fraction[group] = 0.0
    return layer, fraction


def summed(layers: Sequence[tuple[Box, Tensor]], size: tuple[int, int]) -> Tensor:
    """The sum [M, C + 1, height, width] of layers that do not occlude each other.

    `layers`: one at least, each [M, C + 1, h, w] within a rectangle; `size`: that of the sum.
    """
    first = layers[0][1]
    total = first.new_zeros(*first.shape[:-2], *size)
    for box, layer in layers:
        total = add_within(total, box, layer)
    return total


def picture(front: Tensor, weights: Sequence[Scalar] | None = None) -> Tensor:
    """The image [C, h, w] of all parts together, divided by their coverage."""
    if weights is not None:
        learn = any(isinstance(weight, Tensor) for weight in weights)
        if learn or max(weights) - min(weights) > _EQUAL:
            front = front * along_first(weights, front)
    total = front.sum(0) if len(front) > 1 else front[0]
    return total[:-1] / total[-1:]


def count_negative(halves: Tensor, brightest: float, minimum: float = 0.0) -> dict[str, int]:
    """Count the pixels whose left or right image is too dark, which `pair_of` bounds.

    A half of the aperture overshoots where detail is as fine as a pixel. What is smaller than a
    thousandth of the brightest is not counted, and on a GPU nothing is: each tile would have to
    wait for its count.

    `halves`: [2, C, h, w], left and right as composited.
    """
    if not halves.is_cpu:
        return {}
    darkest = halves.detach().amin(dim=(0, 1))
    return {"pixels_clamped": int((darkest < minimum - _NEGLIGIBLE * brightest).sum())}


def pair_of(
    centre: Tensor, left: Tensor, right: Tensor, *, minimum: float = 0.0, fraction: Scalar = 0.5
) -> Tensor:
    """Left and right images [2, C, h, w] whose mean is the centre, from halves composited alone.

    Occlusion within a half differs from that within the whole, so their mean is near the centre
    but not equal. The ratio of what they have above the least light is kept.

    `centre`: [C, h, w]; `left`: the left half as composited, [C, h, w]; `right`: the right half as
    composited, [C, h, w].
    """
    if minimum:
        centre = centre - minimum
    # transforms leave ±1e-8
    left, right = ((half - minimum).clamp(min=0) for half in (left, right))
    if not is_half(fraction):
        share = beside(fraction, centre)
        left, right = left * (2 * share), right * (2 - 2 * share)
    total = left + right
    lit = total > 0
    of_left = torch.where(lit, left / torch.where(lit, total, 1.0), 0.5)
    pair = 2 * centre * torch.stack([of_left, 1 - of_left])
    if torch.is_grad_enabled() and pair.requires_grad:  # the ratio of two roundings says nothing
        pair = torch.where(tied(total, 0.0), with_gradient(pair, centre.expand_as(pair)), pair)
    if not is_half(fraction):
        pair = pair / along_first([2 * fraction, 2 - 2 * fraction], pair)
    return pair + minimum if minimum else pair


def is_half(fraction: Scalar) -> bool:
    """Whether a share of the aperture is a half of it."""
    value = torch.as_tensor(fraction, dtype=torch.float64).detach()
    return bool(((value - 0.5).abs() <= _EQUAL).all())


def within_alpha(pair: Tensor, fraction: Scalar) -> Tensor:
    """Left and right [2, C, h, w] whose last channel, alpha, is 1 at most; their mean stays.

    What one of them has in excess is of a surface that the other half sees.
    """
    alpha = pair[:, -1:]
    excess = pair * ((alpha - 1) / alpha.clamp(min=1)).clamp(min=0)
    weights = along_first([fraction, 1 - fraction], pair)
    return pair - excess + (excess * weights).flip(0) / weights


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

"""Left and right: views through the halves of the aperture, whose mean is made the centre.

Occlusion within a half differs from occlusion within the whole aperture, so the mean of halves that
are composited separately is close to the centre but not equal. The first step of the correction
makes them equal; the further steps keep the mean.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.renderer.compositing.saturating_sum import ColorRange, clamped
from defocus_core.renderer.engine.limits import NEGLIGIBLE, OVERSHOOT
from defocus_core.renderer.layers.slopes import along_first
from defocus_core.tensors.ties import tied, with_gradient
from defocus_core.tensors.validation import Scalar


def left_and_right(
    halves: Tensor,
    centre: Tensor,
    limits: ColorRange,
    *,
    minimum: float = 0.0,
    fraction: Scalar = 0.5,
    has_alpha: bool = False,
    dual_pixel: DualPixel | None = None,
) -> Tensor:
    """Left and right images [2, C, h, w] whose mean, weighted by area, is the centre.

    Args:
        halves: [2, C, h, w], left and right as composited.
        centre: [C, h, w], within the limits.
        limits: The range of each channel.
        minimum: The least light of the picture.
        fraction: The left image's share of the light of both.
        has_alpha: Whether the last channel is alpha, which is at most 1.
        dual_pixel: The photodiodes, which may exchange light; None for ideal ones.
    """
    pair = _around_centre(halves, centre, minimum, fraction)
    pair = _within_range(pair, centre, limits, fraction)
    pair = _within_alpha(pair, fraction) if has_alpha else pair
    return pair if dual_pixel is None else dual_pixel.crossed(pair, centre)


def count_negative(halves: Tensor, brightest: float, minimum: float = 0.0) -> dict[str, int]:
    """Count the pixels that are too dark in left or right, which `left_and_right` corrects.

    The image through a half of the aperture overshoots where detail is as fine as a pixel.
    Overshoot by less than a thousandth of the brightest value is not counted. On a GPU the counts
    are omitted, as each tile would have to wait for its count.

    `halves`: [2, C, h, w], left and right as composited.
    """
    if not halves.is_cpu:
        return {}
    darkest = halves.detach().amin(dim=(0, 1))
    return {"pixels_clamped": int((darkest < minimum - NEGLIGIBLE * brightest).sum())}


def _around_centre(halves: Tensor, centre: Tensor, minimum: float, fraction: Scalar) -> Tensor:
    """The pair with the mean `centre`; its excesses over `minimum` keep the halves' ratio."""
    centre = centre - minimum
    # transforms leave ±1e-8
    weights = along_first([2 * fraction, 2 - 2 * fraction], halves)
    left, right = (halves - minimum).clamp(min=0) * weights
    total = left + right
    lit = total > 0
    of_left = torch.where(lit, left / torch.where(lit, total, 1.0), 0.5)
    pair = 2 * centre * torch.stack([of_left, 1 - of_left])
    if torch.is_grad_enabled() and pair.requires_grad:  # the ratio of two roundings says nothing
        pair = torch.where(tied(total, 0.0), with_gradient(pair, centre.expand_as(pair)), pair)
    return pair / weights + minimum


def _within_range(pair: Tensor, centre: Tensor, limits: ColorRange, fraction: Scalar) -> Tensor:
    """Left and right [2, C, ..., h, w], clipped to the range widened by a tenth at both ends.

    Their mean does not change. `centre`: [C, ..., h, w] within the range.
    """
    more = OVERSHOOT * (limits.greatest - limits.least)
    more = torch.where(more < torch.inf, more, 0.0)
    least, greatest = limits.least - more, limits.greatest + more
    ratio = (1 - fraction) / fraction
    # without a greatest value the least alone bounds, also in the gradient to the ratio
    above = torch.where(greatest < torch.inf, greatest - centre, 0.0)
    darkest = torch.where(greatest < torch.inf, centre - ratio * above, least)
    darkest = torch.maximum(darkest, least)
    brightest = torch.minimum(centre + ratio * (centre - least), greatest)
    added = clamped(pair[0], darkest, brightest) - pair[0]
    return torch.stack([pair[0] + added, pair[1] - added / ratio])


def _within_alpha(pair: Tensor, fraction: Scalar) -> Tensor:
    """Left and right [2, C, h, w] with alpha, the last channel, at most 1; their mean stays.

    The excess over an alpha of 1, with its colours, is moved to the other view.
    """
    alpha = pair[:, -1:]
    excess = pair * ((alpha - 1) / alpha.clamp(min=1)).clamp(min=0)
    weights = along_first([fraction, 1 - fraction], pair)
    return pair - excess + (excess * weights).flip(0) / weights

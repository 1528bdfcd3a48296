"""Left and right: what the halves of the aperture see, corrected so that their mean is the centre.

Occlusion within a half differs from that within the whole, so the mean of halves composited alone
is near the centre but not equal. Every step of the correction keeps the mean that the first makes.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.renderer.compositing.saturating_sum import EQUAL, ColorRange, clamped
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
    """Left and right images [2, C, h, w] whose mean is the centre, of halves composited alone.

    Args:
        halves: [2, C, h, w], left and right as composited.
        centre: [C, h, w], within the limits.
        limits: The range of each channel.
        minimum: The least light.
        fraction: The share of the light of both that is of the left one.
        has_alpha: Whether the last channel is alpha, of which nothing has more than 1.
        dual_pixel: The photodiodes, which may give each other light.
    """
    pair = _around_centre(halves, centre, minimum, fraction)
    pair = _within_range(pair, centre, limits, fraction)
    pair = _within_alpha(pair, fraction) if has_alpha else pair
    return pair if dual_pixel is None else dual_pixel.crossed(pair, centre)


def count_negative(halves: Tensor, brightest: float, minimum: float = 0.0) -> dict[str, int]:
    """Count the pixels whose left or right image is too dark, which `left_and_right` bounds.

    A half of the aperture overshoots where detail is as fine as a pixel. Values of less than a
    thousandth of the brightest are not counted. On a GPU the counts are omitted, as each tile would
    have to wait for its count.

    `halves`: [2, C, h, w], left and right as composited.
    """
    if not halves.is_cpu:
        return {}
    darkest = halves.detach().amin(dim=(0, 1))
    return {"pixels_clamped": int((darkest < minimum - NEGLIGIBLE * brightest).sum())}


def _around_centre(halves: Tensor, centre: Tensor, minimum: float, fraction: Scalar) -> Tensor:
    """The pair whose mean is the centre, with the same ratio of light above the least light."""
    if minimum:
        centre = centre - minimum
    # transforms leave ±1e-8
    left, right = ((half - minimum).clamp(min=0) for half in halves)
    if not _is_half(fraction):
        left, right = left * (2 * fraction), right * (2 - 2 * fraction)
    total = left + right
    lit = total > 0
    of_left = torch.where(lit, left / torch.where(lit, total, 1.0), 0.5)
    pair = 2 * centre * torch.stack([of_left, 1 - of_left])
    if torch.is_grad_enabled() and pair.requires_grad:  # the ratio of two roundings says nothing
        pair = torch.where(tied(total, 0.0), with_gradient(pair, centre.expand_as(pair)), pair)
    if not _is_half(fraction):
        pair = pair / along_first([2 * fraction, 2 - 2 * fraction], pair)
    return pair + minimum if minimum else pair


def _within_range(pair: Tensor, centre: Tensor, limits: ColorRange, fraction: Scalar) -> Tensor:
    """Left and right [2, C, ..., h, w], clipped to the range widened by a tenth at both ends.

    `centre`: [C, ..., h, w] within the range.
    """
    more = OVERSHOOT * (limits.greatest - limits.least)
    more = torch.where(more < torch.inf, more, 0.0)
    least, greatest = limits.least - more, limits.greatest + more
    ratio = 1.0 if _is_half(fraction) else (1 - fraction) / fraction
    # without a greatest value the least alone bounds, also in the gradient to the ratio
    above = torch.where(greatest < torch.inf, greatest - centre, 0.0)
    darkest = torch.where(greatest < torch.inf, centre - ratio * above, least)
    darkest = torch.maximum(darkest, least)
    brightest = torch.minimum(centre + ratio * (centre - least), greatest)
    added = clamped(pair[0], darkest, brightest) - pair[0]
    return torch.stack([pair[0] + added, pair[1] - added / ratio])


def _within_alpha(pair: Tensor, fraction: Scalar) -> Tensor:
    """Left and right [2, C, h, w] whose last channel, alpha, is 1 at most; their mean stays.

    The excess over an alpha of 1, with its colours, moves to the other view, whose half sees it.
    """
    alpha = pair[:, -1:]
    excess = pair * ((alpha - 1) / alpha.clamp(min=1)).clamp(min=0)
    weights = along_first([fraction, 1 - fraction], pair)
    return pair - excess + (excess * weights).flip(0) / weights


def _is_half(fraction: Scalar) -> bool:
    """Whether a share of the aperture is a half of it."""
    value = torch.as_tensor(fraction, dtype=torch.float64).detach()
    return bool(((value - 0.5).abs() <= EQUAL).all())

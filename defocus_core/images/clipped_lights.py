"""Clipped lights: pixels that a picture of 8 bits holds as white, with the light they lost.

White of 8 bits is the end of the scale, not a measure: a lamp a hundred times as bright as a wall
is stored as hardly more, and its blur would be a grey disc. Pixels near the end of the scale are
made brighter by a gain, all channels alike, so that their hue stays. A lamp is small: where white
fills much of the neighbourhood, as sky does, its light stays.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from defocus_core.images.derived import Derived
from defocus_core.images.source import Pixels, banded
from defocus_core.optics.outline import Scalar
from defocus_core.runtime.validation import number, whole

# The neighbourhood reaches this share of the width of the frame to each side, so many px at least.
_AROUND, _LEAST = 0.012, 4
# The share of white in the neighbourhood from which on it is no lamp.
_FULL = 0.5
# Light above 1 by more than rounding was measured, and is left as it is.
_MEASURED = 1.001
# What "auto" stands for: threshold, in linear light, and gain.
AUTO_LIGHTS = (0.93, 16.0)


def with_lights(
    image: Pixels, threshold: Scalar, gain: Scalar, *, colors: int | None = None
) -> Pixels:
    """A picture whose clipped lights have the light they may have had.

    Args:
        image: [C, H, W], linear light of 0 to 1; brighter pictures are returned as they are.
        threshold: The brightness, of the brightest channel, at which the gain begins, below 1.
        gain: The factor at the end of the scale, 1 or more.
        colors: How many channels are colours, the first ones; None for all.

    Returns:
        [C, H, W], a tensor if the image is one. Gradients flow to a tensor, threshold and gain.

    Raises:
        ValueError: If an argument is not one of the above.
    """
    if not 0 <= number("threshold", threshold, "in linear light") < 1:
        raise ValueError(
            f"threshold must be 0 or more and below 1, got {threshold}; 0.93 suits most"
        )
    if number("gain", gain, "it is a factor") < 1:
        raise ValueError(f"gain must be 1 or more, got {gain}; 1 changes nothing")
    count = image.shape[0] if colors is None else whole("colors", colors, "channels of colour")
    if any(float(band[:count].amax()) > _MEASURED for band in banded(image)):
        return image
    lit = _Lit(image, threshold, gain, count)
    if isinstance(image, Tensor):
        return lit.made((0, image.shape[-2]), (0, image.shape[-1]))
    return lit


class _Lit(Derived):
    """The picture, window by window."""

    def __init__(self, image: Pixels, threshold: Scalar, gain: Scalar, colors: int) -> None:
        """Keep the source; nothing is read yet."""
        self._image, self._threshold, self._gain, self._colors = image, threshold, gain, colors
        self.shape, self.dtype, self.device = tuple(image.shape), image.dtype, image.device
        self.margin = max(_LEAST, round(_AROUND * image.shape[-1]))

    def made(self, rows: tuple[int, int], columns: tuple[int, int]) -> Tensor:
        """The window [rows, columns], each a pair of first and end."""
        cuts, inner = [], []
        for (first, end), length in zip((rows, columns), self.shape[-2:], strict=True):
            start, last = max(first - self.margin, 0), min(end + self.margin, length)
            cuts.append(slice(start, last))
            inner.append(slice(first - start, end - start))
        around = self._image[..., cuts[0], cuts[1]]
        light = around[: self._colors]
        share = ((light.amax(0) - self._threshold) / (1 - self._threshold)).clamp(0, 1)
        share = share * share * (3 - 2 * share)
        white = share[None]
        for side in ((2 * self.margin + 1, 1), (1, 2 * self.margin + 1)):
            reach = (side[0] // 2, side[1] // 2)
            white = avg_pool2d(white, side, 1, reach, count_include_pad=False)
        factor = 1 + (self._gain - 1) * share * (1 - white[0] / _FULL).clamp(min=0)
        lit = torch.cat([light * factor, around[self._colors :]])
        return lit[..., inner[0], inner[1]].to(self.dtype)

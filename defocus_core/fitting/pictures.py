"""The pictures of a pair at a size: sharp, disparity, and what is observed blurred."""

from __future__ import annotations

import math
from copy import copy

import torch
from torch import Tensor
from torch.nn.functional import interpolate

_MINIMUM = 16  # px, of a side of small pictures
_ENDLESS = 1.001  # greatest value, beyond which light has no end
_END = 0.9999  # fraction of the greatest value
_LOBES = 3  # of the windowed sinc that moves a picture


class Scale:
    """The pictures at one size: `factor` px of it for a px, `sharp`, `observed` and `disparity`.

    `lost` is the share of pixels whose light is clipped in the sharp picture [1, H, W], or None.
    """

    def __init__(
        self, sharp: Tensor, disparity: Tensor, observed: tuple[Tensor, ...], width: int
    ) -> None:
        """Reduce the pictures to a width in px; a greater one leaves them."""
        full = sharp.shape[2]
        self.factor = min(1.0, width / full)
        self.sharp = self._small(sharp)
        self.observed = [self._small(each) for each in observed]
        self.lost = self._small(clipped) if bool((clipped := _clipping(sharp)).any()) else None
        height, width = self.sharp.shape[1:]
        rows = ((torch.arange(height) + 0.5) * sharp.shape[1] / height).long()
        columns = ((torch.arange(width) + 0.5) * full / width).long()
        self.disparity = disparity[rows][:, columns]

    def flat(self) -> Scale:
        """The same pictures with a disparity of 0 everywhere, and the mean of what is observed."""
        flat = copy(self)
        flat.observed = [torch.stack(self.observed).mean(0)]
        flat.disparity = torch.zeros_like(self.disparity)
        return flat

    def _small(self, image: Tensor) -> Tensor:
        if self.factor == 1.0:
            return image
        size = [max(_MINIMUM, round(side * self.factor)) for side in image.shape[1:]]
        return interpolate(image[None], size, mode="area")[0]


def _clipping(image: Tensor) -> Tensor:
    """Where a picture [C, H, W] that ends at 1 or below is at its end: [1, H, W], 1 or 0.

    The end of a picture without clipped light is that of a pixel or two.
    """
    top = float(image.max())
    if top > _ENDLESS:
        return torch.zeros_like(image[:1])
    return (image.amax(0, keepdim=True) >= _END * top).to(image)


def registered(images: Tensor, across: float, down: float, magnification: float) -> Tensor:
    """Pictures [V, C, H, W] magnified about their middle, then moved by px, by Lanczos' sinc.

    What comes in from beyond the border is what is at the border.
    """
    for shift, dim in ((across, -1), (down, -2)):
        if not shift and magnification == 1:
            continue
        size = images.shape[dim]
        middle = (size - 1) / 2
        place = (torch.arange(size).double() - middle - shift) / magnification + middle
        moved = torch.zeros_like(images)
        for tap in range(1 - _LOBES, _LOBES + 1):
            source = place.floor() + tap
            kernel = _lanczos(place - source).to(images)
            values = images.index_select(dim, source.long().clamp(0, size - 1).to(images.device))
            moved += values * (kernel if dim == -1 else kernel[:, None])
        images = moved
    return images


def offset_of(sharp: Tensor, observed: Tensor, maximum: int) -> tuple[float, float]:
    """Px by which a picture [C, H, W] lies to the right of and below another, whatever its blur.

    Their correlation is greatest there: a pupil that is the same when turned moves nothing.
    """
    spectra = []
    for image in (sharp, observed):
        light = image.clamp_min(0).mean(0)
        light = light / (light + light.median().clamp_min(1e-3))  # lights do not decide
        spectra.append(torch.fft.rfft2(light - light.mean(), s=[2 * n for n in light.shape]))
    both = torch.fft.irfft2(spectra[1] * spectra[0].conj())
    positions = torch.arange(-maximum, maximum + 1)
    near = both[positions][:, positions]
    down, across = divmod(int(near.argmax()), len(positions))
    return float(positions[across]), float(positions[down])


def border_of(shift: float, magnification: float, size: int) -> int:
    """Px at the border of a side that a registration makes of what lies beyond."""
    away = abs(shift) + abs(magnification - 1) * size / 2
    return math.ceil(away) + _LOBES if away else 0


def _lanczos(away: Tensor) -> Tensor:
    """The windowed sinc of samples so many px away."""
    return torch.sinc(away) * torch.sinc(away / _LOBES) * (away.abs() < _LOBES)

"""The pictures of a pair at a size, and one of them moved onto another."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import interpolate

_ENDLESS = 1.001  # greatest value of pictures that may be clipped
_END = 0.9999  # fraction of the greatest value
_MIN_HEIGHT = 16  # px
_LOBES = 3  # of the windowed sinc that moves a picture


@dataclass(frozen=True, eq=False)
class Scale:
    """The pictures of a pair at one size."""

    sharp: Tensor  # [C, H, W]
    disparity: Tensor  # [H, W], 0 of the farthest surface and 1 of the nearest
    observed: Tensor  # [V, C, H, W]
    lost: Tensor  # [1, H, W], the share of a pixel whose light is clipped in the sharp picture
    factor: float = 1.0  # px of these pictures per px of the pair

    def reduced(self, width: int) -> Scale:
        """The same pictures reduced to `width` px, if they are wider."""
        if width >= self.sharp.shape[2]:
            return self
        factor = width / self.sharp.shape[2]
        size = max(_MIN_HEIGHT, round(self.sharp.shape[1] * factor)), width
        sharp, lost = (interpolate(x[None], size, mode="area")[0] for x in (self.sharp, self.lost))
        disparity = interpolate(self.disparity[None, None], size, mode="nearest-exact")[0, 0]
        observed = interpolate(self.observed, size, mode="area")
        return Scale(sharp, disparity, observed, lost, factor)


def clipped(image: Tensor) -> Tensor:
    """Mask [1, H, W], 1 or 0, of the pixels at the maximum of a picture [C, H, W] of at most 1.

    The mask of a picture without clipped light has only a pixel or two.
    """
    top = float(image.max()) if float(image.max()) <= _ENDLESS else torch.inf
    return (image.amax(0, keepdim=True) >= _END * top).to(image)


def registered(
    images: Tensor, across: float, down: float, magnification: float
) -> tuple[Tensor, Tensor]:
    """Images [V, C, H, W] magnified about their middle, then moved by px, by Lanczos' sinc.

    Returns the images, and a mask [H, W], 0 where a pixel comes from beyond the border, else 1.
    """
    inside = torch.ones_like(images[0, 0])
    for shift in (down, across):  # the rows, then, turned, the columns
        size = images.shape[-2]
        middle = (size - 1) / 2
        place = (torch.arange(size).double() - middle - shift) / magnification + middle
        away = place[:, None] - torch.arange(size)
        sinc = torch.sinc(away) * torch.sinc(away / _LOBES) * (away.abs() < _LOBES)
        within = (place > _LOBES - 1) & (place < size - _LOBES)
        images = (sinc.to(images) @ images).mT
        inside = (inside * within[:, None].to(images)).mT
    return images, inside


def offset_of(sharp: Tensor, observed: Tensor, maximum: int) -> tuple[float, float]:
    """Px by which `observed` [C, H, W] lies right of and below `sharp`, whatever the blur.

    The offset maximises their correlation: blur by a pupil with point symmetry moves nothing.
    """
    spectra = []
    for image in (sharp, observed):
        light = image.clamp_min(0).mean(0)
        light = light / (light + light.median().clamp_min(1e-3))  # so that lights do not decide
        spectra.append(torch.fft.rfft2(light - light.mean(), s=[2 * n for n in light.shape]))
    both = torch.fft.irfft2(spectra[1] * spectra[0].conj())
    positions = torch.arange(-maximum, maximum + 1)
    down, across = divmod(int(both[positions][:, positions].argmax()), len(positions))
    return float(positions[across]), float(positions[down])

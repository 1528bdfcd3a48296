"""The pictures of a pair at one size, and the registration of one picture to another."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import interpolate

_ENDLESS = 1.001  # pictures with greater values are not clipped
_END = 0.9999  # share of the greatest value from which on a pixel is clipped
_MIN_HEIGHT = 16  # px
_LOBES = 3  # lobes of the windowed sinc that resamples a picture


@dataclass(frozen=True, eq=False)
class Scale:
    """The pictures of a pair at one size."""

    sharp: Tensor  # [C, H, W]
    disparity: Tensor  # [H, W], 0 at the farthest surface and 1 at the nearest
    observed: Tensor  # [V, C, H, W], the blurred picture, or left and right
    lost: Tensor  # [1, H, W], share of each pixel's area that is clipped in the sharp picture
    factor: float = 1.0  # px of these pictures per px of the pair

    def reduced(self, width: int) -> Scale:
        """The same pictures reduced to a width of `width` px, if they are wider."""
        if width >= self.sharp.shape[2]:
            return self
        factor = width / self.sharp.shape[2]
        size = max(_MIN_HEIGHT, round(self.sharp.shape[1] * factor)), width
        sharp, lost = (interpolate(x[None], size, mode="area")[0] for x in (self.sharp, self.lost))
        disparity = interpolate(self.disparity[None, None], size, mode="nearest-exact")[0, 0]
        observed = interpolate(self.observed, size, mode="area")
        return Scale(sharp, disparity, observed, lost, factor)


def clipped(image: Tensor) -> Tensor:
    """Mask [1, H, W], 1 or 0, of the clipped pixels of a picture [C, H, W].

    Clipped pixels are at the maximum of a picture that nowhere exceeds 1. In a picture without
    clipped light the mask has only one or two pixels.
    """
    top = float(image.max()) if float(image.max()) <= _ENDLESS else torch.inf
    return (image.amax(0, keepdim=True) >= _END * top).to(image)


def registered(
    images: Tensor, across: float, down: float, magnification: float
) -> tuple[Tensor, Tensor]:
    """Images [V, C, H, W] magnified about their middle, then moved right and down by px.

    They are interpolated by Lanczos' windowed sinc. Returns the images, and a mask [H, W], 0 where
    a pixel comes from beyond the border, else 1.
    """
    inside = torch.ones_like(images[0, 0])
    for shift in (down, across):  # rows are resampled, then, after a transposition, columns
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
    """The (x, y) in px by which `observed` lies right of and below `sharp`, both [C, H, W].

    The offset, at most `maximum` along each axis, maximises their correlation; blur by a pupil with
    point symmetry does not change it.
    """
    spectra = []
    for image in (sharp, observed):
        light = image.clamp_min(0).mean(0)
        light = light / (light + light.median().clamp_min(1e-3))  # so that no light dominates
        spectra.append(torch.fft.rfft2(light - light.mean(), s=[2 * n for n in light.shape]))
    both = torch.fft.irfft2(spectra[1] * spectra[0].conj())
    positions = torch.arange(-maximum, maximum + 1)
    down, across = divmod(int(both[positions][:, positions].argmax()), len(positions))
    return float(positions[across]), float(positions[down])

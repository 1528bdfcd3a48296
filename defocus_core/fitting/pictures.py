"""The pictures of a pair at a size, and one of them moved onto another."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import interpolate

_ENDLESS = 1.001  # greatest value, beyond which light has no end
_END = 0.9999  # fraction of the greatest value
_LOBES = 3  # of the windowed sinc that moves a picture


class Scale:
    """The pictures at one size: `factor` px of it for a px, `sharp`, `observed` and `disparity`.

    `lost` is the share of pixels whose light is clipped in the sharp picture [1, H, W], or None;
    `ends` are the least and the greatest disparity.
    """

    def __init__(self, sharp: Tensor, disparity: Tensor, observed: Tensor, width: int) -> None:
        """Reduce the pictures to a width in px."""
        self.factor = width / sharp.shape[2]
        size = max(16, round(sharp.shape[1] * self.factor)), width
        self.sharp, self.observed = _reduced(sharp[None], size)[0], _reduced(observed, size)
        # The end of a picture without clipped light is that of a pixel or two
        top = float(sharp.max()) if float(sharp.max()) <= _ENDLESS else torch.inf
        clipped = (sharp.amax(0, keepdim=True) >= _END * top).to(sharp)
        self.lost = _reduced(clipped[None], size)[0] if bool(clipped.any()) else None
        rows, columns = (
            ((torch.arange(n) + 0.5) * full / n).long()
            for n, full in zip(size, disparity.shape, strict=True)
        )
        self.disparity = disparity[rows][:, columns]
        low, high = map(float, self.disparity.aminmax())
        self.ends = low, high


def _reduced(images: Tensor, size: tuple[int, int]) -> Tensor:
    return images if images.shape[-2:] == size else interpolate(images, size, mode="area")


def registered(
    images: Tensor, across: float, down: float, magnification: float
) -> tuple[Tensor, Tensor]:
    """Pictures [V, C, H, W] magnified about their middle, then moved by px, by Lanczos' sinc.

    Beside them where nothing comes in from beyond the border: [H, W], 1 or 0.
    """
    inside = torch.ones_like(images[0, 0])
    for shift, dim in ((across, -1), (down, -2)):
        size = images.shape[dim]
        middle = (size - 1) / 2
        place = (torch.arange(size).double() - middle - shift) / magnification + middle
        moved = torch.zeros_like(images)
        for tap in range(1 - _LOBES, _LOBES + 1):
            source = place.floor() + tap
            away = place - source
            lanczos = torch.sinc(away) * torch.sinc(away / _LOBES) * (away.abs() < _LOBES)
            values = images.index_select(dim, source.long().clamp(0, size - 1).to(images.device))
            moved += values * _along(lanczos, dim).to(images)
        images = moved
        within = (place > _LOBES - 1) & (place < size - _LOBES)
        inside = inside * _along(within, dim).to(images)
    return images, inside


def _along(values: Tensor, dim: int) -> Tensor:
    return values if dim == -1 else values[:, None]


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
    down, across = divmod(int(both[positions][:, positions].argmax()), len(positions))
    return float(positions[across]), float(positions[down])

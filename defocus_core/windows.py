"""The transforms in which slices are blurred: windows around a tile, and spectra of kernels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from defocus_core.aperture import Aperture, Part
from defocus_core.convolution import kernel_spectra, transform_length


@dataclass(frozen=True)
class Window:
    """The transform that slices of similar reach share.

    Attributes:
        margin: Px around a tile that its slices reach at most; 0 if they are not blurred at all.
        size: (height, width) of the transform.
        slices: Their numbers.
        radii: Of these in px, [k], float64.
        aperture: The pupil.
        parts: M parts of it.
        like: Of the dtype and device of the spectra.
    """

    margin: int
    size: tuple[int, int]
    slices: list[int]
    radii: Tensor
    aperture: Aperture
    parts: list[Part]
    like: Tensor

    @cached_property
    def spectra(self) -> dict[int, Tensor]:
        """Of the kernels, by the number of the slice: [M, 1, height, width // 2 + 1]."""
        return self._spectra(leaning=False)

    @cached_property
    def leaning(self) -> dict[int, Tensor]:
        """The same times u.x and u.y, for tilted surfaces: [2, M, 1, ...]."""
        return self._spectra(leaning=True)

    def _spectra(self, *, leaning: bool) -> dict[int, Tensor]:
        spectra = kernel_spectra(
            self.radii, self.margin, self.size, self.aperture, self.parts, leaning=leaning
        )
        spectra = spectra.to(self.like).unsqueeze(-3)
        return dict(zip(self.slices, spectra, strict=True))


def windows(
    radii: tuple[float, ...],
    reaches: list[int],
    layers: list[int],
    side: tuple[int, int],
    aperture: Aperture,
    parts: list[Part],
    dtype: torch.dtype,
    device: torch.device,
) -> list[Window]:
    """The window of each slice; slices of a layer share one.

    Args:
        radii: Of the slices in px.
        reaches: Px that each spreads.
        layers: The number of the layer of each.
        side: (height, width) of a tile in px.
        aperture: The pupil.
        parts: M parts of it.
        dtype: Of the pictures.
        device: Of the pictures.
    """
    sharing: dict[tuple[int, int, bool], list[int]] = {}
    for k, number in enumerate(layers):
        widest = max(reaches[j] for j, other in enumerate(layers) if other == number)
        rows, columns = (transform_length(n + 2 * widest) for n in side)
        sharing.setdefault((rows, columns, widest == 0), []).append(k)
    precision = torch.complex128 if dtype == torch.float64 else torch.complex64
    like = torch.empty(0, dtype=precision, device=device)
    found: dict[int, Window] = {}
    for (rows, columns, _), slices in sharing.items():
        extent = max(reaches[k] for k in slices)
        some = torch.tensor([radii[k] for k in slices], dtype=torch.float64)
        window = Window(extent, (rows, columns), slices, some, aperture, parts, like)
        found.update(dict.fromkeys(slices, window))
    return [found[k] for k in range(len(radii))]

"""The transforms in which slices are blurred: windows around a tile, and spectra of kernels."""

from __future__ import annotations

from dataclasses import dataclass

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
        spectra: Of the kernels, by the index of the slice: [M, 1, height, width // 2 + 1].
        leaning: The same times u.x and u.y: [2, M, 1, ...]; empty if no surface is tilted.
    """

    margin: int
    size: tuple[int, int]
    spectra: dict[int, Tensor]
    leaning: dict[int, Tensor]


def windows(
    radii: tuple[float, ...],
    reaches: list[int],
    layers: list[int],
    side: tuple[int, int],
    aperture: Aperture,
    parts: list[Part],
    like: Tensor,
    *,
    tilted: bool,
) -> list[Window]:
    """The window of each slice; slices of a layer share one.

    Args:
        radii: Of the slices in px.
        reaches: Px that each spreads.
        layers: The number of the layer of each.
        side: (height, width) of a tile in px.
        aperture: The pupil.
        parts: M parts of it.
        like: Of the dtype and device of the pictures.
        tilted: Whether kernels for tilted surfaces are needed.
    """
    sharing: dict[tuple[int, int, bool], list[int]] = {}
    for k, number in enumerate(layers):
        widest = max(reaches[j] for j, other in enumerate(layers) if other == number)
        rows, columns = (transform_length(n + 2 * widest) for n in side)
        sharing.setdefault((rows, columns, widest == 0), []).append(k)
    found: dict[int, Window] = {}
    for (rows, columns, _), slices in sharing.items():
        extent = max(reaches[k] for k in slices)
        some = torch.tensor([radii[k] for k in slices], dtype=torch.float64)
        blur = (some, extent, (rows, columns), aperture, parts)
        spectra, *leaning = (
            _by_slice(slices, kernel_spectra(*blur, leaning=leaning), like)
            for leaning in ([False, True] if tilted and extent else [False])
        )
        window = Window(extent, (rows, columns), spectra, *(leaning or [{}]))
        found.update(dict.fromkeys(slices, window))
    return [found[k] for k in range(len(radii))]


def _by_slice(slices: list[int], spectra: Tensor, like: Tensor) -> dict[int, Tensor]:
    precision = torch.complex128 if like.dtype == torch.float64 else torch.complex64
    spectra = spectra.to(like.device, precision).unsqueeze(-3)
    return dict(zip(slices, spectra, strict=True))

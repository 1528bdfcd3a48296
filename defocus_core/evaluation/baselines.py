"""A baseline to compare the renderer with: the plain sum of blurred slices.

The baseline shares slice radii, kernels and transforms with the renderer, but has no hidden
content, no tiles and no separate highlights. Each slice costs one blur.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.parts import FULL
from defocus_core.renderer.blur.kernel_bank import kernel_spectra, kernels, reach, transform_length
from defocus_core.renderer.engine.settings import quality_of
from defocus_core.renderer.layers.slice_radii import membership, slice_position, slice_radii

_MIN_COVERAGE = 1e-6  # guards 0 / 0 where no slice covers a pixel


def plain_sum(
    image: Tensor,
    signed_radius: Tensor,
    *,
    aperture: Aperture | None = None,
    quality: str = "standard",
) -> Tensor:
    """The sum of all blurred slices, divided by the sum of their coverage, without occlusion.

    `image`: [C, H, W], linear light; `signed_radius`: [H, W] px; `aperture`: a round one by
    default; `quality`: the quality whose slice radii are used. Returns [C, H, W].
    """
    H, W = signed_radius.shape
    radii = slice_radii(float(signed_radius.min()), float(signed_radius.max()), quality_of(quality))
    positions = slice_position(signed_radius.to(image.dtype), radii)
    extents = [reach(radius, max(H, W) - 1) for radius in radii]
    rows, columns = (transform_length(max(n + max(extents), 2 * max(extents) + 1)) for n in (H, W))
    pixels = torch.cat([image, torch.ones_like(image[:1])])
    total = torch.zeros_like(torch.fft.rfft2(pixels, s=(rows, columns)))
    for k, (radius, extent) in enumerate(zip(radii, extents, strict=True)):
        slice_radius = torch.tensor([radius], dtype=torch.float64)
        kernel = kernels(slice_radius, extent, aperture or Aperture(), [FULL])[:, 0]
        fraction = membership(positions, positions.new_tensor([k]))  # [1, H, W]
        spectrum = torch.fft.rfft2(pixels * fraction, s=(rows, columns))
        total += spectrum * kernel_spectra(kernel[0], (rows, columns)).to(total)
    blurred: Tensor = torch.fft.irfft2(total, s=(rows, columns))[:, :H, :W]
    return blurred[:-1] / blurred[-1:].clamp(min=_MIN_COVERAGE)

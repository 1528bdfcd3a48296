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
from defocus_core.tensors.threads import threaded

# Guards 0 / 0 where no slice covers a pixel.
_MIN_COVERAGE = 1e-6


def plain_sum(
    image: Tensor,
    signed_radius: Tensor,
    *,
    aperture: Aperture | None = None,
    quality: str = "standard",
    threads: int = 1,
) -> Tensor:
    """The sum of all blurred slices, divided by the sum of their coverage, without occlusion.

    Args:
        image: [C, H, W], linear light.
        signed_radius: [H, W] px, negative nearer than focus.
        aperture: The pupil, a round one by default.
        quality: The quality whose slice radii are used.
        threads: Channels transformed at once.

    Returns:
        [C, H, W].
    """
    aperture = aperture or Aperture()
    radii = slice_radii(float(signed_radius.min()), float(signed_radius.max()), quality_of(quality))
    positions = slice_position(signed_radius.to(image.dtype), radii)
    pixels = torch.cat([image, torch.ones_like(image[:1])])
    total = torch.zeros_like(pixels)
    for k, radius in enumerate(radii):
        fraction = membership(positions, positions.new_tensor([k]))  # [1, H, W]
        if bool(fraction.any()):
            total += _blurred(pixels * fraction, radius, aperture, threads)
    return total[:-1] / total[-1:].clamp(min=_MIN_COVERAGE)


def _blurred(layer: Tensor, radius: float, aperture: Aperture, threads: int) -> Tensor:
    """A layer [C + 1, H, W] convolved with the kernel of a radius, black beyond the frame."""
    H, W = layer.shape[-2:]
    extent = reach(radius, max(H, W) - 1)
    if extent == 0:
        return layer
    rows, columns = (transform_length(max(n + extent, 2 * extent + 1)) for n in (H, W))
    kernel = kernels(torch.tensor([radius], dtype=torch.float64), extent, aperture, [FULL])[:, 0]
    response = kernel_spectra(kernel[0], (rows, columns))
    response = response.to(layer.device, torch.promote_types(layer.dtype, torch.complex64))

    def blurred(channel: Tensor) -> Tensor:
        spectrum = torch.fft.rfft2(channel, s=(rows, columns)) * response[0]
        spread: Tensor = torch.fft.irfft2(spectrum, s=(rows, columns))
        return spread[:H, :W]

    *color, coverage = threaded(blurred, layer.unbind(), threads)
    return torch.stack([*color, coverage.clamp(0, 1)])  # transforms leave ±1e-8

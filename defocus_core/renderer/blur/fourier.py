"""Fourier blur: sampled kernels, their spectra, and transform sizes.

A tile is blurred within a window of a length that transforms fast, at least tile + 2 reach, so that
the circular transform wraps around outside the tile.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from functools import lru_cache

import torch
from torch import Tensor

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.batched import Apertures
from defocus_core.optics.parts import Part
from defocus_core.optics.pupil_field import View, joined
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import launches_cost

# Number of kernels cached for further frames, more than a picture has slices.
_KEPT = 256


def reach(radius: float, limit: int) -> int:
    """The reach of a slice's kernel in px: 0 if it is a delta, `limit` at most."""
    return 0 if abs(radius) <= 0.5 else min(math.ceil(abs(radius) - 0.5), limit)


def _transform_lengths(limit: int) -> list[int]:
    """Multiples of 16 of the form 2^a 3^b 5^c 7^d with b <= 2 and c, d <= 1.

    They transform up to 1.6 times as fast per sample as their neighbours.
    """
    odd = [3**b * 5**c * 7**d for b in range(3) for c in range(2) for d in range(2)]
    powers = [2**a for a in range(4, limit.bit_length() + 1)]
    return sorted(two * other for two in powers for other in odd if two * other <= 2 * limit)


_LENGTHS = _transform_lengths(1 << 20)


def transform_length(n: int) -> int:
    """The least fast transform length of at least n."""
    return _LENGTHS[bisect_left(_LENGTHS, n)]


def kernels(
    radii: Tensor,  # [K] signed radii in px, float64
    extent: int,  # greatest reach of the kernels in px
    aperture: Aperture,
    parts: list[Part],
    *,
    views: Sequence[View] = (),
    leaning: bool = False,
    wanted: Sequence[Sequence[bool]] = (),
) -> Tensor:
    """Kernels of all parts, in the middle of a square.

    Returns [K, 1, M, 2 extent + 1, 2 extent + 1]; [K, 3, M, ...] if leaning; [K, 1 or 3, M, B, ...]
    of the pupils of a batch.
    """
    view = joined(views) if views else None
    pupils, pictures = [(aperture, view)], wanted or [[True] * len(radii)]
    if batch := isinstance(aperture, Apertures):
        pupils = list(aperture.seeing(view))
    side, points = 2 * extent + 1, len(views) or 1
    nothing = torch.zeros(3 if leaning else 1, points, side, side, dtype=radii.dtype)

    def drawn(radius: float, pupil: Aperture, view: View | None, part: Part) -> Tensor:
        # a region keeps its own
        kernel = _kernel.__wrapped__ if pupil.requires_grad or view else _kernel
        pupil = pupil if pupil.requires_grad else pupil.fixed
        return kernel(radius, extent, pupil, part, view, leaning)

    each = [
        torch.stack(
            [
                torch.cat([drawn(radius, *pupil, part) if it else nothing for part in parts], 1)
                for radius, it in zip(radii.tolist(), own, strict=True)
            ]
        )
        for pupil, own in zip(pupils, pictures, strict=True)
    ]
    return torch.stack(each, -3) if batch else each[0]


@lru_cache(maxsize=_KEPT)
def _kernel(
    radius: float, extent: int, aperture: Aperture, part: Part, view: View | None, leaning: bool
) -> Tensor:
    """The kernels of one part, [1 or 3, V, S, S] for V points of a view, 1 without any.

    They are cached, for all frames use the same radii.
    """
    with torch.inference_mode(False):  # it is cached for calls that need gradients, too
        r = torch.tensor([radius], dtype=torch.float64, device="cpu")
        points = r if view is None else r.expand(view.points)
        plain = aperture.kernel(points, 2 * extent + 1, part, view)[None]
        if not leaning:
            return plain
        return torch.cat([plain, plain * _lens_points(r[0], extent, aperture)[:, None]])


def kernel_spectra(kernels: Tensor, window: tuple[int, int]) -> Tensor:
    """Transforms [..., height, width // 2 + 1] of kernels, centred on pixel (0, 0).

    `kernels`: [..., S, S], S an odd number; `window`: (height, width) of the transform, more than S
    // 2 each. Offsets beyond it reach no sample that is computed, see `min_transform`, and are left
    out.
    """
    size = kernels.shape[-1]
    centred, nothing = kernels, kernels.new_zeros(())
    for dim, length in ((-1, window[1]), (-2, window[0])):
        fitting = centred.narrow(dim, 0, min(size, length))
        first, last = fitting.tensor_split([size // 2], dim)
        sizes = [*centred.shape]
        sizes[dim] = length - fitting.shape[dim]
        centred = torch.cat([last, nothing.expand(sizes), first], dim)
    if launches_cost(kernels.device):
        spectra: Tensor = torch.fft.rfft2(centred)
        return spectra
    # one at a time: on some processors the batch size changes the last digits
    spectra = torch.stack([torch.fft.rfft2(one) for one in centred.reshape(-1, *window)])
    return spectra.view(*kernels.shape[:-2], *spectra.shape[-2:])


def _lens_points(radius: Tensor, extent: int, aperture: Aperture) -> Tensor:
    """The lens point u that blurs to each pixel: [2, S, S], x then y.

    u is offset / r, scaled to a mean square of 1/4 as over a round pupil, and less along an axis
    that is squeezed: kernels sampled by area are 1/12 px² wider. u is at most 1 long, so that a
    tilted kernel is never negative.
    """
    offset = torch.arange(-extent, extent + 1, dtype=radius.dtype)
    across, down = (
        offset * (radius / (radius * radius + narrower * narrower / 3))
        for narrower in aperture.narrowing
    )
    u = torch.stack(torch.meshgrid(across, down, indexing="xy"))
    return u / (u * u).sum(0).clamp(min=1).sqrt()


def sum_of_products(terms: list[tuple[Tensor, Tensor]], group: slice) -> Tensor:
    """Sum of spectra [C + 1, ...] times kernels' spectra [M, 1, ...], for a group of m parts."""

    def of_group(kernel: Tensor, spectrum: Tensor) -> Tensor:
        kernel = kernel[group]  # of each picture of a batch, or the same for all
        return kernel if kernel.dim() > spectrum.dim() else kernel[:, :, None]

    (spectrum, kernel), *others = terms
    total = spectrum * of_group(kernel, spectrum)
    for spectrum, kernel in others:
        total = total.addcmul_(spectrum, of_group(kernel, spectrum))
    return total


def crop_inverse(spectrum: Tensor, window: tuple[int, int], box: Box) -> Tensor:
    """Inverse transform of [..., h, w // 2 + 1], computed within a box alone.

    `window`: (height, width) of the transform.
    """
    top, left, height, width = box
    rows = torch.fft.ifft(spectrum, dim=-2)[..., top : top + height, :]
    whole: Tensor = torch.fft.irfft(rows, n=window[1], dim=-1)
    return whole[..., left : left + width]

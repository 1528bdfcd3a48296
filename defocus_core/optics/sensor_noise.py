"""Sensor noise: the shot noise of light and the read noise of the electronics."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from defocus_core.tensors.validation import check_image, number, positive, whole

_UNITS = "noise is counted in electrons"


def with_noise(
    light: Tensor, *, electrons: float, read: float, seed: int | Sequence[int], first_row: int = 0
) -> Tensor:
    """Light as counted by a sensor: a Poisson number of electrons, plus read noise.

    Each row has its own random numbers, so that strips of a picture have the same noise as the
    whole.

    Args:
        light: [C, H, W] or [B, C, H, W], linear. Negative light has no shot noise.
        electrons: Mean number of electrons of a light of 1.
        read: Standard deviation of the read noise in electrons, 0 or more.
        seed: A whole number, or for a batch one for each picture; equal seeds give equal noise.
        first_row: Row of the whole picture at which `light` begins, if it is a strip.

    Returns:
        Light of the same shape and dtype, on the CPU.

    Raises:
        ValueError: If an argument is out of its range or has another shape.
    """
    check_image(light, alone=True)
    positive("electrons", electrons, _UNITS)
    if not number("read", read, _UNITS) >= 0:
        raise ValueError(f"read must be 0 or more, got {read}; {_UNITS}")
    if light.dim() == 4:
        if not isinstance(seed, Sequence) or len(seed) != len(light):
            raise ValueError(f"seed must be one for each of {len(light)} pictures, got {seed}")

        def noisy_one(one: Tensor, own: int) -> Tensor:
            return with_noise(one, electrons=electrons, read=read, seed=own, first_row=first_row)

        return torch.stack([noisy_one(*each) for each in zip(light, seed, strict=True)])
    seed, first_row = whole("seed", seed, "any will do", 0), whole("first_row", first_row, "", 0)
    counts = light.detach().to("cpu", torch.float64) * electrons
    generator, noisy = torch.Generator("cpu"), torch.empty_like(counts)
    for row in range(counts.shape[-2]):
        generator.manual_seed((seed * _PRIME + first_row + row) % _MAX_SEED)
        mean = counts[:, row]
        shot = torch.poisson(mean.clamp(min=0), generator=generator) + mean.clamp(max=0)
        noise = torch.randn(mean.shape, dtype=torch.float64, generator=generator)
        noisy[:, row] = shot + read * noise
    return (noisy / electrons).to(light.dtype)


# Distance between the seeds of pictures: more than a picture has rows.
_PRIME = 1_000_003
_MAX_SEED = 2**63 - 1

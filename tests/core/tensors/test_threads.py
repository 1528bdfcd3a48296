"""Threads compute what the one that began them would, to the last bit."""

import torch

from defocus_core.tensors.threads import threaded


def test_transforms_are_those_of_the_caller():
    """Those of a new thread are shared among all cores, unless it is told: other last bits."""
    generator = torch.Generator().manual_seed(0)
    spectra = [
        torch.fft.rfft2(torch.rand(4, n, n, generator=generator)) for n in (16, 32, 64, 128, 240)
    ]

    def inverse(spectrum):
        rows = torch.fft.ifft(spectrum, dim=-2)[..., 2:-2, :]
        return torch.fft.irfft(rows, n=spectrum.shape[-2])

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        wanted = [inverse(spectrum) for spectrum in spectra]
        found = list(threaded(inverse, spectra, 2))
    finally:
        torch.set_num_threads(before)
    assert all(map(torch.equal, found, wanted))

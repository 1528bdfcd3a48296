"""Windows are long enough for what they hold, and a slice spreads as far as its kernel."""

import pytest
import torch

from defocus_core.optics.aperture import Aperture
from defocus_core.renderer.blur.kernel_bank import kernel_spectra, reach, transform_length


def test_a_transform_length_is_near_and_fast():
    for n in (*range(1, 300), 1000, 4097, 12345):
        length = transform_length(n)
        assert n <= length < 1.2 * n + 16
        assert length % 16 == 0
        for factor in (2, 3, 5, 7):
            while length % factor == 0:
                length //= factor
        assert length == 1


@pytest.mark.parametrize("r", [0.0, 0.4, 0.5, 0.51, 1.5, -1.6, 7.0, -30.49])
def test_a_slice_spreads_as_far_as_its_kernel(r):
    spread = reach(r, 1000)
    psf = Aperture().kernel(torch.tensor(r, dtype=torch.float64), 2 * spread + 3)
    assert float(psf[1:-1, 1:-1].sum()) == pytest.approx(1.0, abs=1e-12)
    if spread:
        assert psf[:, 1].sum() > 0


def test_a_kernel_wider_than_its_window_keeps_what_reaches_the_samples():
    kernel = torch.rand(1, 9, 9, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    light = torch.zeros(8, 8, dtype=torch.float64)
    light[:3, :3] = 1 + torch.arange(9).view(3, 3)
    spectrum = torch.fft.rfft2(light) * kernel_spectra(kernel, (8, 8))[0]
    blurred = torch.fft.irfft2(spectrum, s=(8, 8))[:3, :3]
    expected = torch.nn.functional.conv2d(
        light[None, None, :3, :3], kernel[None].flip(2, 3), padding=4
    )
    torch.testing.assert_close(blurred, expected[0, 0])

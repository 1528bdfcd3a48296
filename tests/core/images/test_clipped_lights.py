"""Clipped lights get light back: small ones, in their hue, and nothing else."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from defocus_core import AUTO_LIGHTS, with_lights


def street() -> Tensor:
    """A dim picture with a white lamp, an orange one, and a white wall."""
    image = 0.3 * torch.rand(3, 120, 400, generator=torch.Generator().manual_seed(1))
    image[:, 20:23, 50:53] = 1.0
    image[:, 60, 90] = torch.tensor([1.0, 0.6, 0.2])
    image[:, :, 200:] = 1.0
    return image


def test_lamps_get_the_gain_in_their_hue_and_walls_and_the_dim_stay() -> None:
    image = street()
    lit = with_lights(image, *AUTO_LIGHTS)
    assert float(lit[0, 21, 51]) > 0.7 * AUTO_LIGHTS[1]
    orange = lit[:, 60, 90]
    assert float(orange[0]) > 0.8 * AUTO_LIGHTS[1]
    torch.testing.assert_close(orange / orange[0], torch.tensor([1.0, 0.6, 0.2]))
    assert torch.equal(lit[:, :, 206:], image[:, :, 206:])
    dim = image.amax(0) < AUTO_LIGHTS[0]
    assert torch.equal(lit[:, dim], image[:, dim])


def test_the_light_is_continuous_in_the_threshold() -> None:
    image = street()
    image[:, 20, 50] = 0.85
    steps = [with_lights(image, t / 200, 16.0)[0, 20, 50] for t in range(140, 180)]
    assert torch.stack(steps).diff().abs().max() < 0.5


def test_windows_are_cut_from_the_whole() -> None:
    class Read:
        """A source that is no tensor."""

        def __init__(self, image: Tensor) -> None:
            self._image = image
            self.shape, self.dtype, self.device = tuple(image.shape), image.dtype, image.device

        def __getitem__(self, window: object) -> Tensor:
            return self._image[window]

    image = street()
    whole, source = with_lights(image, 0.8, 16.0), with_lights(Read(image), 0.8, 16.0)
    torch.testing.assert_close(source[..., 10:70, 30:100], whole[..., 10:70, 30:100])


def test_measured_light_and_alpha_stay() -> None:
    image = street()
    image[0, 5, 5] = 3.0
    assert with_lights(image, 0.8, 16.0) is image
    alpha = torch.cat([street(), torch.ones(1, 120, 400)])
    lit = with_lights(alpha, 0.8, 16.0, colors=3)
    assert torch.equal(lit[3], alpha[3])
    torch.testing.assert_close(lit[:3], with_lights(street(), 0.8, 16.0))


def test_gradients_flow_to_threshold_and_gain() -> None:
    image = street().double()[:, 10:40, 40:70]
    image[:, 4, 4] = 0.9
    values = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.8, 16.0)]
    assert torch.autograd.gradcheck(lambda t, g: with_lights(image, t, g), values, fast_mode=True)


def test_lights_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match="threshold must be"):
        with_lights(street(), 1.0, 2.0)
    with pytest.raises(ValueError, match="gain must be"):
        with_lights(street(), 0.8, 0.5)

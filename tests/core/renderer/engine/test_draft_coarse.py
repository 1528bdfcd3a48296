"""Coarse pixels of two by two px: what they hold, whichever window asks for them."""

import pytest
import torch
from torch import Tensor

from defocus_core.renderer.engine.drafts import (
    coarse_radii,
    half_size,
    hidden_at_half_size,
    in_coarse_pixels,
    means,
    surface_radii,
)
from defocus_core.tensors import derived


def noise(*size):
    return torch.rand(size, generator=torch.Generator().manual_seed(4), dtype=torch.float64)


def test_colours_of_a_cell_are_the_means_of_its_pixels():
    image = noise(3, 6, 8)
    expected = torch.nn.functional.avg_pool2d(image[None], 2)[0]
    assert torch.allclose(means(image), expected, atol=1e-15)


def test_cells_of_an_odd_frame_are_pixels_with_half_of_those_beside_them():
    image = noise(3, 5, 8)
    coarse = in_coarse_pixels(means, image)
    assert tuple(coarse.shape) == (3, 3, 4)
    pairs = image.view(3, 5, 4, 2).mean(-1)
    assert torch.allclose(
        coarse[...][:, 1], pairs[:, 1:4].mT @ torch.tensor([0.25, 0.5, 0.25]).double()
    )
    assert torch.allclose(coarse[...][:, 2], 0.75 * pairs[:, 4] + 0.25 * pairs[:, 3])
    assert torch.allclose(coarse[...].flip(1), in_coarse_pixels(means, image.flip(1))[...])


@pytest.mark.parametrize(
    ("px", "expected"),
    [
        ([1.0, 1.2, 1.4, 1.6], 1.3),  # a slope
        ([-5.0, 3.0, 3.2, 3.4], 3.2),  # one px of another surface
        ([-5.0, -5.2, 3.0, 3.4], -5.1),  # the nearer of two
        ([-5.0, -5.2, -5.4, 3.4], -5.2),
    ],
)
def test_the_radius_of_a_cell_is_that_of_the_surface_which_holds_most_of_it(px, expected):
    for order in ([0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]):
        radius = torch.tensor([px[i] for i in order], dtype=torch.float64).view(2, 2)
        plain = noise(3, 2, 2)
        assert float(surface_radii(radius, plain)) == pytest.approx(expected, abs=1e-12)
        assert float(coarse_radii(radius, plain)) == pytest.approx(expected / 2, abs=1e-12)


def test_the_light_of_a_cell_belongs_where_its_pixel_is():
    radius = torch.tensor([[-5.0, -5.2], [-5.1, 30.0]])
    image = torch.full((3, 2, 2), 0.5)
    image[:, 1, 1] = 50.0
    assert float(surface_radii(radius, image)) == 30.0
    assert float(surface_radii(radius, image.flip(-1))) == pytest.approx(-5.1)


def test_a_known_layer_in_cells_has_the_known_pixels_of_each_cell():
    mask = torch.tensor([[True, False, False, False], [True, True, False, False]])
    color = torch.tensor([[[0.3, 99.0, 99.0, 99.0], [0.6, 0.9, 99.0, 99.0]]])
    radius = torch.tensor([[4.0, torch.nan, 9.0, 9.0], [4.2, 4.4, 9.0, 9.0]])
    colors, radii, known = hidden_at_half_size((color, radius, mask), threads=1, hold=False)
    assert torch.equal(known[:], torch.tensor([[True, False]]))
    assert torch.allclose(colors[...][0], torch.tensor([[0.6, 0.0]]))
    assert torch.equal(colors[...][1], torch.zeros(1, 2))
    assert torch.allclose(radii[:], torch.tensor([[2.1, 0.0]]))


def test_windows_are_cuts_of_the_whole(monkeypatch):
    monkeypatch.setattr(derived, "HELD", 0)
    image = noise(2, 21, 34)
    whole = half_size(means, image, threads=2, hold=False)
    assert isinstance(whole, Tensor)
    coarse = in_coarse_pixels(means, image)
    assert torch.equal(coarse[...], whole)
    assert torch.equal(coarse[..., 3:9, 2:17], whole[..., 3:9, 2:17])
    assert torch.equal(coarse[..., 8:20, :], whole[..., 8:20, :])
    assert torch.equal(coarse[2:5], whole[:, 2:5])
    assert torch.equal(coarse[1:10:4, ::2], whole[:, 1:10:4, ::2])
    assert torch.equal(coarse[::8, 3::8], whole[:, ::8, 3::8])


def test_gradients_reach_the_pixels_of_the_surface():
    radius = torch.tensor([[-5.0, 3.0], [3.2, 3.4]], dtype=torch.float64, requires_grad=True)
    surface_radii(radius, torch.ones(3, 2, 2)).sum().backward()
    assert radius.grad is not None
    assert radius.grad.flatten().tolist() == pytest.approx([0.0, 1 / 3, 1 / 3, 1 / 3])

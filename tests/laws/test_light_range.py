"""What a lens sees is a mean of what there is: nothing is darker, brighter, or of other units."""

import pytest
import torch
from measures import worst

from defocus_core import HiddenLayer, render

SIZE = 48, 64
X = torch.arange(SIZE[1]).expand(SIZE)
EDGES = torch.where((X - 30).abs() < 10, -6.0, 9.0) + 0.02 * X
QUALITIES = ["standard", "high"]


def noise(*size):
    return torch.rand(size, generator=torch.Generator().manual_seed(0))


def with_lights(image, light):
    """The image with a light in a pixel of 200."""
    return torch.where(noise(*image.shape[-2:]) < 0.005, light, image)


@pytest.mark.parametrize("base", [0.0, 0.3])
@pytest.mark.parametrize("r", [0.8, 3.3, -9.9, 23.9])
def test_doubling_a_light_doubles_its_picture(r, base):
    """Also where it becomes a highlight by that, and where layers are blurred at half size."""
    image, radius = torch.full((3, 81, 81), base), torch.full((81, 81), r)
    image[:, 40, 40] += 0.5
    once = render(image, radius).render - base
    for times in (2, 4, 8):
        image[:, 40, 40] = base + 0.5 * times
        more = render(image, radius).render - base
        assert worst(more, times * once) < 5e-3 * float(more.max())


@pytest.mark.parametrize("quality", QUALITIES)
def test_opaque_alpha_stays_opaque(quality):
    image = torch.cat([with_lights(0.5 * noise(3, *SIZE), 80.0), torch.ones(1, *SIZE)])
    views = render(image, EDGES, quality=quality, left_right=True)
    for view in views.images:
        assert float((view[3] - 1).abs().max()) < 1e-6


@pytest.mark.parametrize("quality", QUALITIES)
def test_known_hidden_colours_are_in_the_range_of_what_is_seen(quality):
    image = with_lights(torch.full((3, *SIZE), 0.2), 100.0)
    for color in (0.15, 150.0):
        hidden = HiddenLayer(torch.full_like(image, color), torch.full(SIZE, 9.0), image[0] < 1e9)
        shown = render(image, EDGES, quality=quality, hidden=hidden).render
        assert float(shown.min()) >= min(color, 0.2) * (1 - 1e-4)
        assert float(shown.max()) <= max(color, 100.0) * (1 + 1e-4)
        assert float(shown.min()) < 0.195 or color > 1


@pytest.mark.parametrize("tiny", [1e-44, 1e-39, 1e-37])
def test_numbers_next_to_0_beside_a_light_are_as_dark_as_0(tiny):
    """All of the picture was NaN: they were lights beyond a limit of 0, which was divided by 0."""
    image = torch.zeros(3, *SIZE)
    image[:, 8, 8] = 1.0
    radius = torch.full(SIZE, 0.55)
    expected = render(image, radius).render
    image[:, 8, 9] = tiny
    shown = render(image, radius).render
    assert float((shown - expected).abs().max()) < 1e-6


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("factor", [1e-30, 1e30])
@pytest.mark.parametrize("light", [0.9, 0.01])
def test_light_has_no_unit(quality, dtype, factor, light):
    image = with_lights(light * noise(3, *SIZE), 0.9).to(dtype)
    radius = EDGES.to(dtype)
    expected = render(image, radius, quality=quality, left_right=True)
    shown = render(image * factor, radius, quality=quality, left_right=True)
    for view, other in zip(shown.images, expected.images, strict=True):
        assert float((view.double() / factor - other.double()).abs().max()) < 1e-5 * 0.9

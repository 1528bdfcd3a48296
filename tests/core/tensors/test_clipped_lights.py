"""Clipped lights get light back: small ones, in their hue, and nothing else."""

import colorsys

import pytest
import torch

from defocus_core import render, with_lights
from defocus_core.allowed_values import AUTO_LIGHTS
from defocus_core.tensors.clipped_lights import ClippedLights, Runs


def street():
    """A dim picture with a white lamp, an orange one, and a white wall."""
    image = 0.3 * torch.rand(3, 120, 400, generator=torch.Generator().manual_seed(1))
    image[:, 20:23, 50:53] = 1.0
    image[:, 60, 90] = torch.tensor([1.0, 0.6, 0.2])
    image[:, :, 200:] = 1.0
    return image


def test_lamps_get_the_gain_in_their_hue_and_walls_and_the_dim_stay():
    image = street()
    lit = with_lights(image)
    assert float(lit[0, 21, 51]) > 0.7 * AUTO_LIGHTS[1]
    orange = lit[:, 60, 90]
    assert float(orange[0]) > 0.8 * AUTO_LIGHTS[1]
    torch.testing.assert_close(orange / orange[0], torch.tensor([1.0, 0.6, 0.2]))
    assert torch.equal(lit[:, :, 200:], image[:, :, 200:])
    dim = image.amax(0) < AUTO_LIGHTS[0]
    assert torch.equal(lit[:, dim], image[:, dim])


def test_all_of_a_blob_gets_one_gain_and_blobs_are_counted():
    image = street()
    image[:, 70:74, 20:26] = 1.0
    lights = ClippedLights(image, *AUTO_LIGHTS)
    assert lights.count == 3
    blob = lights.added[:, 70:74, 20:26]
    assert float(blob.min()) == float(blob.max()) > 0.5 * AUTO_LIGHTS[1]
    assert ClippedLights(street(), 0.99, 16.0).count == 2
    assert ClippedLights(torch.full((3, 9, 9), 0.2), *AUTO_LIGHTS).count == 0


@pytest.mark.parametrize("ground", [0.88, 0.8])
def test_small_spots_of_a_bright_wall_just_beyond_white_stay(ground):
    image = torch.full((3, 120, 400), ground)
    image[:, 20:23, 50:53] = 1.0
    share = (float(with_lights(image)[0, 21, 51]) - 1) / (AUTO_LIGHTS[1] - 1)
    assert share < {0.88: 0.01, 0.8: 0.3}[ground]
    image[:, 10:33, 40:63] *= 0.3  # of a lamp the surroundings are dark
    image[:, 20:23, 50:53] = 1.0
    assert float(with_lights(image)[0, 21, 51]) > 0.8 * AUTO_LIGHTS[1]


def test_a_surface_of_a_colour_stays_where_a_white_one_of_its_size_is_a_lamp():
    image = torch.full((3, 300, 400), 0.1)
    image[:, 100:107, 100:107] = torch.tensor([0.1, 0.4, 1.0])[:, None, None]
    image[:, 200:207, 100:107] = 1.0
    lit = with_lights(image)
    assert float(lit[2, 103, 103]) < 0.3 * AUTO_LIGHTS[1]
    assert float(lit[2, 203, 103]) == AUTO_LIGHTS[1]
    image[:, 20:140, 60:160] = torch.tensor([0.1, 0.4, 1.0])[:, None, None]
    assert torch.equal(with_lights(image)[:, 20:140], image[:, 20:140])


def test_the_light_is_continuous_in_the_threshold_where_blobs_grow_together():
    image = street()
    image[:, 20, 50] = 0.85
    image[:, 20, 53:202] = 0.82  # a bridge from the lamp to the wall
    lit = [with_lights(image, t / 400, 16.0) for t in range(280, 380, 10)]
    steps = torch.stack([each[0, 20:23, 50:53] for each in lit]).diff(dim=0).abs()
    assert steps.max() < 2
    assert lit[0][0, 21, 51] < 0.7 * lit[-1][0, 21, 51]


def test_measured_light_and_alpha_stay():
    image = street()
    image[0, 5, 5] = 3.0
    assert with_lights(image, 0.8, 16.0) is image
    alpha = torch.cat([street(), torch.ones(1, 120, 400)])
    lit = with_lights(alpha, 0.8, 16.0, colors=3)
    assert torch.equal(lit[3], alpha[3])
    torch.testing.assert_close(lit[:3], with_lights(street(), 0.8, 16.0))


def test_gradients_flow_to_threshold_and_gain():
    image = street().double()[:, 10:40, 40:70]
    image[:, 4, 4] = 0.9
    values = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.8, 16.0)]
    assert torch.autograd.gradcheck(lambda t, g: with_lights(image, t, g), values, fast_mode=True)


def test_what_is_in_focus_is_left_alone():
    image, blurred = street(), torch.full((120, 400), -9.0)
    every = ClippedLights(image, *AUTO_LIGHTS)
    assert torch.equal(ClippedLights(image, *AUTO_LIGHTS, signed_radius=blurred).added, every.added)
    blurred[:40] = 0.3
    partly = ClippedLights(image, *AUTO_LIGHTS, signed_radius=blurred)
    assert torch.equal(partly.added[:, :40], image[:, :40])
    assert torch.equal(partly.added[:, 40:], every.added[:, 40:])
    assert partly.count == every.count - 1


@pytest.mark.parametrize("blur", [0.2, 2.4])
def test_no_lamps_are_lint_on_the_subject_a_shirt_or_leaves(blur):
    image, radius = torch.full((3, 600, 800), 0.15), torch.full((600, 800), 12.0)
    radius[150:, 250:550] = blur  # a person about in focus, in a dark coat
    for k in range(20):
        image[:, 200 + 17 * k : 202 + 17 * k, 270 + 37 * k % 260 :][:, :, :3] = 1.0
    image[:, 300:550, 600:680] = 1.0  # a shirt, blurred, whose folds divide a part of it
    image[:, 320:400, 610:660:10] = image[:, 320:400:8, 610:660] = 0.75
    for k in range(10):  # leaves in the sun before others
        image[:, 10 + 12 * k : 17 + 12 * k, 20:40] = torch.tensor([0.85, 1.0, 0.5])[:, None, None]
    assert ClippedLights(image, *AUTO_LIGHTS, signed_radius=radius).count == 0


def lamp(light, sigma):
    """A picture of 8 bits of a lamp, in its middle as bright as light [3]."""
    y, x = torch.meshgrid(torch.arange(240.0), torch.arange(320.0), indexing="ij")
    away = torch.hypot(y - 120, x - 160)
    light = torch.tensor(light).view(3, 1, 1) * torch.exp(-((away / sigma) ** 2) / 2)
    return ((0.05 + light).clamp(max=1).pow(1 / 2.2) * 255).round().div(255).pow(2.2)


def hue(light):
    """The hue in degrees of linear light [3, n], as a screen shows its mean."""
    red, green, blue = light.mean(1).clamp(0, 1).pow(1 / 2.2).tolist()
    return 360 * colorsys.rgb_to_hsv(red, green, blue)[0]


@pytest.mark.parametrize("blur", [6.0, 25.0])
@pytest.mark.parametrize(
    "light", [(8.0, 4.8, 1.6), (4.0, 2.8, 1.4), (20.0, 12.0, 4.0), (2.0, 3.0, 8.0)]
)
def test_the_disc_of_a_lamp_has_the_hue_of_its_unclipped_rim(light, blur):
    image, radius = lamp(light, 2.0), torch.full((240, 320), blur)
    rim = (image.amax(0) < 0.93) & (image.amax(0) > 0.3)
    lit = with_lights(image, signed_radius=radius)
    shown = render(lit, radius, depth_repair="off").render[:, 118:123, 158:163].flatten(1)
    apart = abs(hue(shown) - hue(image[:, rim] - 0.05))
    assert min(apart, 360 - apart) < 10
    assert shown.amin(0).max() < 0.7, "it is no paper-white cut-out"


def test_the_gain_follows_how_much_of_a_lamp_is_clipped():
    lit = [with_lights(lamp((light,) * 3, 1.0), *AUTO_LIGHTS) for light in (1.2, 2.0, 4.0, 16.0)]
    gains = [float(each.amax()) for each in lit]
    assert gains == sorted(gains)
    assert gains[-1] > 1.5 * gains[0] > 1.5


def test_the_disc_of_a_lamp_stays_below_white_and_a_lamp_is_never_dimmed():
    image = torch.full((3, 240, 320), 0.05)
    image[:, 118:123, 158:163] = 1.0
    for blur in (4.0, 8.0, 16.0):
        radius = torch.full((240, 320), blur)
        lit = with_lights(image, 0.93, 100.0, signed_radius=radius)
        assert lit[:, 118:123, 158:163].min() >= 1
        assert render(lit, radius, depth_repair="off").render.max() < 1.01


def test_a_white_lamp_stays_white_before_coloured_surroundings():
    image = lamp((30.0, 30.0, 30.0), 0.7) * torch.tensor([1.0, 0.6, 0.3]).view(3, 1, 1)
    image[:, 115:126, 155:166] = lamp((30.0, 30.0, 30.0), 0.7)[:, 115:126, 155:166]
    lit = with_lights(image)[:, 120, 160]
    torch.testing.assert_close(lit / lit[0], torch.ones(3), atol=0.02, rtol=0)


@pytest.mark.parametrize("sides", [(1.2, 3.0), (1.0, 4.5)])
def test_a_lamp_is_the_same_in_a_picture_that_lies_on_its_side(sides):
    """Its rim and its surroundings are looked for on all sides."""
    y, x = torch.meshgrid(torch.arange(240.0), torch.arange(320.0), indexing="ij")
    away = torch.hypot((y - 120) / sides[0], (x - 160) / sides[1])
    light = torch.tensor([8.0, 4.8, 1.6]).view(3, 1, 1) * torch.exp(-(away**2) / 2)
    image = (0.05 + light + 0.001 * y).clamp(max=1)
    on_its_side = with_lights(image.mT.contiguous()).mT
    assert with_lights(image).amax() > 2
    torch.testing.assert_close(on_its_side, with_lights(image))


def flooded(mask):
    """A number for each blob of a mask, 0 outside: the greatest of its pixels' numbers spreads."""
    numbers = mask * (1.0 + torch.arange(mask.numel()).view(mask.shape))
    for _ in range(mask.numel()):
        numbers = mask * torch.nn.functional.max_pool2d(numbers[None], 3, 1, 1)[0]
    return numbers


@pytest.mark.parametrize("share", [0.0, 0.2, 0.45, 0.7, 1.0])
def test_blobs_are_the_areas_of_a_flood(share):
    mask = torch.rand(40, 33, generator=torch.Generator().manual_seed(3)) < share
    runs = Runs.from_mask(mask)
    assert int((runs.end - runs.first).sum()) == int(mask.sum())
    row, column = mask.nonzero().unbind(1)
    found = runs.blobs()[runs.holding(row, column)]
    expected = flooded(mask)[row, column]
    pairs = torch.stack([found, expected]).unique(dim=1)
    assert pairs.shape[1] == len(found.unique()) == len(expected.unique())

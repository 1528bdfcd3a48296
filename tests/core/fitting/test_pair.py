"""The blur between two pictures is found again, whatever else differs between them."""

from functools import cache

import pytest
import torch

from defocus_core import DualPixel, fit, render

# A fit renders by torch: pairs that it makes, too, differ in nothing else than they should.
pytestmark = pytest.mark.usefixtures("torch_back")

STRENGTH, FOCUS = 14.0, 0.45  # px for a disparity of 1; disparity


def scene(side=64):
    """Textured slopes and a card: light [3, H, W] and disparity [H, W]."""
    generator = torch.Generator().manual_seed(3)
    fine = torch.rand(3, side, side, generator=generator)
    coarse = torch.rand(1, 3, side // 8, side // 8, generator=generator)
    image = 0.5 * fine + 0.5 * torch.nn.functional.interpolate(coarse, side, mode="bilinear")[0]
    disparity = torch.linspace(0.05, 0.6, side)[:, None].repeat(1, side)
    disparity[side // 4 : side // 2, side // 3 : 2 * side // 3] = 0.9
    return image, disparity


def blurred(image, disparity, **options):
    return render(image, STRENGTH * (FOCUS - disparity), **options).render


@cache
def plainly():
    """The fit of a pair that differs in blur alone."""
    image, disparity = scene()
    return fit(image, disparity, blurred(image, disparity))


def test_focus_and_strength_are_found_from_two_pictures():
    found = plainly()
    assert found.strength == pytest.approx(STRENGTH, rel=0.01)
    assert found.focus == pytest.approx(FOCUS, abs=0.01)
    assert found.strength_error < 0.02
    assert found.psnr > 40
    assert found.explained > 0.99
    assert found.gains == (1, 1, 1)


def test_depth_of_unknown_scale_and_another_white_balance_give_the_same_radii():
    image, disparity = scene()
    gains = torch.tensor([0.8, 1.1, 1.3])
    observed = blurred(image, disparity) * gains[:, None, None]
    found = fit(image, 40 - 7 * (1 - disparity.double()), observed, exposure=True)
    radius = found.strength * (found.focus - (40 - 7 * (1 - disparity)))
    wanted = STRENGTH * (FOCUS - disparity)
    assert float((radius - wanted).abs().median()) < 0.02 * float(wanted.abs().median())
    assert found.gains == pytest.approx(gains.tolist(), rel=0.01)


def test_a_falloff_of_light_that_differs_between_the_sides_misleads_no_exposure():
    image, disparity = scene()
    views = render(image, STRENGTH * (FOCUS - disparity), left_right=True)
    y, x = torch.meshgrid(*[torch.linspace(-1, 1, 64)] * 2, indexing="ij")
    corners = 1 / (1 + 0.4 * (x**2 + y**2)) ** 2  # cos⁴ of the angle
    pair = views.left * corners * (1 - 0.2 * x), views.right * corners * (1 + 0.1 * x)
    found = fit(image, disparity, pair, exposure=True, shift=True, crosstalk=True)
    assert found.strength == pytest.approx(STRENGTH, rel=0.01)
    assert found.focus == pytest.approx(FOCUS, abs=0.002)
    assert found.shift == pytest.approx((0, 0), abs=0.02)
    assert found.dual_pixel.crosstalk < 0.01
    assert found.psnr > 50


def test_a_search_crosses_the_focus_to_the_same_blur_on_its_other_side():
    """A wall that is 1.4 px beyond the focus looks as one that is as much nearer."""
    image, _ = scene()
    wall = torch.linspace(0.05, 0.15, 64)[:, None].repeat(1, 64)
    wall[20:44, 20:44] = 0.9
    observed = render(image, 14 * (0.2 - wall)).render
    found = fit(image, wall, observed)
    assert found.focus == pytest.approx(0.2, abs=0.002)
    assert found.strength == pytest.approx(14, rel=0.005)


def test_the_crosstalk_and_the_sides_of_a_pair_are_found_with_the_lens():
    image, disparity = scene()
    sensor = DualPixel("smooth", 0.1)
    views = render(image, STRENGTH * (FOCUS - disparity), left_right=True, dual_pixel=sensor)
    pair = (views.right, views.left)
    found = fit(image, disparity, pair, dual_pixel=DualPixel("smooth"), crosstalk=True)
    assert found.dual_pixel.crosstalk == pytest.approx(0.1, abs=0.01)
    assert found.exchanged
    assert found.strength == pytest.approx(STRENGTH, rel=0.01)


def pair_of_waves(magnification, shift, side=96):
    """Sharp [3, H, W], disparity [H, W] and blurred light, which is evaluated where it lies."""
    generator = torch.Generator().manual_seed(4)
    count, (across, down) = 120, shift
    frequency = 0.5 * torch.randn(count, 2, 1, 1, generator=generator, dtype=torch.float64)
    phase = 6.3 * torch.rand(count, 1, 1, generator=generator, dtype=torch.float64)

    def light(x, y):
        waves = torch.sin(frequency[:, 0] * x + frequency[:, 1] * y + phase)
        return (0.5 + 0.4 * waves.sum(0) / count**0.5).clamp_min(0).float().expand(3, -1, -1)

    y, x = torch.meshgrid(*[torch.arange(side).double() - (side - 1) / 2] * 2, indexing="ij")
    disparity = torch.linspace(0.05, 0.9, side)[:, None].repeat(1, side)
    source = (x - across) / magnification, (y - down) / magnification
    place = (source[1] / (side - 1) + 0.5).float()
    there = blurred(light(*source), 0.05 + 0.85 * place)
    return light(x, y), disparity, there


def test_magnification_and_shift_of_a_pair_are_found():
    magnification, shift = 0.995, (-2.3, 0.4)
    sharp, disparity, observed = pair_of_waves(magnification, shift)
    found = fit(sharp, disparity, observed, shift=True)
    assert found.magnification == pytest.approx(magnification, abs=3e-4)  # 0.02 px at the border
    assert found.shift == pytest.approx(shift, abs=0.05)
    assert found.strength == pytest.approx(STRENGTH, rel=0.01)
    assert found.focus == pytest.approx(FOCUS, abs=0.005)


def test_lights_that_are_clipped_do_not_mislead():
    """A light of 60 spreads as a disc, of which the clipped light of 1 explains nothing."""
    image, disparity = scene()
    image = 0.7 * image
    image[:, 10::20, 10::20] = 60.0
    observed = blurred(image, disparity).clamp(max=1)
    found = fit(image.clamp(max=1), disparity, observed)
    assert found.strength == pytest.approx(STRENGTH, rel=0.002)
    assert found.psnr > 45


def test_pictures_of_which_all_is_clipped_are_refused():
    image, disparity = scene()
    with pytest.raises(ValueError, match="hardly a pixel can be used"):
        fit(torch.ones_like(image), disparity, torch.ones_like(image))


def test_pictures_that_do_not_differ_are_explained_by_no_blur():
    image, disparity = scene()
    assert fit(image, disparity, image).explained == 0


def test_depth_is_repaired_in_a_fit_as_it_is_asked_for():
    """Edges of depth that are soft by 3 px: with and without their repair other pictures fit."""
    image, disparity = scene()
    box = torch.ones(1, 1, 7, 7) / 49
    padded = torch.nn.functional.pad(disparity[None, None], (3, 3, 3, 3), mode="replicate")
    soft = torch.nn.functional.conv2d(padded, box)[0, 0]
    observed = blurred(image, disparity)
    repaired, as_given = (
        fit(image, soft, observed, depth_repair=repair) for repair in ("auto", "off")
    )
    assert repaired.psnr > as_given.psnr
    with pytest.raises(ValueError, match="edge_width=4"):
        fit(image, soft, observed, depth_repair="off", edge_width=4.0)


@pytest.mark.parametrize(("near", "far"), [(3.0, 9.0), (-12.0, -3.0)])
def test_any_lens_of_cards_is_found(near, far):
    """A descent alone ends elsewhere from most starts."""
    image, disparity = scene()
    ends = float(disparity.min()), float(disparity.max())
    strength = (far - near) / (ends[1] - ends[0])
    focus = ends[0] + far / strength
    found = fit(image, disparity, render(image, strength * (focus - disparity)).render)
    assert found.strength == pytest.approx(strength, rel=0.01)
    assert found.focus == pytest.approx(focus, abs=0.01)

"""Layers with coverage: what is known behind each other is rendered as it is, with alpha."""

import pytest
import torch
from launches import Launches
from layers import brute_force
from measures import inner, psnr
from torch.autograd import gradcheck

from defocus_core import render, render_layers

SIZE = (72, 84)


def disc(row, column, size):
    """Coverage of a round card with an anti-aliased edge."""
    y, x = (torch.arange(n, dtype=torch.float32) for n in SIZE)
    away = torch.hypot(y[:, None] - row, x - column)
    return (size - away + 0.5).clamp(0, 1)


def scene(radii, seed=0):
    """A layer of three cards of like colours for each radius; premultiplied."""
    generator = torch.Generator().manual_seed(seed)
    colors, coverages = [], []
    for _ in radii:
        coverage, color = torch.zeros(SIZE), torch.zeros(3, *SIZE)
        for _ in range(3):
            row, column, size = torch.rand(3, generator=generator).tolist()
            card = disc(10 + 52 * row, 10 + 64 * column, 8 + 8 * size)
            tint = torch.rand(3, 1, 1, generator=generator)
            color, coverage = (x * (1 - card) for x in (color, coverage))
            color, coverage = color + tint * card, coverage + card
        colors.append(color)
        coverages.append(coverage)
    radius = torch.tensor(radii)[:, None, None].expand(-1, *SIZE)
    return torch.stack(colors), radius, torch.stack(coverages)


def test_one_opaque_layer_is_the_rendering_of_the_picture():
    generator = torch.Generator().manual_seed(1)
    image = torch.rand(3, *SIZE, generator=generator)
    radius = torch.where(disc(30, 40, 12) > 0.5, -6.0, 3.0)
    plain = render(image, radius, left_right=True)
    views = render_layers(image[None], radius[None], torch.ones(1, *SIZE), left_right=True)
    for one, other in zip(views.images, plain.images, strict=True):
        assert torch.equal(one[:-1], other)
        assert bool((one[-1] == 1).all())


def test_layers_come_in_any_order():
    colors, radius, coverage = scene((-6.0, 2.0, 5.0))
    views = render_layers(colors, radius, coverage)
    turned = render_layers(colors.flip(0), radius.flip(0), coverage.flip(0))
    assert torch.equal(views.render, turned.render)


def test_without_coverage_there_is_nothing_whatever_colour_and_radius_say():
    colors, radius, coverage = scene((-6.0, 2.0))
    plain = render_layers(colors, radius, coverage).render
    nothing = coverage == 0
    colors = torch.where(nothing[:, None], torch.nan, colors)
    for wrong in (torch.nan, torch.inf, -1e9, 0.0):
        views = render_layers(colors, torch.where(nothing, wrong, radius), coverage)
        assert torch.equal(views.render, plain)


def test_opaque_white_layers_are_white_to_the_border():
    radius = torch.stack([torch.linspace(-9, 3, SIZE[1]).expand(SIZE), torch.full(SIZE, 7.0)])
    _, _, coverage = scene((-5.0, 6.0))
    coverage[1] = 1.0
    white = coverage[:, None].expand(-1, 3, -1, -1)
    views = render_layers(white, radius, coverage)
    assert (views.render - 1).abs().max() < 1e-5
    views = render_layers(torch.ones(1, 3, *SIZE), radius[:1], torch.ones(1, *SIZE))
    assert (views.render - 1).abs().max() < 1e-5


@pytest.mark.parametrize(
    ("radii", "minimum"),
    [((-6.0, -2.0), 37.0), ((-6.0, 0.0), 43.0), ((2.0, 7.0), 32.0), ((-6.0, 1.0, 6.0), 35.0)],
)
def test_the_picture_is_near_the_brute_force_one(radii, minimum):
    colors, radius, coverage = scene(radii, 3)
    truth = inner(brute_force(colors, radius, coverage), 9)
    views = render_layers(colors, radius, coverage)
    assert psnr(inner(views.render, 9).double(), truth) > minimum


def test_what_layers_know_is_not_invented():
    colors, radius, coverage = scene((-6.0, 3.0))
    colors[1], coverage[1] = 0.5, 1.0
    colors[0] = 0.0
    views = render_layers(colors, radius, coverage)
    shadow = views.render[:3] / 0.5
    assert bool((views.render[3] > 1 - 1e-5).all())
    alone = render_layers(coverage[:1, None], radius[:1], coverage[:1]).render[1]
    assert psnr(inner(shadow[0], 9), inner(1 - alone, 9)) > 45


@pytest.mark.parametrize(("ends", "plate"), [((0.0, 0.9), 9.0), ((-2.0, 2.0), 7.0)])
def test_an_opaque_ball_lets_nothing_through_whatever_lies_behind(ends, plate):
    y, x = (torch.arange(n, dtype=torch.float32) for n in SIZE)
    away = torch.hypot(y[:, None] - 36, x - 42)
    front = (1 - (away / 30).square()).clamp(min=0).sqrt()
    radius = ends[1] + (ends[0] - ends[1]) * front
    radius = (radius * 64).round() / 64  # as half floats of depth have it
    coverage = torch.stack([(30.5 - away).clamp(0, 1), torch.ones(SIZE)])
    colors = torch.stack([torch.zeros(3, *SIZE), torch.ones(3, *SIZE)])
    radii = torch.stack([radius, torch.full(SIZE, plate)])
    views = render_layers(colors, radii, coverage, left_right=True)
    inside = away < 29 - 2 * ends[1]  # no edge is in reach
    for image in views.images:
        assert image[:3, inside].abs().max() < 1e-5
        assert (image[3] - 1).abs().max() < 1e-5


def test_an_element_ends_at_its_silhouette():
    card = disc(36, 42, 14)
    radius = torch.where(disc(36, 42, 6) > 0, -7.0, 5.0)[None]
    views = render_layers(card[None, None] * 0.5, radius, card[None])
    truth = brute_force(card[None, None] * 0.5, torch.full_like(radius, 5.0), card[None])
    ring = disc(36, 42, 19) - disc(36, 42, 14) > 0.99
    assert (views.render[1] - truth[1])[ring].abs().max() < 0.02
    assert bool((views.render[1][disc(36, 42, 6) == 1] > 0.97).all())


def test_tiles_threads_and_views_do_not_change_the_centre():
    colors, radius, coverage = scene((-6.0, 2.0, 5.0))
    plain = render_layers(colors, radius, coverage).render
    same = render_layers(colors, radius, coverage, threads=3, left_right=True)
    assert torch.equal(same.render, plain)
    other = render_layers(colors, radius, coverage, tile=32).render
    assert (other - plain).abs().max() < 1e-5


def test_a_light_keeps_its_energy_behind_what_hides_half_of_it():
    colors, radius, coverage = scene((-6.0, 5.0))
    colors[:], coverage[:] = 0.0, 0.0
    colors[1, :, 36, 42], coverage[1, 36, 42] = 500.0, 0.5
    coverage[0] = 0.5
    light = render_layers(colors, radius, coverage).render[0]
    assert light[12:-12, 12:-12].sum() == pytest.approx(250.0, rel=0.01)
    coverage[0] = disc(36, 42, 0)
    light = render_layers(colors, radius, coverage).render[0].sum()
    assert light == pytest.approx(float(brute_force(colors, radius, coverage)[0].sum()), rel=0.01)


def test_gradients_reach_colours_radii_and_coverage():
    generator = torch.Generator().manual_seed(2)
    colors = torch.rand(2, 1, 6, 6, generator=generator, dtype=torch.float64)
    coverage = 0.2 + 0.6 * torch.rand(2, 6, 6, generator=generator, dtype=torch.float64)
    radius = torch.tensor([-2.3, 1.6], dtype=torch.float64)[:, None, None].expand(2, 6, 6)
    radius = radius + 0.1 * torch.rand(2, 6, 6, generator=generator, dtype=torch.float64)
    inputs = tuple(x.requires_grad_() for x in (colors * coverage[:, None], radius, coverage))

    def rendered(*layers):
        return render_layers(*layers).render

    values = tuple(x.detach().requires_grad_() for x in inputs)
    assert gradcheck(rendered, values, atol=1e-6, fast_mode=True)


def test_at_the_border_alpha_expects_what_each_sample_of_a_pixel_sees_of_the_frame():
    radius = torch.tensor([-8.0, 5.0, 2.0])[:, None, None].expand(-1, *SIZE)
    coverage = torch.stack([disc(3, 40, 9) * 0.6, torch.ones(SIZE), disc(60, 2, 1)])
    coverage[1, 60:64, 40:44] = 0  # so that the picture is open
    white = coverage[:, None].expand(-1, 3, -1, -1)
    alpha = render_layers(white, radius, coverage).render[-1]
    assert alpha[:40].min() > 0.75
    assert alpha[:40].mean() > 0.99


@pytest.mark.parametrize("is_open", [True, False])
def test_layers_of_one_sample_a_pixel_are_one_picture(is_open):
    colors, radius, coverage = scene((-6.0, 4.0))
    near = disc(30, 40, 12) > 0.5
    far = ~near if not is_open else ~near & (disc(36, 42, 28) > 0.5)
    coverage = torch.stack([near, far]).float()
    colors = coverage[:, None] * colors.clamp(min=0.1)
    whole = colors.sum(0)[None], torch.where(near, radius[0], radius[1])[None], coverage.sum(0)
    apart = render_layers(colors, radius, coverage, left_right=True)
    together = render_layers(whole[0], whole[1], whole[2][None], left_right=True)
    for one, other in zip(apart.images, together.images, strict=True):
        assert torch.equal(one, other)


def test_work_grows_with_the_number_of_layers_and_not_with_its_square():
    launches = []
    for count in (40, 80):
        color, depth = torch.rand(count, 3, 8, 8), torch.linspace(-5, 5, count)
        with Launches("cpu") as counts:
            radius = depth.view(-1, 1, 1).expand(-1, 8, 8)
            render_layers(0.1 * color, radius, torch.full_like(radius, 0.1))
        launches.append(counts.launches)
    assert launches[1] < 2 * launches[0]

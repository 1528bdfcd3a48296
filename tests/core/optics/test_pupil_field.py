"""A field of pupils: a point is the mix of the kernels around it, and the laws hold."""

import math

import pytest
import torch

from defocus_core import Aperture, PupilField, PupilImage, render, render_layers

SIZE = (96, 160)  # H, W


def kernels(rows=2, columns=3, side=25):
    """Discs of which each place of the grid has lost another side."""
    v = (torch.arange(side, dtype=torch.float64) - side // 2) / (side // 2)
    disc = (v[None, :] ** 2 + v[:, None] ** 2 <= 1).double()
    cut = [
        disc * (v[None, :] * (c - (columns - 1) / 2) <= 0.4) * (v[:, None] * (r - 0.5) <= 0.3)
        for r in range(rows)
        for c in range(columns)
    ]
    return torch.stack(cut).reshape(rows, columns, side, side)


FIELD = PupilField(kernels())


def light(x, y, r, **options):
    image = torch.zeros(1, *SIZE)
    image[0, y, x] = 1e3
    return render(image, torch.full(SIZE, r), **options).render[0] / 1e3


def expected(x, y, r):
    """The kernels of the grid resampled at a radius, each of sum 1, mixed by place."""
    rows, columns = FIELD.grid
    total = torch.zeros(SIZE, dtype=torch.float64)
    middle, radius = FIELD._middle, FIELD._radius
    fine = 10
    for row in range(rows):
        for column in range(columns):
            down = max(0, 1 - abs(min(max((y + 0.5) * rows / SIZE[0] - 0.5, 0), rows - 1) - row))
            place = min(max((x + 0.5) * columns / SIZE[1] - 0.5, 0), columns - 1)
            weight = down * max(0, 1 - abs(place - column))
            picture = kernels()[row, column]
            v, u = (
                ((torch.arange(n * fine) + 0.5) / fine - at - 0.5) / r * radius + m
                for n, at, m in zip(SIZE, (y, x), reversed(middle), strict=True)
            )
            inside = ((v >= 0) & (v < 25))[:, None] & ((u >= 0) & (u < 25))
            values = picture[v.long().clamp(0, 24)][:, u.long().clamp(0, 24)] * inside
            shown = values.reshape(SIZE[0], fine, SIZE[1], fine).mean((1, 3))
            total += weight * shown / shown.sum()
    return total


@pytest.mark.parametrize(("x", "y", "r"), [(80, 48, 20.0), (130, 30, 14.0), (40, 60, -16.0)])
def test_a_light_is_the_mix_of_the_kernels_around_it(x, y, r):
    shown = light(x, y, r, aperture=Aperture(image=FIELD))
    wanted = expected(x, y, r)
    assert float(shown.sum()) == pytest.approx(1, abs=1e-4)
    error = float(((shown - wanted) ** 2).mean())
    assert 10 * math.log10(float(wanted.max()) ** 2 / error) > 45


def scene():
    generator = torch.Generator().manual_seed(2)
    radius = torch.linspace(-8, 12, SIZE[0])[:, None].repeat(1, SIZE[1])
    radius[30:60, 50:100] = -6.0
    return torch.rand(2, *SIZE, generator=generator), radius


def test_equal_kernels_are_one_pupil():
    image, radius = scene()
    one = kernels()[:1, :1]
    alike = PupilField(one.expand(3, 2, -1, -1))
    plain = render(image, radius, aperture=Aperture(image=PupilImage(one[0, 0]))).render
    assert (render(image, radius, aperture=Aperture(image=alike)).render - plain).abs().max() < 2e-4


@pytest.mark.parametrize("quality", ["draft", "standard", "high"])
def test_white_stays_white_and_the_pair_makes_the_centre(quality):
    image, radius = scene()
    options = {"aperture": Aperture(image=FIELD), "quality": quality, "left_right": True}
    white = render(torch.ones_like(image), radius, **options)
    assert all((view - 1).abs().max() < 1e-5 for view in white.images)
    views = render(image, radius, **options)
    assert ((views.left + views.right) / 2 - views.render).abs().max() < 1e-6
    layers = render_layers(
        torch.ones(1, 1, *SIZE), radius[None], torch.ones(1, *SIZE), aperture=Aperture(image=FIELD)
    )
    assert (layers.render - 1).abs().max() < 1e-5


def test_the_field_changes_over_the_frame_and_turns_with_it():
    image, radius = scene()
    shown = render(image, radius, aperture=Aperture(image=FIELD)).render
    turned = render(image.mT, radius.mT, aperture=Aperture(image=FIELD).transposed()).render.mT
    assert (turned - shown).abs().max() < 2e-4
    mean = render(image, radius, aperture=Aperture(image=PupilImage(kernels().sum((0, 1))))).render
    assert (mean - shown).abs().max() > 0.02
    assert PupilField(kernels()) == FIELD != PupilField(kernels().flip(1))

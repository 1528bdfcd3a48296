"""Depth in few levels looks like the slope that it was; flat cards and smooth depth stay."""

import torch
from measures import worst
from renderers import repair_of

from defocus_core import render
from defocus_core.depth.smoothing import without_terraces

SIZE = (96, 144)
LEVELS = 48


def slope():
    """Radii of a bent surface from 0 to 38 px, at most 0.35 px per px."""
    y, x = (torch.arange(n, dtype=torch.float64) for n in SIZE)
    return 0.2 * x + 0.001 * (y[:, None] - 20) ** 2 + 0.02 * y[:, None]


def in_levels(radius, count=LEVELS):
    """The same in so many levels, evenly spaced."""
    minimum, maximum = torch.aminmax(radius)
    step = (maximum - minimum) / (count - 1)
    return minimum + ((radius - minimum) / step).round() * step


def seen(radius):
    return repair_of(radius).quantised


def cards():
    """Twelve level cards whose radii differ by 0.8 px."""
    columns = (torch.arange(SIZE[1]) // 12).to(torch.float64)
    return (0.8 * columns - 4).expand(SIZE).clone()


def test_depth_in_few_levels_is_told_from_surfaces():
    assert seen(in_levels(slope()))
    assert seen(in_levels(slope().T.contiguous()))
    assert not seen(slope())
    assert not seen(cards())
    assert not seen(in_levels(slope(), 20_000))
    assert not seen(torch.full(SIZE, 3.0))
    assert not seen(slope()[:, :1])
    assert not seen(slope()[:1])
    assert not seen(slope()[:, :1].repeat(1, SIZE[1]))  # what is level across is a smooth slope


def test_small_steps_become_slopes():
    given = in_levels(slope())
    found = without_terraces(given)
    within = (slice(8, -8), slice(8, -8))
    before, after = (abs(x - slope())[within] for x in (given, found))
    assert after.max() < before.max()
    assert after.mean() < before.mean() / 3
    steps = [x[within].diff(dim=1).abs().max() for x in (given, found)]
    assert steps[1] < steps[0] / 2


def test_edges_and_what_is_steep_stay():
    radius = torch.zeros(SIZE, dtype=torch.float64)
    radius[:, 70:] = 1.5
    assert torch.equal(without_terraces(radius), radius)
    steep = 0.5 * torch.arange(SIZE[1], dtype=torch.float64).expand(SIZE)
    torch.testing.assert_close(without_terraces(steep), steep)


def test_an_edge_beside_small_steps_is_no_softer():
    radius = in_levels(slope())
    radius[40:60, 50:100] = -9.0
    found = without_terraces(radius)
    assert torch.equal(found == -9, radius == -9)
    assert found[radius != -9].amin() >= 0


def test_no_thin_lines_show_what_lies_far_behind():
    """A black surface in levels, bent about the focus, before a wall that is white."""
    y, x = (torch.arange(n, dtype=torch.float64) for n in SIZE)
    radius = (0.07 * (x - 60) + 0.03 * (y[:, None] - 40)).clamp(min=-3)
    radius = in_levels(radius, 14)
    image = torch.zeros(3, *SIZE)
    squares = torch.linspace(29, 30, 10 * SIZE[1] // 8, dtype=torch.float64).reshape(10, -1)
    radius[:40], image[:, :40] = squares.repeat_interleave(4, 0).repeat_interleave(8, 1), 1.0
    radius[:, :20], image[..., :20] = 30.0, 1.0
    assert seen(radius)
    found = render(image, radius.float()).render[:, 56:-4, 36:-8]
    rough = render(image, without_gaps(radius).float()).render[:, 56:-4, 36:-8]
    assert worst(found, 0.0) < 0.03
    assert worst(rough, 0.0) < 0.03  # what is opaque has no holes


def without_gaps(radius):
    """The same radii, but for a grain that hides that they are few."""
    grain = torch.rand(SIZE, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
    return radius + 1e-5 * grain

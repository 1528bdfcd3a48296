"""Where depth is soft at an edge, the colours say where the edge is."""

import pytest
import torch
from measures import worst
from renderers import repair_of
from scenes import RADII, pattern
from torch.nn.functional import interpolate

from defocus_core import repair_depth
from defocus_core.depth.displacement import (
    FARTHEST,
    EdgeShifts,
    measured_shifts,
    with_shifted_edges,
)
from defocus_core.depth.ramps import slope_of_soft_edges, softness, steepness, without_ramps

SIZE = (60, 96)
MIDDLE = SIZE[1] // 2
NEAR, FAR = 0.0, 20.0


def soft_depth(width=7, shift=0, near=NEAR, far=FAR):
    """Radii that ramp from near to far over `width` px, some px off the middle."""
    x = torch.arange(SIZE[1], dtype=torch.float64) + 0.5 - MIDDLE - shift
    return (near + (far - near) * (x / width + 0.5).clamp(0, 1)).expand(SIZE).clone()


def two_colors(contrast=1.0, texture=0.0):
    """A green surface on the left, on the right a red one, perhaps with waves."""
    picture = torch.tensor([0.5, 0.1, 0.4], dtype=torch.float64)[:, None, None].repeat(1, *SIZE)
    picture *= 1 + texture * (pattern(SIZE, period=24.0) - 0.5)
    picture[:, :, :MIDDLE] = torch.tensor([0.05, 0.5, 0.1], dtype=torch.float64)[:, None, None]
    return 0.3 + contrast * (picture - 0.3)


def with_hard_edges(radius, image, steep=None):
    """Radii without ramps, their edges where the colours have theirs."""
    slope = slope_of_soft_edges(
        float(radius.detach().min()), float(radius.detach().max()), radius.shape
    )
    steps = without_ramps(radius, slope if steep is None else steep)
    shifts = measured_shifts(steps, image, 1, soft=0.0)
    return steps if shifts is None else with_shifted_edges(steps, image, shifts)


def hard_depth(near=NEAR, far=FAR):
    return soft_depth(1, 0, near, far)


@pytest.mark.parametrize("width", [2, 3, 5, 8, 10])
@pytest.mark.parametrize("turned", [False, True])
def test_a_soft_edge_becomes_a_step_in_its_middle(width, turned):
    radius = soft_depth(width, near=-8.0, far=9.0)
    found = without_ramps(radius.T).T if turned else without_ramps(radius)
    assert bool(((found == -8.0) | (found == 9.0)).all())
    assert (found[0] == -8.0).sum() == pytest.approx(MIDDLE, abs=1)


def test_a_steep_surface_up_to_an_edge_stays():
    """A slope of 1.4 px per px that ends before a wall: steep on one side only."""
    radius = torch.full(SIZE, 20.0, dtype=torch.float64)
    radius[:, :30] = 1.4 * torch.arange(30, dtype=torch.float64) - 30
    assert torch.equal(without_ramps(radius), radius)


@pytest.mark.parametrize("width", [4, 7, 10])
@pytest.mark.parametrize("shift", [-6, -3, 0, 3, 6])
@pytest.mark.parametrize("turned", [False, True])
def test_the_edge_lies_where_the_colours_change(width, shift, turned):
    radius, image = soft_depth(width, shift), two_colors()
    if turned:
        found = with_hard_edges(radius.T.contiguous(), image.mT.contiguous()).T
    else:
        found = with_hard_edges(radius, image)
    assert torch.equal(found, hard_depth())
    assert worst(without_ramps(radius), hard_depth()) > 0 or shift == 0


@pytest.mark.parametrize("shift", [-4, 0, 4])
def test_without_colours_it_stays_in_the_middle_of_the_ramp(shift):
    found = with_hard_edges(soft_depth(7, shift), torch.full((3, *SIZE), 0.4).double())
    assert bool(((found == NEAR) | (found == FAR)).all())
    near = (found[SIZE[0] // 2] == NEAR).sum()
    assert int(near) == pytest.approx(MIDDLE + shift, abs=1)


@pytest.mark.parametrize("kind", [kind for kind in RADII if kind != "random"])
def test_surfaces_and_hard_edges_stay(kind):
    radius = RADII[kind](SIZE)
    assert with_hard_edges(radius, two_colors()) is radius


@pytest.mark.parametrize("texture", [0.0, 0.3])
@pytest.mark.parametrize("by", [-3, 1, 2, 5])
def test_hard_edges_that_are_all_displaced_alike_are_moved(by, texture):
    """As those of depth that was grown by some px; with texture a few of many edges decide."""
    radius = soft_depth(1, by).repeat(10, 1)
    image = two_colors(texture=texture).repeat(1, 10, 1)
    shifts = measured_shifts(radius, image, 1, soft=None)
    assert shifts.median == pytest.approx(by, abs=0.5)


@pytest.mark.parametrize("displaced", [(0,), (-9, -6, -3, 0, 3, 6)], ids=["not", "by many"])
def test_hard_edges_that_are_not_all_displaced_alike_stay(displaced):
    radius = torch.cat([soft_depth(1, by) for by in displaced]).repeat(12 // len(displaced), 1)
    assert measured_shifts(radius, two_colors().repeat(1, 12, 1), 1, soft=None) is None


def test_a_slope_beside_an_edge_stays():
    tilt = 0.2 * (torch.arange(SIZE[0], dtype=torch.float64)[:, None] - SIZE[0] / 2)
    found = with_hard_edges(soft_depth(7, 4) + tilt, two_colors())
    off = (found - hard_depth() - tilt).abs() > 0.2 * 24  # the longest path
    assert int(off.sum(1).amax()) <= 1
    for columns in (slice(None, MIDDLE - 12), slice(MIDDLE + 18, None)):
        assert torch.equal(found[:, columns], (hard_depth() + tilt)[:, columns])


@pytest.mark.parametrize("fatter", [-14, 14])
def test_in_a_large_picture_an_edge_is_found_from_farther(fatter):
    """As far as a hundredth of the longer side, of odd and of even lengths."""
    image, times = two_colors(), 15
    larger = image.repeat_interleave(times, -1)[..., :401, :-1]
    larger = torch.cat([larger, larger[..., :200, :]], -2)
    radius = 20 * ((torch.arange(1439) + 0.5 - MIDDLE * times - fatter) / 8 + 0.5).clamp(0, 1)
    found, repair = repair_depth(radius.double().expand(larger.shape[-2:]).clone(), larger)
    is_near = found < 10
    assert bool(is_near[:, : MIDDLE * times - 1].all())
    assert not bool(is_near[:, MIDDLE * times + 1 :].any())
    assert repair.edge_shifts.median == pytest.approx(fatter, abs=1)


@pytest.mark.parametrize("times", [1, 2, 3])
def test_an_edge_is_as_soft_in_a_picture_of_any_size(times):
    """A ramp of 12 px in 640 px, enlarged: a network sees a small picture."""
    width, height = 640 * times, 200 * times
    ramp = ((torch.arange(width) - width // 2) / (12 * times) + 0.5).clamp(0, 1).double()
    radius = (20 * times * ramp).expand(height, -1).contiguous()
    found, repair = repair_depth(radius, torch.full((3, height, width), 0.4).double())
    assert set(found.unique().tolist()) == {0.0, 20.0 * times}
    assert int((found - radius).abs().gt(10.01 * times).sum()) == 0
    assert repair.edge_width == pytest.approx(12 * times, rel=0.15)
    assert repair_depth(radius, torch.zeros(3, height, width), decided=repair)[0].equal(found)


@pytest.mark.parametrize("wide", [2, 3])
def test_a_rim_is_of_the_nearer_surface(wide):
    image, radius = two_colors(), soft_depth(shift=-wide)
    rim = slice(MIDDLE - wide, MIDDLE)
    image[:, :, rim] = torch.tensor([0.7, 0.7, 0.8], dtype=torch.float64)[:, None, None]
    assert worst(with_hard_edges(radius, image), hard_depth()) == 0


def told(radius):
    found = repair_of(radius)
    slope = None if found.antialiased else found.soft_edges
    if slope is not None:
        assert slope == slope_of_soft_edges(
            float(radius.detach().min()), float(radius.detach().max()), radius.shape
        )
    return slope is not None


@pytest.mark.parametrize("range_px", [20.0, 40.0, 80.0])
def test_soft_edges_are_told_from_surfaces(range_px):
    """Whatever the lens."""
    for width, soft in ((5, True), (7, True), (12, True), (2, False), (60, False)):
        assert told(soft_depth(width, far=range_px)) is soft
    assert not told(soft_depth(7, far=0.5))  # of so little blur it does not show
    for kind in ("slanted", "steps", "checkerboard"):
        assert not told(RADII[kind](SIZE) * range_px / 20)
    one = hard_depth(far=range_px)
    one[30, MIDDLE - 2 : MIDDLE + 3] = torch.linspace(0, range_px, 5).double()
    assert not told(one)  # a row of it is no edge


def test_a_steep_surface_among_hard_edges_is_none():
    """Like the side of a box."""
    radius = hard_depth()
    radius[10:20, 20:30] = torch.linspace(0, 20, 10).double()
    radius[:, 70:] -= 12
    assert bool((softness(steepness(radius)) > slope_of_soft_edges(0, 20, SIZE)).any())
    assert not told(radius)


@pytest.mark.parametrize("by", [2.0, 4.0])
def test_an_edge_that_wanders_comes_to_where_the_colours_change(by):
    shifts = (by * torch.sin(torch.arange(SIZE[0]) / 9)).round().int().tolist()
    radius = torch.stack([soft_depth(7, shift)[0] for shift in shifts])
    found = with_hard_edges(radius, two_colors(texture=0.4))
    before = int((without_ramps(radius) != hard_depth()).sum())
    assert int((found != hard_depth()).sum()) < 0.4 * before


def test_what_an_edge_uncovers_is_the_surface_beyond_it():
    """A speck or the rest of a ramp beside an edge becomes no patch."""
    four = torch.eye(2 * FARTHEST + 1)[FARTHEST + 4]
    shifts = EdgeShifts(1.0, 4.0, tuple((20 * (1 - four)).tolist()))
    radius = hard_depth()
    radius[10:13, MIDDLE] = NEAR + 5  # the rest of a ramp
    radius[40:43, MIDDLE + 20 : MIDDLE + 23] = FAR + 10  # a speck
    found = with_shifted_edges(radius, two_colors(contrast=0.0), shifts)
    moved = found[:, : MIDDLE - 4] == NEAR
    assert moved.all()
    assert (found[:, MIDDLE - 3 : MIDDLE - 1] == FAR).all()
    assert ((found == FAR + 10) <= (radius == FAR + 10)).all()


def test_a_place_whose_colours_mislead_goes_with_its_neighbours():
    """Something of the colour of the farther surface reaches into the silhouette, on 16 rows."""
    image, radius = two_colors(texture=0.2).repeat(1, 3, 1), soft_depth().repeat(3, 1)
    rows = slice(82, 98)
    image[:, rows, MIDDLE - 6 : MIDDLE] = image[:, rows, MIDDLE : MIDDLE + 6]
    assert worst(with_hard_edges(radius, image), hard_depth().repeat(3, 1)) == 0


def test_no_crumbs_are_left_in_soft_edges():
    """Of blobs whose edges are soft and not quite smooth."""
    generator, size = torch.Generator().manual_seed(1), (120, 160)
    blobs, waves = (
        interpolate(torch.randn(1, 1, *cells, generator=generator), size, mode="bicubic")[0, 0]
        for cells in ((5, 7), (10, 14))
    )
    soft = 20 * torch.sigmoid(25 * torch.sigmoid(4 * (blobs + 0.1 * waves)) - 12)
    found = without_ramps(soft.double(), 0.4)
    assert not bool(((found > 4) & (found < 16)).any())

import math

import pytest
import torch

from defocus_core import DepthRepair, render
from defocus_core.depth.displacement import EdgeShifts
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.engine.scene import Scene
from defocus_core.renderer.engine.settings import Settings
from defocus_core.sequences.neighbours import (
    Frame,
    approached,
    chained,
    positions,
    seen_behind,
    temporal_mean,
)
from defocus_core.sequences.shot_repair import agreed_repair, repair_through

SIZE = (24, 32)


def noisy(seed, deviation=0.3):
    generator = torch.Generator().manual_seed(seed)
    return 5 + deviation * torch.randn(SIZE, generator=generator)


def texture(seed=0):
    return torch.rand((3, *SIZE), generator=torch.Generator().manual_seed(seed))


def test_most_frames_decide_on_a_repair_and_thresholds_are_medians():
    repairs = [DepthRepair(noise=0.2), DepthRepair(noise=0.8), DepthRepair(quantised=True)]
    agreed = agreed_repair(repairs, [1.0, 2.0, 3.0])
    assert agreed == DepthRepair(noise=pytest.approx(0.3))
    assert repair_through(agreed, 2.0, None).noise == pytest.approx(0.6)
    assert agreed_repair([*repairs, *[DepthRepair()] * 3], [1.0] * 6) == DepthRepair()


def test_averages_of_distance_have_the_infinity_of_each_lens():
    of_distance = agreed_repair([DepthRepair(antialiased=7.0)] * 2, [1.0, 2.0])
    assert repair_through(of_distance, 1.0, 4.5).antialiased == 4.5
    of_disparity = agreed_repair([DepthRepair(antialiased=math.inf)] * 2, [1.0, 2.0])
    assert repair_through(of_disparity, 1.0, 4.5).antialiased == math.inf


def test_soft_and_shifted_edges_scale_with_the_lens():
    shifts = EdgeShifts(0.4, 2.0, (0.0, 1.0))
    each = [DepthRepair(soft_edges=0.4, ramps=True, edge_shifts=shifts)] * 2
    through = repair_through(agreed_repair(each, [2.0, 2.0]), 4.0, None)
    assert through.soft_edges == pytest.approx(0.8)
    assert through.ramps
    assert through.edge_shifts == shifts._replace(step=0.8)


def test_frames_and_scales_must_match():
    for repairs, scales in (([], []), ([DepthRepair()], [])):
        with pytest.raises(ValueError, match="as many frames"):
            agreed_repair(repairs, scales)


def test_a_decided_repair_is_the_one_that_is_made():
    image, radius = texture(), noisy(1)

    def rendered(settings):
        return torch.cat([part.render for part in Renderer(Scene(image, radius), settings).tiles()])

    decided = rendered(Settings(decided=DepthRepair(noise=0.3)))
    found, none = rendered(Settings()), rendered(Settings(decided=DepthRepair()))
    assert torch.equal(none, rendered(Settings(depth_repair="off")))
    assert (found - decided).abs().max() < 0.12 * (found - none).abs().max()


def test_still_noise_falls_with_the_root_of_the_number_of_frames():
    image = texture()
    frames = [Frame(image, noisy(k)) for k in range(9)]
    mean, count = temporal_mean(frames[0], frames[1:], 0.3)
    assert count.mean() > 8.8
    assert (mean - 5).std() == pytest.approx(0.1, rel=0.1)


def test_other_colours_and_other_depth_are_not_averaged():
    image, radius = texture(), noisy(0)
    _, count = temporal_mean(Frame(image, radius), [Frame(texture(1), noisy(1))], 0.3)
    assert count.mean() < 1.05
    nearer = noisy(1) - 0.6  # two deviations: no pixel tells, but their mean does
    _, count = temporal_mean(Frame(image, radius), [Frame(image, nearer)], 0.3)
    assert count.mean() < 1.2


def test_an_edge_of_depth_stays_where_it_is():
    image, step = texture(), torch.where(torch.arange(SIZE[1]) < 16, -3.0, 4.0)
    frames = [Frame(image, noisy(k) - 5 + step) for k in range(9)]
    mean, _ = temporal_mean(frames[0], frames[1:], 0.3)
    assert (mean - step).abs().max() < 0.7


def test_depth_is_averaged_along_motion():
    image, slope = texture(), torch.arange(SIZE[1]).expand(SIZE) * 0.5
    moved = Frame(image.roll(3, -1), (noisy(1) - 5 + slope).roll(3, -1))
    along = moved._replace(motion=torch.tensor([3.0, 0.0])[:, None, None].expand(2, *SIZE))
    frame = Frame(image, noisy(0) - 5 + slope)
    inner = (slice(None), slice(4, -8))
    for neighbour, minimum, maximum in ((moved, 1.0, 1.1), (along, 1.9, 2.0)):
        mean, count = temporal_mean(frame, [neighbour], 0.3)
        assert minimum <= count[inner].mean() <= maximum
    assert (mean - slope)[inner].std() == pytest.approx(0.3 / math.sqrt(2), rel=0.1)


def test_motion_is_chained_by_surface_and_goes_on_behind_another():
    near = torch.zeros(SIZE)
    near[:, 12:16] = -5.0  # hides the middle of the second frame
    first, second = (torch.zeros(2, *SIZE) for _ in range(2))
    first[0], second[0] = 2.0, 1.0
    second[:, :, 12:16] = -9.0
    total = chained([first, second], [torch.zeros(SIZE), near], 0.5)
    expected = torch.full(SIZE, 3.0)
    expected[:, 10:14] = 4.0  # hidden on the way: it goes on as before
    assert torch.equal(total[0, :, :28], expected[:, :28])
    assert not total[1].any()


def test_a_neighbour_shows_what_a_card_hides():
    wall, seen = texture(), torch.full(SIZE, 6.0)
    seen[6:18, 8:16] = -4.0
    later = torch.full(SIZE, 6.0)
    later[6:18, 14:22] = -4.0  # the card has moved by 6 px, the wall has not
    motion = torch.zeros(2, *SIZE)
    motion[0, 6:18, 14:22] = -6.0
    hidden = seen_behind(Frame(wall, seen), [Frame(wall, later, motion)])
    expected = torch.zeros(SIZE, dtype=torch.bool)
    expected[6:18, 8:13] = True  # but for the pixels beside the card, which may hold its colour
    assert torch.equal(hidden.mask, expected)
    assert torch.equal(hidden.color[:, expected], wall[:, expected])
    assert (hidden.signed_radius[expected] == 6).all()


def test_what_was_seen_counts_as_seen():
    wall, radius = texture(), torch.zeros(SIZE)
    radius[6:18, 8:24] = -6.0
    still = torch.zeros(2, *SIZE)
    hidden = seen_behind(Frame(wall, radius), [Frame(wall, torch.zeros(SIZE), still)])
    inner = (..., slice(8, 16), slice(8, 24))  # no light from beyond the frame
    without, with_it = render(wall, radius), render(wall, radius, hidden=hidden)
    assert without.trust[inner].min() < 0.9
    assert with_it.trust[inner].min() > 0.99


def test_places_are_columns_and_rows():
    at = positions(SIZE, torch.zeros(1))
    assert at[:, 5, 7].tolist() == [7, 5]


def test_depth_that_comes_nearer_is_followed():
    disparity = torch.linspace(0.1, 1.0, 400)
    nearer = disparity / (1 - 0.05 * disparity)  # by 0.05 along the axis
    there = (20 * (0.4 - nearer)).where(torch.arange(400) % 5 > 0, torch.tensor(9.0))
    radius, spread = approached(20 * (0.4 - disparity), there)
    inner = slice(8, -8)  # the ends have the change of the first and of the last range
    assert (radius - 20 * (0.4 - nearer))[inner].abs().max() < 0.06
    assert spread.max() < 0.05


def test_near_surfaces_are_followed_though_the_background_is_most_of_the_picture():
    disparity = torch.cat([torch.full((4000,), 0.1), torch.full((100,), 1.5)])
    nearer = disparity / (1 - 0.04 * disparity)
    radius, spread = approached(-10 * disparity, -10 * nearer)
    assert (radius + 10 * nearer).abs().max() < 1e-5
    assert spread.max() < 1e-5


def test_of_two_neighbours_the_closest_tells_what_is_hidden():
    radius = torch.full(SIZE, 6.0)
    radius[6:18, 8:16] = -4.0
    still = torch.zeros(2, *SIZE)
    wall = Frame(torch.full((3, *SIZE), 0.2), torch.full(SIZE, 6.0), still)
    other = torch.full(SIZE, 6.0)
    other[6:18, 8:16] = 1.0
    sign = Frame(torch.where(other == 6, 0.2, 0.9).expand(3, *SIZE), other, still)
    frame = Frame(torch.where(radius == 6, 0.2, 0.5).expand(3, *SIZE), radius)
    hidden = seen_behind(frame, [wall, sign])
    assert (hidden.color[:, hidden.mask] == 0.2).all()
    assert (seen_behind(frame, [sign, wall]).color[:, 8:16, 10:14] == 0.9).all()


def test_a_surface_that_was_farther_before_is_not_hidden_by_itself():
    slope = torch.linspace(-6, 6, SIZE[1]).expand(SIZE).contiguous()
    before = Frame(texture(), slope + 0.8, torch.zeros(2, *SIZE))
    assert not seen_behind(Frame(texture(), slope), [before]).mask.any()

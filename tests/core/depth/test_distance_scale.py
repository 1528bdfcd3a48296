"""Edges soft in distance, not in disparity, and the repair that the frames of a shot share."""

import pytest
import torch
from torch.nn.functional import conv1d, pad

from defocus_core import repair_depth
from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.displacement import EdgeShifts
from defocus_core.depth.ramps import distance_scale
from defocus_core.depth.repair import diagnose_depth
from defocus_core.depth.shot_repair import agreed_repair, repair_through

SIZE = (96, 128)
# Px of radius for a distance of 1 m, and the focus distance in m.
SCALE, FOCUS = 30.0, 0.8


def through_lens(metres, focus=FOCUS):
    """Signed radii in px, and that of infinity."""
    infinity = SCALE / focus
    return infinity - SCALE / metres, infinity


def a_disc_before(far):
    """Metres of a disc at 0.4 m before what is farther."""
    y, x = (torch.arange(n, dtype=torch.float64) - n / 2 for n in SIZE)
    return torch.where(torch.hypot(y[:, None], x) < 30.3, 0.4, far)


def softened(metres, deviation=2.0, levels=255):
    """Distance as a network writes it into eight bits."""
    offset = torch.arange(-8, 9, dtype=torch.float64)
    kernel = torch.exp(offset.square() / (-2 * deviation**2))
    kernel /= kernel.sum()
    soft = pad(metres[None, None], (8,) * 4, mode="replicate")[0, 0]
    for _ in range(2):
        soft = conv1d(soft[:, None], kernel[None, None])[:, 0].T
    minimum, maximum = float(soft.min()), float(soft.max())
    return minimum + ((soft - minimum) / (maximum - minimum) * levels).round() / levels * (
        maximum - minimum
    )


def test_edges_soft_in_distance_become_steps_where_they_are():
    metres = a_disc_before(torch.full(SIZE, 6.0, dtype=torch.float64))
    hard, infinity = through_lens(metres)
    soft, _ = through_lens(softened(metres))
    found = diagnose_depth(soft, infinity)
    assert found.soft_edges is not None
    assert found.ramps_of is not None
    grey = torch.full((3, *SIZE), 0.4, dtype=torch.float64)  # colours say nothing
    steps, repair = repair_depth(soft, grey, infinity)
    assert repair.ramps_of == found.ramps_of
    off = (steps - hard).abs() > 2
    assert int(off.sum()) < 0.12 * 2 * torch.pi * 30  # of the pixels on the outline
    assert int(((soft - hard).abs() > 2).sum()) > 5 * int(off.sum())


@pytest.mark.parametrize("farthest", [3.0, 40.0, 1000.0])
def test_a_floor_to_the_horizon_is_not_soft(farthest):
    below = torch.arange(SIZE[0], dtype=torch.float64)[:, None] + 0.5
    floor = (0.6 * SIZE[0] / below).flip(0).clamp(max=farthest).expand(SIZE)
    for metres in (floor.clone(), a_disc_before(floor)):
        radii, infinity = through_lens(metres)
        found = diagnose_depth(radii, infinity)
        assert found.ramps_of is None
        assert found.soft_edges is None or found.antialiased


def test_no_scale_where_distance_is_unknown_or_infinite():
    assert distance_scale(-3.0, 4.0, None) is None
    assert distance_scale(-3.0, 4.0, 4.0) is None
    assert distance_scale(4.0, 4.0, 9.0) is None


def test_frames_of_a_shot_agree_on_the_scale():
    metres = softened(a_disc_before(torch.full(SIZE, 6.0, dtype=torch.float64)))
    near, far = (diagnose_depth(*through_lens(metres, focus)) for focus in (0.8, 1.5))
    for repair, other, focus in ((near, far, 0.8), (far, near, 1.5)):
        agreed = agreed_repair([repair, repair_through(other, 1.0, SCALE / focus)])
        assert agreed.ramps_of == pytest.approx(repair.ramps_of)


def test_most_frames_decide_on_a_repair_and_thresholds_are_medians():
    noisy, fine = DepthRepair(noise=0.2), DepthRepair(quantised=True)
    agreed = agreed_repair([noisy, DepthRepair(noise=0.8, fraction=0.5), DepthRepair(noise=0.3)])
    assert agreed == DepthRepair(noise=0.3)
    assert agreed_repair([noisy, fine, fine]) == fine
    assert agreed_repair([noisy, fine]) == DepthRepair()


def test_soft_and_shifted_edges_scale_with_the_lens():
    shifts = EdgeShifts(0.4, 2.0, (0.0, 1.0))
    repair = DepthRepair(noise=0.1, soft_edges=0.4, ramps=True, edge_shifts=shifts)
    through = repair_through(repair, 2.0, None)
    assert through == DepthRepair(
        noise=0.2, soft_edges=0.8, ramps=True, edge_shifts=shifts._replace(step=0.8)
    )

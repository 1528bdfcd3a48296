import math

import pytest
import torch

from defocus_core import DepthRepair
from defocus_core.depth.displacement import EdgeShifts
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.engine.scene import Scene
from defocus_core.renderer.engine.settings import Settings
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

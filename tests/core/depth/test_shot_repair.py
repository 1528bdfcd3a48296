import torch

from defocus_core.depth.diagnosis import DepthRepair
from defocus_core.depth.displacement import EdgeShifts
from defocus_core.depth.shot_repair import agreed_repair, repair_through

SIZE = (24, 32)


def noisy(seed, deviation=0.3):
    generator = torch.Generator().manual_seed(seed)
    return 5 + deviation * torch.randn(SIZE, generator=generator)


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

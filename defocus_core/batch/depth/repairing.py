"""The repair of a decoded depth, as the radii that are rendered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from defocus_core.batch.jobs.job import Reading
from defocus_core.batch.sources import lone_window, windows
from defocus_core.io.arrays import times

if TYPE_CHECKING:
    from defocus_core.batch.depth.radii import Radii
    from defocus_core.depth.diagnosis import DepthRepair
    from defocus_core.io.images.color_planes import Color
    from defocus_core.tensors.source import Pixels


def repaired_radii(
    radii: Radii,
    color: Color,
    reading: Reading,
    *,
    device: str = "cpu",
    threads: int | None = None,
    longer: float = 1.0,
    decided: DepthRepair | None = None,
    hold: bool = False,
) -> tuple[Pixels, DepthRepair]:
    """The radii [H, W] px by which a picture is rendered, and the repair that made them.

    Args:
        radii: of the depth as it was read.
        color: the colour, whose edges are those of the depth.
        reading: what is known of the repair.
        device: where it is computed.
        threads: to compute with; None for as many as torch has.
        longer: the longer half axis of the blur in px, in radii of the CoC.
        decided: the repair, where it is known already.
        hold: whether there is room for the repaired radii.
    """
    import torch

    from defocus_core.depth.repair import repair_depth

    return repair_depth(
        lone_window(times(radii.px, longer), device),
        windows(color.planes, device),
        None if radii.infinity is None else longer * radii.infinity,
        torch.get_num_threads() if threads is None else threads,
        depth_repair=reading.depth_repair,
        edge_width=reading.edge_width,
        decided=decided,
        hold=hold,
    )


def repair_found(radii: Radii, reading: Reading) -> DepthRepair:
    """The repair of a depth before it is rendered, as far as it shows without colours."""
    import torch

    from defocus_core.depth.repair import diagnose_depth

    return diagnose_depth(
        lone_window(radii.px, "cpu"),
        radii.infinity,
        torch.get_num_threads(),
        depth_repair=reading.depth_repair,
        edge_width=reading.edge_width,
    )

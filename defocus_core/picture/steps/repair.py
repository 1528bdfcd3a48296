"""Depth repaired before it is rendered: each surface alone, by its colours."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.picture.scene import Surfaces
from defocus_core.picture.sources import windows


def scene(surfaces: Surfaces) -> Surfaces:
    """The surfaces with the radii by which they are rendered; the repair is that of the first."""
    from defocus_core.depth.repair import repair_depth

    take, longer = surfaces.take, surfaces.longer
    decided, infinity = take.decided, take.blur.infinity
    if decided is not None:
        from defocus_core.sequences.shot_repair import repair_through

        decided = repair_through(decided, longer, None if infinity is None else longer * infinity)
    reading = take.job.reading
    both = [
        repair_depth(
            px,
            windows(color.planes, take.device),
            None if radii.infinity is None else longer * radii.infinity,
            take.job.machine.threads,
            depth_repair=reading.depth_repair,
            edge_width=reading.edge_width,
            decided=decided,
            hold=surfaces.holds,
            matte=surfaces.matte,
        )
        for color, px, radii in zip(surfaces.colors, surfaces.px, surfaces.radii, strict=True)
    ]
    return replace(surfaces, px=tuple(px for px, _ in both), repair=both[0][1])

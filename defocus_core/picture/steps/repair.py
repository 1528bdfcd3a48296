"""Depth repaired before it is rendered: each surface alone, by its colours."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.picture.scene import Surfaces


def scene(surfaces: Surfaces) -> Surfaces:
    """The surfaces with the radii by which they are rendered; the repair is that of the first."""
    take, longer = surfaces.take, surfaces.longer
    decided, infinity = take.decided, take.blur.infinity
    if decided is not None:
        from defocus_core.sequences.shot_repair import repair_through

        decided = repair_through(decided, longer, None if infinity is None else longer * infinity)
    both = [
        radii.repair(
            color,
            take.job.reading,
            device=take.device,
            threads=take.job.machine.threads,
            longer=longer,
            decided=decided,
            hold=surfaces.holds,
            matte=surfaces.matte,
        )
        for color, radii in zip(surfaces.colors, surfaces.radii, strict=True)
    ]
    return replace(surfaces, px=tuple(px for px, _ in both), repair=both[0][1])

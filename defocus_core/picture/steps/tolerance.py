"""The quality that is within a tolerance."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.errors import UsageProblem
from defocus_core.picture.take import Take


def radii(take: Take) -> Take:
    """The take with the cheapest quality within its tolerance."""
    from defocus_core.renderer.layers.slice_radii import UnreachableTolerance, cheapest_within

    assert take.job.machine.tolerance is not None
    try:
        quality = cheapest_within(take.job.machine.tolerance, *take.limits)
    except UnreachableTolerance as error:
        problem = (
            f"must be at least {error.finest:g} px where radii go from {error.minimum:.1f} to "
            f"{error.maximum:.1f} px, got {error.tolerance:g}"
        )
        remedy = f"give more: that is what {error.quality} has"
        raise UsageProblem("out-of-range", problem, remedy, field="tolerance") from None
    return replace(take, quality=quality)

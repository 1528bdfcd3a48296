"""How accurate a picture is to be: a quality by name, or the cheapest one within a tolerance."""

from __future__ import annotations

from defocus_cli.errors import UsageProblem
from defocus_cli.job import Machine


def quality_of(machine: Machine, coc_px: tuple[float, float]) -> str:
    """The quality of a picture whose signed radii in px have the given ends.

    Raises:
        UsageProblem: no quality is within the tolerance.
    """
    if machine.tolerance is None:
        return machine.quality
    from defocus_core import UnreachableTolerance, cheapest_within

    try:
        return cheapest_within(machine.tolerance, *coc_px)
    except UnreachableTolerance as error:
        problem = (
            f"must be at least {error.finest:g} px where radii go from {error.least:.1f} to "
            f"{error.most:.1f} px, got {error.tolerance:g}"
        )
        remedy = f"give more: that is what {error.quality} has"
        raise UsageProblem("--tolerance", problem, remedy) from None

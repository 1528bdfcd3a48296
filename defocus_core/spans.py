"""Stretches of samples along one axis, and the transforms in which they are blurred."""

from __future__ import annotations

from typing import NamedTuple


class Span(NamedTuple):
    """Samples from the first to before the end, counted from anywhere."""

    first: int
    end: int

    @property
    def length(self) -> int:
        """How many; not positive if there are none."""
        return self.end - self.first

    def within(self, other: Span) -> Span:
        """Those that are in another span, too."""
        return Span(max(self.first, other.first), min(self.end, other.end))

    def grown(self, by: int) -> Span:
        """Longer by some samples at both ends."""
        return Span(self.first - by, self.end + by)


def least_transform(lit: Span, seen: Span, margin: int) -> int:
    """The least length of a circular transform that blurs some samples.

    What wraps around falls outside of what is wanted.

    Args:
        lit: Samples that are not 0.
        seen: Those that are wanted, none farther than the margin from the others.
        margin: Samples that kernels spread to each side.
    """
    return max(seen.end - lit.first, lit.end - seen.first) + margin

"""Rectangles of pixels, and spans of rows or columns."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from defocus_core.tensors.source import Pixels


class Box(NamedTuple):
    """A rectangle of a picture."""

    top: int
    left: int
    height: int
    width: int

    @classmethod
    def over(cls, down: Span, across: Span) -> Box:
        """The rectangle of a span of rows and a span of columns."""
        return cls(down.first, across.first, down.length, across.length)

    @property
    def sides(self) -> tuple[Span, Span]:
        """Its rows and its columns."""
        return Span(self.top, self.top + self.height), Span(self.left, self.left + self.width)

    @property
    def area(self) -> int:
        """Its pixels."""
        return self.height * self.width

    def grown(self, by: int, within: Box) -> Box:
        """Larger by `by` px on all sides, cut to the rectangle `within`."""
        top, left = max(self.top - by, within.top), max(self.left - by, within.left)
        below = min(self.top + self.height + by, within.top + within.height)
        beside = min(self.left + self.width + by, within.left + within.width)
        return Box(top, left, below - top, beside - left)

    def around(self, by: int) -> Box:
        """Larger by `by` px on all sides, not cut."""
        return Box(self.top - by, self.left - by, self.height + 2 * by, self.width + 2 * by)

    def shrunk(self, by: int) -> Box:
        """Smaller by `by` px on all sides; its size may become negative."""
        return self.around(-by)

    def seen_from(self, other: Box) -> Box:
        """The same rectangle counted from the corner of another."""
        return Box(self.top - other.top, self.left - other.left, self.height, self.width)

    def of(self, picture: Pixels) -> Tensor:
        """The window of a picture [..., H, W] in this rectangle."""
        return picture[..., self.top : self.top + self.height, self.left : self.left + self.width]


class Span(NamedTuple):
    """Samples from `first` to before `end` along an axis."""

    first: int
    end: int

    @property
    def length(self) -> int:
        """The number of samples; not positive if there are none."""
        return self.end - self.first

    def within(self, other: Span) -> Span:
        """The samples that are in another span, too."""
        return Span(max(self.first, other.first), min(self.end, other.end))

    def grown(self, by: int) -> Span:
        """Longer by `by` samples at both ends."""
        return Span(self.first - by, self.end + by)


def min_transform(lit: Span, wanted: Span, margin: int) -> int:
    """The least length of a circular transform that wraps around outside of the wanted samples."""
    return max(wanted.end - lit.first, lit.end - wanted.first) + margin

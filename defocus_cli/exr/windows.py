"""Windows of an OpenEXR picture: rectangles of pixels, both corners included."""

from __future__ import annotations

from typing import NamedTuple


class Window(NamedTuple):
    """Pixel rectangle of an EXR header, both corners included."""

    x0: int
    y0: int
    x1: int
    y1: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height} at {self.x0},{self.y0}"

    @property
    def width(self) -> int:
        """In px."""
        return self.x1 - self.x0 + 1

    @property
    def height(self) -> int:
        """In px."""
        return self.y1 - self.y0 + 1

    def covers(self, other: Window) -> bool:
        """Whether every pixel of ``other`` lies in this window."""
        first = self.x0 <= other.x0 and self.y0 <= other.y0
        return first and self.x1 >= other.x1 and self.y1 >= other.y1

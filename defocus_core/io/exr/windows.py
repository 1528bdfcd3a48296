"""Windows of an OpenEXR picture, and how far its pixels reach beyond the picture shown."""

from __future__ import annotations

from typing import Any, NamedTuple


class Overscan(NamedTuple):
    """The number of pixels beyond each side of the display window, 0 or more."""

    left: int = 0
    top: int = 0
    right: int = 0
    bottom: int = 0

    def __str__(self) -> str:
        return "{} px left, {} top, {} right, {} bottom".format(*self)

    def smaller(self, other: Overscan) -> Overscan:
        """The minimum of two overscans on each side."""
        return Overscan(*map(min, self, other))

    def shown(self, height: int, width: int) -> tuple[slice, slice]:
        """The rows and columns of a frame of ``height`` by ``width`` px that are shown."""
        return slice(self.top, height - self.bottom), slice(self.left, width - self.right)


NO_OVERSCAN = Overscan()


class Window(NamedTuple):
    """A rectangle of pixels in an EXR header; both corners belong to it."""

    x0: int
    y0: int
    x1: int
    y1: int

    def __str__(self) -> str:
        return f"{self.width}x{self.height} at {self.x0},{self.y0}"

    @property
    def width(self) -> int:
        """Width in px."""
        return self.x1 - self.x0 + 1

    @property
    def height(self) -> int:
        """Height in px."""
        return self.y1 - self.y0 + 1

    def covers(self, other: Window) -> bool:
        """Whether every pixel of ``other`` lies in this window."""
        first = self.x0 <= other.x0 and self.y0 <= other.y0
        return first and self.x1 >= other.x1 and self.y1 >= other.y1

    def overscan(self, display: Window, *, whole: bool = False) -> Overscan:
        """The pixels of this window beyond a display window.

        Unless `whole`, no side has more of them than the longer side of the display window is long.
        """
        left, top = display.x0 - self.x0, display.y0 - self.y0
        right, bottom = self.x1 - display.x1, self.y1 - display.y1
        maximum = max(display.width, display.height)
        sides = Overscan(*(max(0, side) for side in (left, top, right, bottom)))
        return sides if whole else sides.smaller(Overscan(*[maximum] * 4))

    def intersection(self, other: Window) -> Window:
        """The intersection of this window with another one, which must overlap it."""
        (x0, y0), (x1, y1) = map(max, self[:2], other[:2]), map(min, self[2:], other[2:])
        return Window(x0, y0, x1, y1)

    def grown(self, overscan: Overscan) -> Window:
        """This window enlarged by an overscan."""
        left, top, right, bottom = overscan
        return Window(self.x0 - left, self.y0 - top, self.x1 + right, self.y1 + bottom)

    def cut(self, other: Window) -> tuple[slice, slice]:
        """The rows and columns of this window that lie in another window; empty if none do."""
        places = []
        for start, end, first, last in zip(self[:2], self[2:], other[:2], other[2:], strict=True):
            begin = min(max(first, start), end + 1)
            places.append(slice(begin - start, max(begin, min(last, end) + 1) - start))
        columns, rows = places
        return rows, columns

    def paste(self, plane: Any, pixels: Any, window: Window) -> None:
        """Copy `pixels` of another window into `plane`, this window's array, where they overlap."""
        place, met = self.cut(window), pixels[window.cut(self)]
        if met.size:
            plane[place] = met


class Layout(NamedTuple):
    """The position of a file's pixels, and its views."""

    corner: tuple[int, int] = (0, 0)  # x and y of the first pixel
    display: Window | None = None  # the display window; None if it is all pixels
    # Names of the views in the file, the default one first; empty if there is one view only
    views: tuple[str, ...] = ()

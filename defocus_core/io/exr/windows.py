"""Windows of an OpenEXR picture, and how far its pixels reach beyond the picture shown."""

from __future__ import annotations

from typing import Any, NamedTuple


class Overscan(NamedTuple):
    """Pixels beyond each side of the display window, 0 or more."""

    left: int = 0
    top: int = 0
    right: int = 0
    bottom: int = 0

    def __str__(self) -> str:
        return "{} px left, {} top, {} right, {} bottom".format(*self)

    def smaller(self, other: Overscan) -> Overscan:
        """The overscan with the smaller number of pixels of two overscans on each side."""
        return Overscan(*map(min, self, other))

    def shown(self, height: int, width: int) -> tuple[slice, slice]:
        """The rows and columns of a frame of ``height`` by ``width`` px that are shown."""
        return slice(self.top, height - self.bottom), slice(self.left, width - self.right)


NO_OVERSCAN = Overscan()


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

    def overscan(self, display: Window, *, whole: bool = False) -> Overscan:
        """The overscan beyond a display window, at most its longer side in px unless `whole`."""
        left, top = display.x0 - self.x0, display.y0 - self.y0
        right, bottom = self.x1 - display.x1, self.y1 - display.y1
        maximum = max(display.width, display.height)
        sides = Overscan(*(max(0, side) for side in (left, top, right, bottom)))
        return sides if whole else sides.smaller(Overscan(*[maximum] * 4))

    def intersection(self, other: Window) -> Window:
        """The intersection with another window that overlaps this one."""
        (x0, y0), (x1, y1) = map(max, self[:2], other[:2]), map(min, self[2:], other[2:])
        return Window(x0, y0, x1, y1)

    def grown(self, overscan: Overscan) -> Window:
        """This window with an overscan."""
        left, top, right, bottom = overscan
        return Window(self.x0 - left, self.y0 - top, self.x1 + right, self.y1 + bottom)

    def cut(self, other: Window) -> tuple[slice, slice]:
        """The rows and columns of this window that lie in another; empty slices if none do."""
        places = []
        for start, end, first, last in zip(self[:2], self[2:], other[:2], other[2:], strict=True):
            begin = min(max(first, start), end + 1)
            places.append(slice(begin - start, max(begin, min(last, end) + 1) - start))
        columns, rows = places
        return rows, columns

    def paste(self, plane: Any, pixels: Any, window: Window) -> None:
        """Copy the pixels of another window into the array of this window, where both overlap."""
        place, met = self.cut(window), pixels[window.cut(self)]
        if met.size:
            plane[place] = met


class Layout(NamedTuple):
    """The place of the pixels of a file."""

    corner: tuple[int, int] = (0, 0)  # x and y of the first pixel
    display: Window | None = None  # the display window; None if it is all pixels
    # The views whose channels are in the file, the default one first; none of one
    views: tuple[str, ...] = ()

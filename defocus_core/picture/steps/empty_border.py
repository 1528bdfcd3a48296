"""Rendered pictures cut to the pixels that their files have, grown by the blur of them."""

from __future__ import annotations

from functools import partial

from defocus_core.io.exr.windows import Overscan, Window
from defocus_core.picture.write import Contents, window_of


def write(contents: Contents) -> Contents:
    """The contents without the border that no light reaches."""
    take, layout, data = contents.take, contents.layout, contents.take.inputs.color.data
    assert data is not None
    (height, width), (x, y) = contents.planes[0].shape, layout.corner
    frame = Window(x, y, x + width - 1, y + height - 1)
    drawn = data.grown(Overscan(*[take.reach] * 4)).within(frame)
    if drawn == frame or drawn.width < 1 or drawn.height < 1:
        return contents
    rows, columns = frame.cut(drawn)
    layout = layout._replace(corner=(drawn.x0, drawn.y0), display=layout.display or frame)
    return contents.mapped(partial(window_of, rows=rows, columns=columns))._replace(layout=layout)

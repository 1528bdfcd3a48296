"""The contents of an output file: its channels, and where they lie."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from defocus_core.batch.jobs.output_kinds import Kind
from defocus_core.io.arrays import LazyArray, computed
from defocus_core.io.exr.views import name_in_view
from defocus_core.io.exr.windows import Layout, Overscan, Window
from defocus_core.io.exr.writing import as_half
from defocus_core.io.images.color_planes import Color
from defocus_core.picture.focus_picture import focus_planes
from defocus_core.picture.opening import disparity_of
from defocus_core.picture.steps.noise import noisy
from defocus_core.picture.take import Rendered


class Contents(NamedTuple):
    """The contents of a file.

    Attributes:
        names: of its channels of colour; the kind of a map.
        planes: arrays [H, W] of these channels.
        extras: further channels.
        layout: where the first pixel is, the display window, the views.
    """

    names: tuple[str, ...]
    planes: tuple[Any, ...]
    extras: Mapping[str, Any]
    layout: Layout


def contents_of(rendered: Rendered, kind: Kind) -> Contents:
    """The contents of the file of a kind, without overscan unless that is kept."""
    color = rendered.inputs.color
    if kind.source:
        return _SOURCES[kind.source](rendered)
    names: tuple[str, ...] = (kind.name,)
    extras: dict[str, Any] = {}
    if kind.of_radius:
        values = partial(kind.of_radius, disparity=disparity_of(rendered.lens))
        planes: tuple[Any, ...] = (
            _of_radius(rendered.radii.shown, rendered.inputs.nothing, values),
        )
    elif kind.image:
        names, planes, extras = _image(rendered, kind)
    else:
        planes = rendered.images[kind.name]
    return _framed(
        rendered, Contents(names, planes, extras, Layout(color.corner, None, kind.views))
    )


def _framed(rendered: Rendered, whole: Contents) -> Contents:
    """Contents without the overscan that their arrays have, or with the display window in it."""
    color = rendered.inputs.color
    (x, y), overscan = color.corner, color.overscan
    if rendered.job.outputs.keep_overscan and any(overscan):
        width, height = color.size
        display = Window(x, y, x + width - 1, y + height - 1)
        corner = (x - overscan.left, y - overscan.top)
        return whole._replace(layout=Layout(corner, display, whole.layout.views))
    extras = dict(zip(whole.extras, _shown(color, list(whole.extras.values())), strict=True))
    return whole._replace(planes=_shown(color, whole.planes), extras=extras)


def without_empty_border(rendered: Rendered, kind: Kind, whole: Contents) -> Contents:
    """A rendered picture cut to the pixels that its file has, grown by the blur of them."""
    inputs, lens = rendered.inputs, rendered.lens
    data = inputs.color.data
    if not kind.rendered or data is None or inputs.plate or inputs.hidden:
        return whole
    if lens.noise is not None or lens.breathing:  # which leave nothing empty, or move it
        return whole
    (height, width), (x, y) = whole.planes[0].shape, whole.layout.corner
    frame = Window(x, y, x + width - 1, y + height - 1)
    drawn = data.grown(Overscan(*[rendered.reach] * 4)).within(frame)
    if drawn == frame or drawn.width < 1 or drawn.height < 1:
        return whole
    rows, columns = frame.cut(drawn)
    extras = dict(zip(whole.extras, _cut(whole.extras.values(), rows, columns), strict=True))
    layout = Layout((drawn.x0, drawn.y0), whole.layout.display or frame, whole.layout.views)
    return whole._replace(planes=_cut(whole.planes, rows, columns), extras=extras, layout=layout)


def _focus(rendered: Rendered) -> Contents:
    """The picture shown in false colour."""
    color = rendered.inputs.color
    (radius,) = _shown(color, [rendered.radii.shown])
    planes = focus_planes(replace(color, planes=_shown(color, color.planes)), radius)
    return Contents(("R", "G", "B"), planes, {}, Layout(color.corner))


def _given_color(rendered: Rendered) -> Contents:
    """The picture as it was given."""
    color = rendered.inputs.color
    planes = tuple(color.planes[: len(color.channels)])
    return _framed(rendered, Contents(color.channels, planes, {}, Layout(color.corner)))


def _given_depth(rendered: Rendered) -> Contents:
    """The depth as it was given, in metres."""
    layout = Layout(rendered.inputs.color.corner)
    return _framed(rendered, Contents(("Z",), (rendered.metres,), {}, layout))


_SOURCES = {"focus": _focus, "color": _given_color, "depth": _given_depth}


def _shown(color: Color, planes: Sequence[Any]) -> tuple[Any, ...]:
    """Arrays [H, W] without the pixels beyond the picture shown."""
    if not any(color.overscan):
        return tuple(planes)
    return _cut(planes, *color.overscan.shown(*color.shape[:2]))


def _cut(planes: Iterable[Any], rows: slice, columns: slice) -> tuple[Any, ...]:
    """Rows and columns of arrays [H, W]."""
    shape = rows.stop - rows.start, columns.stop - columns.start

    def read(plane: Any, within: slice) -> Any:
        first, last, _ = within.indices(shape[0])
        return plane[rows.start + first : rows.start + last][:, columns]

    return tuple(LazyArray(shape, plane.dtype, partial(read, plane)) for plane in planes)


def _of_radius(radius: Any, nothing: Any, compute: Callable[[Any], Any]) -> LazyArray:
    """A map that is computed from the signed radii [H, W]; 0 of nothing."""
    if nothing is None:
        return computed(compute, radius)
    return computed(lambda r, n: compute(r) * ~n, radius, nothing)


def _image(
    rendered: Rendered, kind: Kind
) -> tuple[tuple[str, ...], tuple[Any, ...], dict[str, Any]]:
    """Names and arrays of the channels of colour, and further channels: blurred and carried."""
    color, every = rendered.inputs.color, rendered.images[kind.name]
    half = rendered.job.outputs.exr_type == "half"
    names: list[str] = []
    planes: list[Any] = []
    extras = dict(color.extras)
    count = len(every) // len(kind.rendered_as)
    for number, view in enumerate(kind.rendered_as):
        own = every[number * count : (number + 1) * count]
        own_names = [
            name if number == 0 else name_in_view(name, view)
            for name in (*color.channels, *color.passes)
        ]
        shown = len(color.channels)
        names += own_names[:shown]
        light = tuple(own[:shown])
        planes += noisy(light, color.channels, rendered.job, rendered.lens, view)
        passes = [as_half(plane) if half else plane for plane in own[shown:]]
        extras |= dict(zip(own_names[shown:], passes, strict=True))
    return tuple(names), tuple(planes), extras

"""The contents of an output file: its channels, and where they lie."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

from defocus_core.batch.jobs.output_kinds import Kind
from defocus_core.io.arrays import LazyArray, computed
from defocus_core.io.exr.views import name_in_view
from defocus_core.io.exr.windows import Layout
from defocus_core.io.exr.writing import as_half
from defocus_core.picture.opening import disparity_of
from defocus_core.picture.steps.table import through
from defocus_core.picture.take import Take


class Contents(NamedTuple):
    """The contents of a file."""

    take: Take  # what it is of
    kind: Kind  # the kind of output
    names: tuple[str, ...]  # of its channels of colour; the kind of a map
    planes: tuple[Any, ...]  # arrays [H, W] of these channels
    extras: Mapping[str, Any]
    layout: Layout  # where the first pixel is, the display window, the views

    def mapped(self, change: Callable[[Any], Any]) -> Contents:
        """The contents with each array [H, W] changed."""
        extras = {name: change(plane) for name, plane in self.extras.items()}
        return self._replace(planes=tuple(map(change, self.planes)), extras=extras)


def contents_of(take: Take, kind: Kind) -> Contents:
    """The contents of the file of a kind."""
    layout = Layout(take.inputs.color.corner, None, kind.views)
    make = _SOURCES.get(kind.source) or (_image if kind.image else _map)
    return through("write", Contents(take, kind, *make(take, kind), layout))


_Channels = tuple[tuple[str, ...], tuple[Any, ...], dict[str, Any]]  # names, planes, extras


def _map(take: Take, kind: Kind) -> _Channels:
    """A map: rendered, or computed from the signed radii [H, W], 0 where it is empty."""
    if not kind.of_radius:
        return (kind.name,), take.images[kind.name], {}
    values, empty = partial(kind.of_radius, disparity=disparity_of(take.lens)), take.inputs.empty
    if empty is None:
        return (kind.name,), (computed(values, take.shown),), {}
    return (kind.name,), (computed(lambda r, n: values(r) * ~n, take.shown, empty),), {}


def _image(take: Take, kind: Kind) -> _Channels:
    """Names and arrays of the channels of colour, and further channels: blurred and carried."""
    color, every = take.inputs.color, take.images[kind.name]
    half = take.job.outputs.exr_type == "half"
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
        planes += own[:shown]
        passes = [as_half(plane) if half else plane for plane in own[shown:]]
        extras |= dict(zip(own_names[shown:], passes, strict=True))
    return tuple(names), tuple(planes), extras


def _focus(take: Take, kind: Kind) -> _Channels:
    """The picture shown in false colour."""
    from defocus_core.picture.preview import focus_planes

    color = take.inputs.color
    rows, columns = color.overscan.shown(*color.shape[:2])
    light = [window_of(plane, rows, columns) for plane in color.light]
    return ("R", "G", "B"), focus_planes(light, window_of(take.shown, rows, columns)), {}


def _given_color(take: Take, kind: Kind) -> _Channels:
    """The picture as it was given."""
    color = take.inputs.color
    return color.channels, tuple(color.planes[: len(color.channels)]), {}


def _given_depth(take: Take, kind: Kind) -> _Channels:
    """The depth as it was given, in metres."""
    return ("Z",), (take.metres,), {}


_SOURCES = {"focus": _focus, "color": _given_color, "depth": _given_depth}


def window_of(plane: Any, rows: slice, columns: slice) -> LazyArray:
    """Rows and columns of an array [H, W]."""
    shape = rows.stop - rows.start, columns.stop - columns.start

    def read(within: slice) -> Any:
        first, last, _ = within.indices(shape[0])
        return plane[rows.start + first : rows.start + last][:, columns]

    return LazyArray(shape, plane.dtype, read)

"""The contents of an output file: its channels, and where they lie."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from defocus_cli.exr.views import name_in_view
from defocus_cli.exr.windows import Layout, Window
from defocus_cli.rendering.noisy_planes import noisy
from defocus_cli.rendering.opening import disparity_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from defocus_cli.formats.kinds import Kind
    from defocus_cli.rendering.outcome import Rendering


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


def contents_of(rendering: Rendering, kind: Kind) -> Contents:
    """The contents of the file of a kind, without overscan unless that is kept."""
    color = rendering.color
    if kind.of_picture:
        return _focus(rendering)
    names: tuple[str, ...] = (kind.name,)
    extras: dict[str, Any] = {}
    if kind.of_radius:
        disparity = disparity_of(rendering.outcome.lens)
        planes: tuple[Any, ...] = (
            _OfRadius(rendering.radius, disparity, kind.of_radius, rendering.nothing),
        )
    elif kind.image:
        names, planes, extras = _image(rendering, kind)
    else:
        planes = rendering.images[kind.name]
    outputs, (x, y), overscan = rendering.outcome.job.outputs, color.corner, color.overscan
    if outputs.keep_overscan and any(overscan):
        width, height = color.size
        display = Window(x, y, x + width - 1, y + height - 1)
        corner = (x - overscan.left, y - overscan.top)
        return Contents(names, planes, extras, Layout(corner, display, kind.views))
    if any(overscan):
        window = overscan.shown(*color.shape[:2])
        planes = tuple(_Shown(plane, window) for plane in planes)
        extras = {name: _Shown(plane, window) for name, plane in extras.items()}
    return Contents(names, planes, extras, Layout(color.corner, None, kind.views))


def _focus(rendering: Rendering) -> Contents:
    """The picture shown in false colour."""
    from defocus_cli.rendering.focus_picture import focus_planes

    color, radius = rendering.color, rendering.radius
    if any(color.overscan):
        window = color.overscan.shown(*color.shape[:2])
        planes = tuple(_Shown(plane, window) for plane in color.planes)
        color, radius = replace(color, planes=planes), _Shown(radius, window)
    return Contents(("R", "G", "B"), focus_planes(color, radius), {}, Layout(color.corner))


def _image(
    rendering: Rendering, kind: Kind
) -> tuple[tuple[str, ...], tuple[Any, ...], dict[str, Any]]:
    """Names and arrays of the channels of colour, and further channels: blurred and carried."""
    from defocus_cli.exr.writing import as_half

    color, every = rendering.color, rendering.images[kind.name]
    half = rendering.outcome.job.outputs.exr_type == "half"
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
        planes += noisy(light, color.channels, rendering.outcome.job, rendering.outcome.lens, view)
        passes = [as_half(plane) if half else plane for plane in own[shown:]]
        extras |= dict(zip(own_names[shown:], passes, strict=True))
    return tuple(names), tuple(planes), extras


class _OfRadius:
    """A map that is computed from the signed radii [H, W], a few rows at a time; 0 of nothing."""

    def __init__(
        self, radius: Any, disparity: float, compute: Callable[[Any, float], Any], nothing: Any
    ) -> None:
        self._radius, self._disparity = radius, disparity
        self._compute, self._nothing = compute, nothing
        self.shape, self.dtype = radius.shape, radius.dtype

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        values: NDArray[Any] = self._compute(self._radius[rows], self._disparity)
        if self._nothing is not None:
            values = values * ~self._nothing[rows]
        return values


class _Shown:
    """The rows and columns of an array [H, W] that are written, a few rows at a time."""

    def __init__(self, whole: Any, window: tuple[slice, slice]) -> None:
        self._whole, (self._rows, self._columns) = whole, window
        self.shape = (
            self._rows.stop - self._rows.start,
            self._columns.stop - self._columns.start,
        )
        self.dtype = whole.dtype

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        first, last, _ = rows.indices(self.shape[0])
        top = self._rows.start
        values: NDArray[Any] = self._whole[top + first : top + last]
        return values[:, self._columns]

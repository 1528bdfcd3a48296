"""Deep pictures: the samples of each pixel as layers for the renderer.

What lies behind each other is known, with its coverage; nothing is invented where the file knows
better. Colour and depth of such a file are those of its picture in focus and of its first surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from defocus_cli.system.arrays import Keeping, Windows, bands, count_of, times
from defocus_cli.system.console import counted
from defocus_cli.system.errors import InputError

if TYPE_CHECKING:
    import torch

    from defocus_cli.depth_formats.depth import Depth
    from defocus_cli.exr.header import Header
    from defocus_cli.formats.color import Color
    from defocus_cli.jobs.job import Lens, Picture, Reading
    from defocus_core import Layered, Views


@dataclass(frozen=True)
class Layers:
    """The layers of a deep picture, nearest first.

    Attributes:
        light: of each layer its arrays [H, W] of light, premultiplied: colours, then passes.
        alpha: of each layer [H, W].
        depths: of each layer.
        colors: number of colours in `light`.
        merged: number of pixels that had more samples than there are layers.
    """

    light: tuple[tuple[Any, ...], ...]
    alpha: tuple[Any, ...]
    depths: tuple[Depth, ...]
    colors: int
    merged: int

    @property
    def words(self) -> str:
        """How many layers there are, and what was merged, for people."""
        merged = f", more in {counted(self.merged, 'pixel')} merged" if self.merged else ""
        return f"deep, {counted(len(self.alpha), 'sample')} a pixel at most{merged}"

    def in_order(self, part: Views) -> Views:
        """A rendered part with alpha behind the colours, before the passes."""
        count = len(self.light[0])
        order = [*range(self.colors), count, *range(self.colors, count)]
        if order == [*range(count + 1)]:
            return part
        return part._replace(images=[image[order] for image in part.images])


def deep_header(picture: Picture, reading: Reading, part: int | None) -> Header | None:
    """The part of a picture's colour if it is deep.

    Args:
        picture: the picture.
        reading: how it is read.
        part: the part of the colour that is asked for.

    Raises:
        InputError: the file cannot be read, or has no colour.
    """
    from defocus_cli.exr.header import is_exr, read_headers
    from defocus_cli.exr.views import in_view
    from defocus_cli.formats.exr_channels import choose_color
    from defocus_cli.system.safe_files import read_head

    if not is_exr(read_head(picture.color)):
        return None
    headers = in_view(picture.color, read_headers(picture.color), reading.view)
    if not any(header.deep for header in headers):
        return None
    header = choose_color(picture.color, headers, layer=reading.color_layer, part=part).header
    return header if header.deep else None


def read_deep(
    picture: Picture,
    header: Header,
    reading: Reading,
    like: tuple[Color, Depth],
    keeping: Keeping,
    lens_focal: float | None,
) -> Layers:
    """Read the samples of a deep picture.

    Args:
        picture: where it is.
        header: of its deep part.
        reading: how it is read.
        like: its colour and depth in focus.
        keeping: where the layers are kept.
        lens_focal: focal length of the lens in widths of its sensor, where depth needs it.

    Raises:
        InputError: the file cannot be read, or a sample has no depth.
    """
    from defocus_cli.depth_formats.depth import decoded_alike
    from defocus_cli.exr.deep_samples import ALPHA, DEPTH
    from defocus_cli.exr.reading import read_layers

    color, depth = like
    if picture.depth != picture.color or depth.channel != DEPTH:
        problem = "is deep: its samples have a depth of their own, channel Z"
        raise InputError(picture.color, problem, "leave the depth file and --depth-channel out")
    names = {channel.plain: channel.name for channel in header.channels}
    sources = tuple(names[name] for name in (*color.channels[: len(color.light)], *color.passes))
    read = read_layers(picture.color, header, sources, keeping, color.overscan)
    metres = decoded_alike(
        [layer[DEPTH] for layer in read.layers],
        replace(reading, part=None),
        depth,
        keeping=keeping,
        size=color.size,
        lens_focal=lens_focal,
    )
    alpha = tuple(layer[ALPHA] for layer in read.layers)
    depths = tuple(_depth(depth, *pair) for pair in zip(metres, alpha, strict=True))
    light = tuple(tuple(layer[name] for name in sources) for layer in read.layers)
    return Layers(light, alpha, depths, len(color.light), read.merged)


def _depth(like: Depth, metres: Any, alpha: Any) -> Depth:
    """The depth of one layer; infinitely far where it has no sample.

    Raises:
        InputError: a sample has no depth.
    """
    import numpy as np

    for rows in bands(metres.shape):
        far = np.float32(0 if like.is_radius else np.inf)
        metres[rows] = np.where(np.asarray(alpha[rows]) > 0, metres[rows], far)
    depth = replace(like, metres=metres, nothing=None)
    count, first = count_of((~depth.valid(rows), rows.start) for rows in bands(metres.shape))
    if count:
        problem = f"is NaN or ≤ 0 in {counted(count, 'sample')}, the first in pixel {first}"
        raise InputError(like.path, problem, "write inf for sky, and leave other samples out")
    return depth


def layered(layers: Layers, lens: Lens, keeping: Keeping, device: str, longer: float) -> Layered:
    """The layers as the renderer takes them.

    Args:
        layers: of a deep picture.
        lens: the lens, with its focus distance.
        keeping: where the radii are kept.
        device: cpu or cuda.
        longer: the longer half axis of the blur in px, in radii of the CoC.

    Raises:
        InputError: a sample is so near that no frame would hold its blur.
    """
    from defocus_cli.rendering.focusing import radius_map
    from defocus_core import Layered

    radii = [times(radius_map(lens, depth, keeping)[0], longer) for depth in layers.depths]
    return Layered.of(
        _Light(layers.light, device), Windows(radii, device), Windows(layers.alpha, device)
    )


class _Light:
    """Arrays [H, W] of L layers as a source of `defocus_core`, [L, C, H, W]."""

    def __init__(self, light: tuple[tuple[Any, ...], ...], device: str) -> None:
        self._windows = Windows([plane for planes in light for plane in planes], device)
        self._layers = len(light), len(light[0])
        self.shape = (*self._layers, *self._windows.shape[1:])
        self.device, self.dtype = self._windows.device, self._windows.dtype

    def __getitem__(self, window: Any) -> torch.Tensor:
        """The window [..., rows, columns], on the device."""
        cut = self._windows[window]
        return cut.reshape(*self._layers, *cut.shape[1:])

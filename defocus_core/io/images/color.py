"""Colour images decoded for blurring: scene-linear, premultiplied by alpha.

EXR, HDR and float TIFF are linear already. Integers of 8 and 16 bits are sRGB unless the file
declares otherwise. Light keeps the primaries of the file, which the attributes declare. EXR colour
is premultiplied by definition; other colour is multiplied by alpha here, in linear light. In an EXR
one layer is the colour; other channels are passes, light that is blurred with it, or extras, which
are copied unchanged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.arrays import count_of
from defocus_core.io.exr.channel_choice import (
    ChannelGroup,
    choose_color,
    default_warning,
    in_view,
    light_passes,
)
from defocus_core.io.exr.header import Header, Raw, is_exr, read_headers
from defocus_core.io.exr.reading import ExrPart, read_parts
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan, Window
from defocus_core.io.images.primaries import (
    REC_709,
    declared_primaries,
    primaries_attribute,
    primaries_name,
    same_primaries,
)
from defocus_core.io.read_files import read_head
from defocus_core.system.text import counted

if TYPE_CHECKING:
    from defocus_core.io.images.raster import Raster


@dataclass(frozen=True)
class Color:
    """A decoded colour image.

    `pixels` is one array of the colour and alpha, `planes` has an array for each channel.
    """

    # Arrays [H, W], half or float32, scene-linear, premultiplied: first `channels`, then `passes`
    planes: tuple[Any, ...]
    channels: tuple[str, ...]  # names: R, G, B or Y, then A if there is one
    path: Path
    # Metadata to copy to the output: `Raw` of an EXR file, `Tag` and `Embedded` of others
    attributes: Mapping[str, object] = field(default_factory=dict)
    # Other channels [H, W] of an EXR file by name, in its types, to copy to the output
    extras: dict[str, Any] = field(default_factory=dict)
    pixel_aspect: float = 1.0  # width of a pixel divided by its height
    corner: tuple[int, int] = (0, 0)  # x and y of the first pixel shown
    data: Window | None = None  # least window with the pixels of all parts; None if it is not EXR
    overscan: Overscan = NO_OVERSCAN  # pixels of planes and extras beyond the picture shown
    passes: tuple[str, ...] = ()  # names of further channels of light, blurred with the picture
    note: str = ""  # how the samples were read, in words
    warnings: tuple[str, ...] = ()  # notes on what the file declares that was not applied
    left_out: tuple[str, ...] = ()  # notes on parts of the EXR file that are not copied
    compression: str = "zip"  # the codec of an EXR file
    within_white: bool = False  # whether samples are integers, whose greatest value is white
    orientation: int = 1  # the Exif orientation that was undone, 1 to 8

    @property
    def shape(self) -> tuple[int, int, int]:
        """(height, width, number of planes)."""
        height, width = self.planes[0].shape
        return height, width, len(self.planes)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the picture shown, in px."""
        rows, columns = self.overscan.shown(*self.planes[0].shape)
        return columns.stop - columns.start, rows.stop - rows.start

    @property
    def is_cut(self) -> bool:
        """Whether the EXR file lacks pixels of the picture."""
        (x, y), (width, height) = self.corner, self.size
        frame = Window(x, y, x + width - 1, y + height - 1).grown(self.overscan)
        return self.data is not None and not self.data.covers(frame)

    @property
    def alpha(self) -> Any:
        """The plane of alpha [H, W]; None if there is none."""
        return self.planes[len(self.channels) - 1] if self.channels[-1] == "A" else None

    @property
    def light(self) -> tuple[Any, ...]:
        """The planes of the picture's colour [H, W], without alpha."""
        return self.planes[: len(self.channels) - (self.channels[-1] == "A")]

    @property
    def pixels(self) -> NDArray[np.float32]:
        """The channels without passes, float32 [H, W, C]."""
        own = self.planes[: len(self.channels)]
        return np.stack([plane[:] for plane in own], axis=2, dtype=np.float32)


SHARP_INSIDE = "the sharp picture inside it"  # end of the note on such a picture
BRIGHTEST = 1e30  # light beyond it overflows in `defocus_core`, which refuses it too
LARGEST_FLOAT = float.fromhex("0x1.fffffep+127")  # of 32 bits


def read_color(
    path: Path,
    *,
    layer: str | None = None,
    part: int | None = None,
    view: str | None = None,
    overscan: Overscan = NO_OVERSCAN,
    blur_channels: Sequence[str] = (),
    original: bool = False,
    carried: bool = True,
) -> Color:
    """Decode a colour image.

    Args:
        path: The file.
        layer: Name of a colour layer of an EXR file; PART/LAYER works, too.
        part: Index of a part of an EXR file, or of a page of a TIFF.
        view: Name of a view of an EXR file; None for the default one.
        overscan: Pixels beyond the display window that are read, too.
        blur_channels: Names or patterns of further channels of light, which become passes.
        original: Whether the sharp picture inside a photograph is read instead, if there is one.
        carried: Whether the other channels of an EXR file are read, too.

    Raises:
        InputError: If the file cannot be read, or has no colour or several to choose from.
        UsageProblem: If a layer or channels are named for a file that is not EXR.
    """
    if not is_exr(read_head(path)):
        for option, value in (("color-layer", layer), ("blur-channels", blur_channels)):
            if value:
                problem = f"{path} has no channels to choose from"
                raise UsageProblem("idle-option", problem, "leave it out", field=option)
        return _no_exr(path, part, original=original)
    every = read_headers(path)
    headers = in_view(path, every, view)
    chosen = choose_color(path, headers, layer=layer, part=part)
    own = (chosen.header.index, *chosen.channels.values())

    def wanted(header: Header, name: str) -> bool:
        return carried or (header.index == own[0] and name in own[1:])

    parts = read_parts(path, headers, wanted, overscan)
    channels, planes = _planes(parts[chosen.header.index], chosen, overscan)
    extras, left_out = _extras(parts, chosen) if carried else ({}, ())
    passes = light_passes(path, extras, blur_channels)
    planes += [extras.pop(name) for name in passes]
    is_half = all(plane.dtype == np.float16 for plane in planes)
    attributes = {k: v for k, v in chosen.header.attributes.items() if k != _THUMBNAIL}
    if chosen.header.shown:
        attributes["view"] = Raw("string", chosen.header.shown.encode())
    return Color(
        planes=tuple(np.stack(planes, dtype="f2" if is_half else "f4", casting="unsafe")),
        channels=channels,
        path=path,
        passes=passes,
        attributes=attributes,
        extras=extras,
        pixel_aspect=_aspect(chosen.header),
        corner=(chosen.header.display.x0, chosen.header.display.y0),
        data=Window(
            *(min(header.data[side] for header in headers) for side in (0, 1)),
            *(max(header.data[side] for header in headers) for side in (2, 3)),
        ),
        overscan=overscan,
        note=_exr_note(chosen, overscan),
        warnings=default_warning(every, view),
        left_out=left_out,
        compression=chosen.header.compression,
    )


def _no_exr(path: Path, part: int | None, *, original: bool) -> Color:
    from defocus_core.io.array_files import array_type
    from defocus_core.io.depth_formats.photo_depth import sharp_original
    from defocus_core.io.images.raster import choose_page, read_pages, upright

    if array_type(read_head(path, 32)):
        problem = "is a map of floats without colour"
        remedy = "use EXR, PNG, JPEG, TIFF, WEBP or HDR for colour"
        raise InputError("no-color", problem, remedy, path=path)
    page = choose_page(path, read_pages(path), part)
    with sharp_original(path) if original else nullcontext(path) as sharp:
        if sharp == path:
            return _from_raster(path, page)
        color = _from_raster(sharp, read_pages(sharp)[0])
    turn = page.orientation if color.orientation == 1 else 1
    return replace(
        color,
        planes=tuple(upright(plane[:], turn) for plane in color.planes),
        path=path,
        attributes={**page.tags, **color.attributes},
        note=f"{color.note}, {SHARP_INSIDE}",
    )


def count_beyond(color: Color, maximum: float) -> tuple[int, str]:
    """The number of pixels that are NaN or beyond ±`maximum`, and the first as "x,y" or ""."""
    most = np.float32(maximum)
    return count_of(~np.logical_and.reduce([np.abs(p) <= most for p in color.planes]))


def require_finite(color: Color) -> None:
    """Refuse a colour image whose pixels are not all finite and within ±`BRIGHTEST`."""
    for code, most, what, remedy in (
        (
            *("not-finite", LARGEST_FLOAT, "NaN or infinite"),
            "render or save it again with finite values",
        ),
        ("out-of-range", BRIGHTEST, f"beyond ±{BRIGHTEST:g}", "scale it: light has no unit here"),
    ):
        count, first = count_beyond(color, most)
        if count:
            problem = f"is {what} in {counted(count, 'pixel')}, the first at {first}"
            raise InputError(code, problem, remedy, path=color.path)


def _from_raster(path: Path, raster: Raster) -> Color:
    from defocus_core.io.images.color_space import linear_light, unit
    from defocus_core.io.images.raster import read_samples

    if raster.deep:
        raise InputError("deep-data", "holds deep data", "flatten it first", path=path)
    names = raster.channels
    wanted = "RGBA" if {"R", "G", "B"} <= set(names) else "YA"
    channels = tuple(c for c in wanted if c in names)
    if channels in ((), ("A",)):
        problem = f"has no colour channels (R, G, B or Y), only {', '.join(names)}"
        raise InputError("no-color", problem, "save it as RGB or grey", path=path)
    which, space = [names.index(c) for c in channels], raster.space
    if space.hdr:
        problem = f"has the curve {space.hdr} of HDR television, which is not decoded"
        raise InputError("unsupported", problem, "convert it to sRGB, or to linear EXR", path=path)
    every = read_samples(path, raster.page)
    alpha = unit(every[:, :, which[-1]]) if channels[-1] == "A" else None
    decode = partial(linear_light, alpha=alpha, gamma=space.gamma, associated=raster.associated)
    planes = np.empty((len(which), *every.shape[:2]), np.float32)
    for plane, index in zip(planes, which, strict=True):
        plane[:] = alpha if names[index] == "A" else decode(every[:, :, index])
    unheeded = f"its {space.unheeded} is not applied" if space.unheeded else ""
    warnings = (f"{unheeded}; convert it to sRGB, or to linear EXR",) if unheeded else ()
    return Color(
        tuple(planes),
        channels,
        path,
        {**raster.tags, **space.attributes, **primaries_attribute(space.primaries)},
        note=", ".join(filter(None, (space.note, unheeded.replace(" is not", " not")))),
        warnings=warnings,
        within_white=raster.type.startswith("uint"),
        orientation=raster.orientation,
    )


_NEARLY_SQUARE = 1e-3  # difference of the sides of a pixel as a share of one
_THUMBNAIL = "preview"  # attribute of an EXR header


def _planes(
    part: ExrPart, chosen: ChannelGroup, overscan: Overscan
) -> tuple[tuple[str, ...], list[Any]]:
    """The names and the arrays [H, W] of a colour layer.

    Alpha is added if the file lacks pixels of the frame: 1 where it has pixels, else 0.
    """
    header, names = chosen.header, tuple(chosen.channels)
    planes = [part.channels[name] for name in chosen.channels.values()]
    frame = header.display.grown(overscan)
    if "A" in names or header.data.covers(frame):
        return names, planes
    alpha = np.zeros((frame.height, frame.width), planes[0].dtype)
    rows, columns = frame.cut(header.data)
    alpha[rows, columns] = np.ones((rows.stop - rows.start, columns.stop - columns.start), "f2")
    return (*names, "A"), [*planes, alpha]


def _aspect(header: Header) -> float:
    aspect = header.pixel_aspect
    return 1.0 if abs(aspect - 1) <= _NEARLY_SQUARE else aspect


def _exr_note(chosen: ChannelGroup, overscan: Overscan) -> str:
    header, names = chosen.header, chosen.channels.values()
    kinds = {channel.type for channel in header.channels if channel.name in names}
    declared, aspect = declared_primaries(header.attributes), _aspect(header)
    words = {
        f"EXR {' and '.join(sorted(kinds))}, linear": True,
        f"layer {chosen.name} as {''.join(chosen.channels)}": not chosen.default,
        f"primaries {primaries_name(declared)}": not same_primaries(declared, REC_709),
        f"view {header.shown}": bool(header.shown),
        f"pixels {aspect:g} times as wide as high": aspect != 1,
        header.cut_note(overscan): bool(header.cut_note(overscan)),
        "its thumbnail, which is sharp, left out": _THUMBNAIL in header.attributes,
    }
    return ", ".join(text for text, is_said in words.items() if is_said)


def _extras(
    parts: Sequence[ExrPart], chosen: ChannelGroup
) -> tuple[dict[str, NDArray[Any]], tuple[str, ...]]:
    """The channels outside the layer by name, and notes on parts that are left out.

    A channel is called PART.NAME if it is in another, named part, or if NAME alone is taken.
    """
    size = (chosen.header.display.width, chosen.header.display.height)
    extras: dict[str, NDArray[Any]] = {}
    left_out = []
    for part in sorted(parts, key=lambda p: p.header.index != chosen.header.index):
        display = part.header.display
        plain = {channel.name: channel.plain for channel in part.header.channels}
        if not plain:  # of another view
            continue
        is_of_color = part.header.index == chosen.header.index
        if (part.header.deep and not is_of_color) or (display.width, display.height) != size:
            why = "which is deep" if part.header.deep else "which is of another size"
            left_out.append(f"part {part.header.label}, {why}, left out")
            continue
        for name, plane in part.channels.items():
            if is_of_color and name in chosen.channels.values():
                continue
            own, label = plain[name], part.header.label
            label = label.removesuffix(part.header.view).rstrip("._-") or label
            is_bare = not is_of_color and part.header.name and not own.startswith(f"{label}.")
            taken = is_bare or own in extras or own in chosen.channels
            extras[f"{label}.{own}" if taken else own] = plane
    return extras, tuple(left_out)

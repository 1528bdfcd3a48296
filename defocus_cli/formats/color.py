"""Colour images decoded for blurring: scene-linear float32, premultiplied by alpha.

EXR, HDR and float TIFF are linear already. 8 and 16 bit integers are sRGB unless the file declares
otherwise. EXR alpha is premultiplied by definition; other files' is multiplied in here, in linear
light.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from defocus_cli.exr.chroma import rgb_of, weights_of
from defocus_cli.exr.header import Raw, is_exr, read_headers
from defocus_cli.exr.reading import Part, read_parts
from defocus_cli.exr.views import default_warning, in_view
from defocus_cli.exr.windows import NO_OVERSCAN, Overscan
from defocus_cli.formats.color_space import linear_light, unit
from defocus_cli.formats.exr_channels import ChannelGroup, choose_color
from defocus_cli.formats.float_maps import is_float_map
from defocus_cli.formats.raster import Raster, choose_page, read_pages, read_samples
from defocus_cli.system.arrays import IN_MEMORY, Keeping, bands, count_of
from defocus_cli.system.console import counted
from defocus_cli.system.errors import InputError, UsageProblem
from defocus_cli.system.safe_files import read_head

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

_THUMBNAIL = "preview"  # attribute of an EXR header
BRIGHTEST = 1e30  # light beyond it overflows in `defocus_core`, which refuses it too
LARGEST_FLOAT = float.fromhex("0x1.fffffep+127")  # of 32 bits


@dataclass(frozen=True)
class Color:
    """A decoded colour image.

    Attributes:
        planes: C arrays [H, W], half or float32, scene-linear, alpha premultiplied.
        channels: names of the C channels: R, G, B or Y, then A if there is one.
        path: the file.
        attributes: metadata for the output to carry: `Raw` of an EXR file, `Tag` of others.
        extras: the EXR file's other channels [H, W], native types, for the output to carry.
        corner: x and y of the first pixel shown, for an EXR output to be where the input is.
        overscan: pixels of the planes and the extras beyond the picture shown.
        note: how the samples were read, in words.
        warnings: what of the file was not applied, in words.
        left_out: parts of the EXR file that no output can carry, in words.
    """

    planes: tuple[Any, ...]
    channels: tuple[str, ...]
    path: Path
    attributes: Mapping[str, object] = field(default_factory=dict)
    extras: dict[str, Any] = field(default_factory=dict)
    corner: tuple[int, int] = (0, 0)
    overscan: Overscan = NO_OVERSCAN
    note: str = ""
    warnings: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def shape(self) -> tuple[int, int, int]:
        """(height, width, C)."""
        height, width = self.planes[0].shape
        return height, width, len(self.planes)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the picture shown, in px."""
        rows, columns = self.overscan.shown(*self.planes[0].shape)
        return columns.stop - columns.start, rows.stop - rows.start

    @property
    def alpha(self) -> Any:
        """The plane of alpha [H, W]; None if there is none."""
        return self.planes[-1] if self.channels[-1] == "A" else None

    @property
    def pixels(self) -> NDArray[np.float32]:
        """The whole image, float32 [H, W, C]."""
        import numpy as np

        return np.stack([plane[:] for plane in self.planes], axis=2, dtype=np.float32)


def read_color(
    path: Path,
    *,
    layer: str | None = None,
    part: int | None = None,
    view: str | None = None,
    keeping: Keeping = IN_MEMORY,
    overscan: Overscan = NO_OVERSCAN,
) -> Color:
    """Decode a colour image.

    Args:
        path: an EXR, HDR, PNG, JPEG or TIFF file.
        layer: which colour layer of an EXR file, as its error message lists them; PART/LAYER works.
        part: only look in this part of a multi-part EXR file, or page of a TIFF, counted from 0.
        view: which view of an EXR file of several; None for its default one.
        keeping: where the pixels are to be kept.
        overscan: pixels of an EXR file beyond its display window that are read, too.

    Raises:
        InputError: the file cannot be read, or has no colour or several to choose from.
        UsageProblem: a layer for a file that has none.
    """
    head = read_head(path)
    if is_exr(head):
        return _from_exr(path, layer, part, view, keeping, overscan)
    if path.suffix.lower() == ".exr":
        raise InputError(path, "is not an OpenEXR file", "check what wrote it")
    if is_float_map(head):
        problem = "is a map of floats without colour"
        raise InputError(path, problem, "use EXR, PNG, JPEG, TIFF or HDR for colour")
    if layer is not None:
        raise UsageProblem("--color-layer", f"{path} has no layers", "leave it out")
    return _from_raster(path, choose_page(path, read_pages(path), part), keeping)


def count_beyond(color: Color, most: float) -> tuple[int, str]:
    """Number of pixels of a colour image that are NaN or beyond ±most, and the first as x,y."""
    import numpy as np

    return count_of(
        (
            ~np.logical_and.reduce([np.abs(p[rows]) <= np.float32(most) for p in color.planes]),
            rows.start,
        )
        for rows in bands(color.shape)
    )


def require_finite(color: Color) -> None:
    """Refuse a colour image whose pixels are not all finite and within ±`BRIGHTEST`.

    Raises:
        InputError: naming how many pixels are not, and the first as x,y.
    """
    count, first = count_beyond(color, BRIGHTEST)
    if not count:
        return
    infinite, first_infinite = count_beyond(color, LARGEST_FLOAT)
    if infinite:
        problem = f"is NaN or infinite in {counted(infinite, 'pixel')}, the first at"
        remedy = "render or save it again with finite values"
        raise InputError(color.path, f"{problem} {first_infinite}", remedy)
    problem = f"is beyond ±{BRIGHTEST:g} in {counted(count, 'pixel')}, the first at {first}"
    raise InputError(color.path, problem, "scale it: light has no unit here")


def _from_exr(
    path: Path,
    layer: str | None,
    part: int | None,
    view: str | None,
    keeping: Keeping,
    overscan: Overscan,
) -> Color:
    every = read_headers(path)
    headers = in_view(path, every, view)
    chosen = choose_color(path, headers, layer=layer, part=part)
    parts = read_parts(path, headers, keeping, overscan=overscan)
    channels, planes = _planes(parts[chosen.header.index], chosen, keeping, overscan)
    extras, left_out = _extras(parts, chosen)
    attributes = {k: v for k, v in chosen.header.attributes.items() if k != _THUMBNAIL}
    if chosen.header.shown:
        attributes["view"] = Raw("string", chosen.header.shown.encode())
    return Color(
        planes=_one_type(planes, keeping),
        channels=channels,
        path=path,
        attributes=attributes,
        extras=extras,
        corner=(chosen.header.display.x0, chosen.header.display.y0),
        overscan=overscan,
        note=_exr_note(chosen, overscan),
        warnings=tuple(filter(None, [default_warning(every, view)])),
        left_out=left_out,
    )


def _planes(
    part: Part, chosen: ChannelGroup, keeping: Keeping, overscan: Overscan
) -> tuple[tuple[str, ...], list[Any]]:
    """The names and arrays of a colour layer; alpha is added where a part has pixels of the frame.

    A picture that is smaller than its frame is an element, with nothing around it.
    """
    import numpy as np

    header, names = chosen.header, tuple(chosen.channels)
    planes = [part.channels[name] for name in chosen.channels.values()]
    if "RY" in names:
        planes[:3] = rgb_of(planes[0], planes[1:3], weights_of(header))
        names = ("R", "G", "B", *names[3:])
    frame = header.display.grown(overscan)
    if "A" in names or header.data.covers(frame):
        return names, planes
    alpha = keeping.new((frame.height, frame.width), planes[0].dtype)
    rows, columns = frame.cut(header.data)
    alpha[rows, columns] = np.ones((rows.stop - rows.start, columns.stop - columns.start), "f2")
    return (*names, "A"), [*planes, alpha]


def _exr_note(chosen: ChannelGroup, overscan: Overscan) -> str:
    header, names = chosen.header, chosen.channels.values()
    kinds = {channel.type for channel in header.channels if channel.name in names}
    thumbnail = "its thumbnail, which is sharp, left out" * (_THUMBNAIL in header.attributes)
    view = f"view {header.shown}" if header.shown else ""
    chroma = "luminance and chroma" if "RY" in chosen.channels else ""
    kind = f"EXR {' and '.join(sorted(kinds))}, linear"
    return ", ".join(filter(None, (kind, view, chroma, header.cut_note(overscan), thumbnail)))


def _one_type(planes: Sequence[Any], keeping: Keeping) -> tuple[Any, ...]:
    """Channels of one type: half if all are half, else float32."""
    import numpy as np

    if all(plane.dtype == np.float16 for plane in planes):
        return tuple(planes)
    floats = []
    for plane in planes:
        if plane.dtype != np.float32:
            native, plane = plane, keeping.new(plane.shape, np.float32)
            for rows in bands(plane.shape):
                plane[rows] = native[rows]
        floats.append(plane)
    return tuple(floats)


def _extras(
    parts: Sequence[Part], chosen: ChannelGroup
) -> tuple[dict[str, NDArray[Any]], tuple[str, ...]]:
    """Channels beside the chosen layer, and in words the parts that the output cannot carry.

    A channel is called PART.NAME where its plain name is taken.
    """
    size = (chosen.header.display.width, chosen.header.display.height)
    extras: dict[str, NDArray[Any]] = {}
    left_out = []
    for part in sorted(parts, key=lambda p: p.header.index != chosen.header.index):
        display = part.header.display
        plain = {channel.name: channel.plain for channel in part.header.channels}
        if not plain:  # of another view
            continue
        lost = [name for name in plain if name not in part.channels and not part.header.deep]
        if lost:
            left_out.append(f"{', '.join(lost)}, with fewer samples than pixels, left out")
        if part.header.deep or (display.width, display.height) != size:
            why = "which is deep" if part.header.deep else "which is of another size"
            left_out.append(f"part {part.header.label}, {why}, left out")
            continue
        is_of_color = part.header.index == chosen.header.index
        for name, plane in part.channels.items():
            if is_of_color and name in chosen.channels.values():
                continue
            own = plain[name]
            taken = own in extras or own in chosen.channels
            extras[f"{part.header.label}.{own}" if taken else own] = plane
    return extras, tuple(left_out)


def _from_raster(path: Path, raster: Raster, keeping: Keeping) -> Color:
    import numpy as np

    if raster.deep:
        raise InputError(path, "holds deep data", "flatten it first")
    names = raster.channels
    wanted = "RGBA" if {"R", "G", "B"} <= set(names) else "YA"
    channels = tuple(c for c in wanted if c in names)
    if channels in ((), ("A",)):
        problem = f"has no colour channels (R, G, B or Y), only {', '.join(names)}"
        raise InputError(path, problem, "save it as RGB or grey")
    which = [names.index(c) for c in channels]
    size = raster.height, raster.width
    planes = tuple(keeping.new(size, np.float32) for _ in channels)
    for window, every in read_samples(path, raster.page):
        samples = every[:, :, which]
        alpha = unit(samples[:, :, -1:]) if channels[-1] == "A" else None
        colour = samples if alpha is None else samples[:, :, :-1]
        pixels = linear_light(colour, alpha, gamma=raster.space.gamma, associated=raster.associated)
        parts = pixels if alpha is None else np.concatenate([pixels, alpha], axis=2)
        for index, plane in enumerate(planes):
            plane[window] = parts[:, :, index]
    note, unheeded = raster.space.note, raster.space.unheeded
    if not unheeded:
        return Color(planes, channels, path, raster.tags, note=note)
    warning = f"its {unheeded} is not applied; convert it to sRGB, or to linear EXR"
    note = f"{note}, its {unheeded} not applied"
    return Color(planes, channels, path, raster.tags, note=note, warnings=(warning,))

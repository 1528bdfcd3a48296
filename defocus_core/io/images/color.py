"""Colour images decoded for blurring: scene-linear float32, premultiplied by alpha.

EXR, HDR and float TIFF are linear already. 8 and 16 bit integers are sRGB unless the file declares
otherwise. Light keeps the primaries of the file; the attributes declare them. EXR alpha is
premultiplied by definition; other files' is multiplied in here, in linear light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from defocus_core.errors import InputError, UsageProblem
from defocus_core.io.array_files.float_maps import is_float_map
from defocus_core.io.arrays import IN_MEMORY, Keeping, bands, count_of
from defocus_core.io.depth_formats.photo_depth import heic_pixels, is_heic, sharp_original
from defocus_core.io.exr.header import is_exr
from defocus_core.io.exr.windows import NO_OVERSCAN, Overscan
from defocus_core.io.images.color_planes import Color
from defocus_core.io.images.color_space import linear_light, profiled_space, unit
from defocus_core.io.images.exr_color import read_exr_color
from defocus_core.io.images.primaries import primaries_attribute
from defocus_core.io.images.raster import Raster, choose_page, read_pages, read_samples, upright
from defocus_core.io.safe_files import read_head
from defocus_core.system.text import counted

SHARP_INSIDE = "the sharp picture inside it"  # ends the note of a photograph of which that is read
BRIGHTEST = 1e30  # light beyond it overflows in `defocus_core`, which refuses it too
LARGEST_FLOAT = float.fromhex("0x1.fffffep+127")  # of 32 bits


def read_color(
    path: Path,
    *,
    layer: str | None = None,
    part: int | None = None,
    view: str | None = None,
    keeping: Keeping = IN_MEMORY,
    overscan: Overscan = NO_OVERSCAN,
    blur_channels: Sequence[str] = (),
    original: bool = False,
    carried: bool = True,
) -> Color:
    """Decode a colour image.

    Args:
        path: an EXR, HDR, PNG, JPEG, TIFF or WEBP file.
        layer: which colour layer of an EXR file, as its error message lists them; PART/LAYER works.
        part: only look in this part of a multi-part EXR file, or page of a TIFF, counted from 0.
        view: which view of an EXR file of several; None for its default one.
        keeping: where the pixels are to be kept.
        overscan: pixels of an EXR file beyond its display window that are read, too.
        blur_channels: names or patterns of the further channels of an EXR file that are light.
        original: whether the sharp picture inside a photograph is taken, where there is one.
        carried: whether further channels of an EXR file are read.

    Raises:
        InputError: the file cannot be read, or has no colour or several to choose from.
        UsageProblem: a layer for a file that has none.
    """
    head = read_head(path)
    if is_exr(head):
        return read_exr_color(
            path,
            layer=layer,
            part=part,
            view=view,
            blur_channels=blur_channels,
            keeping=keeping,
            overscan=overscan,
            carried=carried,
        )
    if path.suffix.lower() == ".exr":
        raise InputError("wrong-type", "is not an OpenEXR file", "check what wrote it", path=path)
    if is_float_map(head):
        problem = "is a map of floats without colour"
        remedy = "use EXR, PNG, JPEG, TIFF, WEBP or HDR for colour"
        raise InputError("no-color", problem, remedy, path=path)
    if layer is not None:
        remedy = "leave it out"
        raise UsageProblem("idle-option", f"{path} has no layers", remedy, field="color-layer")
    if blur_channels:
        problem = f"{path} has no further channels"
        raise UsageProblem("idle-option", problem, "leave it out", field="blur-channels")
    if is_heic(read_head(path)):
        return _from_heic(path)
    page = choose_page(path, read_pages(path), part)
    if not original:
        return _from_raster(path, page, keeping)
    with sharp_original(path) as sharp:
        if sharp == path:
            return _from_raster(path, page, keeping)
        color = _from_raster(sharp, read_pages(sharp)[0], keeping)
    turn = page.orientation if color.orientation == 1 else 1
    return replace(
        color,
        planes=tuple(upright(plane[:], turn) for plane in color.planes),
        path=path,
        attributes={**page.tags, **color.attributes},
        note=f"{color.note}, {SHARP_INSIDE}",
    )


def _from_heic(path: Path) -> Color:
    """The picture of a HEIC photograph, which libheif has turned upright."""
    samples, data = heic_pixels(path)
    space = profiled_space(data)
    channels = ("R", "G", "B", "A")[: samples.shape[2]] if samples.shape[2] > 2 else ("Y",)
    alpha = unit(samples[:, :, 3:]) if len(channels) == 4 else None
    light = linear_light(
        samples[:, :, :3] if len(channels) > 1 else samples[:, :, :1],
        alpha,
        gamma=None,
        associated=False,
        profile=space.profile,
    )
    planes = light if alpha is None else np.concatenate([light, alpha], axis=2)
    return Color(
        tuple(np.ascontiguousarray(plane) for plane in np.moveaxis(planes, 2, 0)),
        channels,
        path,
        {**space.attributes, **primaries_attribute(space.primaries)},
        note=f"HEIC, {space.note}",
        within_white=True,
    )


def count_beyond(color: Color, maximum: float) -> tuple[int, str]:
    """Number of pixels of a colour image that are NaN or beyond ±most, and the first as x,y."""
    return count_of(
        (
            ~np.logical_and.reduce([np.abs(p[rows]) <= np.float32(maximum) for p in color.planes]),
            rows.start,
        )
        for rows in bands(color.shape)
    )


def require_finite(color: Color) -> None:
    """Refuse a colour image whose pixels are not all finite and within ±`BRIGHTEST`."""
    count, first = count_beyond(color, BRIGHTEST)
    if not count:
        return
    infinite, first_infinite = count_beyond(color, LARGEST_FLOAT)
    if infinite:
        problem = f"is NaN or infinite in {counted(infinite, 'pixel')}, the first at"
        remedy = "render or save it again with finite values"
        raise InputError("not-finite", f"{problem} {first_infinite}", remedy, path=color.path)
    problem = f"is beyond ±{BRIGHTEST:g} in {counted(count, 'pixel')}, the first at {first}"
    raise InputError("out-of-range", problem, "scale it: light has no unit here", path=color.path)


def _from_raster(path: Path, raster: Raster, keeping: Keeping) -> Color:
    if raster.deep:
        raise InputError("deep-data", "holds deep data", "flatten it first", path=path)
    names = raster.channels
    wanted = "RGBA" if {"R", "G", "B"} <= set(names) else "YA"
    channels = tuple(c for c in wanted if c in names)
    if channels in ((), ("A",)):
        problem = f"has no colour channels (R, G, B or Y), only {', '.join(names)}"
        raise InputError("no-color", problem, "save it as RGB or grey", path=path)
    which = [names.index(c) for c in channels]
    size = raster.height, raster.width
    planes = tuple(keeping.new(size, np.float32) for _ in channels)
    for window, every in read_samples(path, raster.page):
        samples = every[:, :, which]
        alpha = unit(samples[:, :, -1:]) if channels[-1] == "A" else None
        colour = samples if alpha is None else samples[:, :, :-1]
        pixels = linear_light(
            colour,
            alpha,
            gamma=raster.space.gamma,
            associated=raster.associated,
            profile=raster.space.profile,
        )
        parts = pixels if alpha is None else np.concatenate([pixels, alpha], axis=2)
        for index, plane in enumerate(planes):
            plane[window] = parts[:, :, index]
    note, unheeded = raster.space.note, raster.space.unheeded
    space = raster.space
    attributes = {**raster.tags, **space.attributes, **primaries_attribute(space.primaries)}
    warnings = []
    if unheeded:
        warnings.append(f"its {unheeded} is not applied; convert it to sRGB, or to linear EXR")
        note = f"{note}, its {unheeded} not applied"
    return Color(
        planes,
        channels,
        path,
        attributes,
        note=note,
        warnings=tuple(warnings),
        within_white=raster.type.startswith("uint"),
        orientation=raster.orientation,
    )

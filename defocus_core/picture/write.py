"""Write the output files of a job, all or none."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from hashlib import blake2b
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError, with_dashes
from defocus_core.io.exr.channel_choice import in_words, is_depth, name_in_view
from defocus_core.io.exr.header import codec_of
from defocus_core.io.exr.windows import Layout, Overscan, Window
from defocus_core.io.exr.writing import as_half, clamped_half, write_exr, write_exr_image
from defocus_core.io.images.color import Color
from defocus_core.io.images.primaries import PRIMARIES, PROFILE
from defocus_core.io.write_files import link_or_copy, written_together
from defocus_core.picture.opening import aperture_in_pixels, cat_eye_of, dual_pixel_of
from defocus_core.picture.steps.table import WRITE, apply_steps
from defocus_core.picture.take import Contents, Take, repair_words
from defocus_core.request.lens import LensValues
from defocus_core.request.output_kinds import KINDS, Kind
from defocus_core.request.parameters import RECORDED
from defocus_core.system.text import counted, software, versions

_SAME = 1e-5  # greatest difference in linear light of an unchanged pixel, 3 % of a level
_SHARP_PX = 0.5  # greatest radius of a pixel in focus
_SEED_BYTES = 5  # greatest seed of noise, as rows of pictures add to it


_Channels = tuple[tuple[str, ...], tuple[Any, ...], dict[str, Any]]  # names, planes, extras


def _of_radius(take: Take, kind: Kind) -> _Channels:
    """The channel of a map of signed radii or disparity [H, W] in px; empty pixels are 0."""
    values = disparity_map(take) if kind.source == "disparity" else take.shown
    if (empty := take.inputs.empty) is not None:
        values = values * ~empty
    return (kind.name,), (values,), {}


def _image(take: Take, kind: Kind) -> _Channels:
    """The channels of a rendered image; and further channels of the input, blurred or copied."""
    color, every = take.inputs.color, take.images[kind.name]
    half = take.job.outputs.exr_type == "half"
    names: list[str] = []
    planes: list[Any] = []
    extras = dict(color.extras)
    count = len(every) // len(kind.rendered)
    for number, view in enumerate(kind.rendered):
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
    """The channels of the picture in false colour."""
    from defocus_core.picture.preview import focus_planes

    color = take.inputs.color
    light = [shown(color, plane) for plane in color.light]
    return ("R", "G", "B"), focus_planes(light, shown(color, take.shown)), {}


# The functions that make the channels of kinds, by source; kinds without source are rendered.
_SOURCES: dict[str, Callable[[Take, Kind], _Channels]] = {
    "": lambda take, kind: ((kind.name,), take.images[kind.name], {}),
    "image": _image,
    "radius": _of_radius,
    "disparity": _of_radius,
    "focus": _focus,
    "color": lambda take, kind: (
        take.inputs.color.channels,
        tuple(take.inputs.color.planes[: len(take.inputs.color.channels)]),
        {},
    ),
    "depth": lambda take, kind: (("Z",), (take.inputs.depth.metres,), {}),
}


def changed_by(compression: str, channels: Mapping[str, Any]) -> list[str]:
    """Names of channels, such as ids or depth, that a lossy codec would change but must not."""
    codec, _ = codec_of(compression)
    return [name for name, plane in channels.items() if codec.changes(name, plane.dtype.name)]


_OF_COLORS = {PRIMARIES, PROFILE}


def write(take: Take) -> Take:
    """Write the files of a job, all or none; returns the take with warnings about losses."""
    outputs = take.job.outputs
    if not outputs.root.is_dir():  # a new one would have no journal
        problem = "was removed while jobs were done"
        raise InputError("unwritable", problem, "run the same command again", path=outputs.root)
    with written_together(outputs.root):
        warnings = [warning for kind in outputs.rows for warning in _write_kind(take, kind)]
        for name, path in take.job.picture.carried:
            link_or_copy(path, outputs.root / take.job.names[name])
    if outputs.format == "exr" and any(kind.image for kind in outputs.rows):
        warnings += [*take.inputs.color.left_out, *_not_finite(take.inputs.color.extras)]
    return replace(take, warnings=(*take.warnings, *warnings))


def _not_finite(carried: Mapping[str, Any]) -> Iterator[str]:
    """Yield a warning for each copied channel with NaN or, except in depth, infinite values."""
    for name, plane in carried.items():
        if plane.dtype.kind == "f":
            wrong = np.isnan(plane) if is_depth(name) else ~np.isfinite(plane)
            if count := int(np.count_nonzero(wrong)):
                what = "NaN" if is_depth(name) else "NaN or infinite"
                yield f"{name}, which is copied, is {what} in {counted(count, 'pixel')}"


def _write_kind(take: Take, kind: Kind) -> list[str]:
    """Write the file of a kind of output, and its preview if wanted; returns warnings."""
    job, warnings = take.job, list[str]()
    layout = Layout(take.inputs.color.corner, None, kind.views)
    channels = _SOURCES[kind.source or "image" * kind.image](take, kind)
    contents = apply_steps(WRITE, Contents(take, kind, *channels, layout))
    channel = kind.channel or kind.name
    path, preview = job.paths[kind.name], job.previews.get(kind.name)
    compression = job.outputs.compression
    if compression == "input":
        compression = take.inputs.color.compression
    if kind.image:
        lost = _write_image(path, contents, compression)
        warnings = [f"{kind.name}: {warning}" for warning in lost]
    elif job.outputs.map_format == "tiff":
        from defocus_core.io.images.encode import write_map

        write_map(path, contents.planes[0], channel)
    else:
        own = _attributes(take, kind)
        exact = compression if not changed_by(compression, {channel: contents.planes[0]}) else "zip"
        write_exr(path, {channel: contents.planes[0]}, own, contents.layout, exact)
    if preview is not None:
        _write_preview(preview, contents)
    return warnings


def _write_image(path: Path, contents: Contents, compression: str) -> list[str]:
    """Write an image with the metadata of its input; returns warnings about losses."""
    take, kind, outputs = contents.take, contents.kind, contents.take.job.outputs
    left_out = {"view"} if kind.views else _OF_COLORS if kind.source == "focus" else set()
    if outputs.color_space == "srgb":
        left_out = {*left_out, PROFILE}
    every = take.inputs.color.attributes
    carried = {name: value for name, value in every.items() if name not in left_out}
    if kind.rendered:
        carried = _with_lens(carried, take.lens)
    attributes = carried | _attributes(take, kind)
    if path.suffix.lower() == ".exr":
        warnings = []
        if changed := changed_by(compression, take.inputs.color.extras):
            warnings = [f"written with zip: {compression} would change {in_words(changed)}"]
            compression = "zip"
        return warnings + write_exr_image(
            path,
            dict(zip(contents.names, contents.planes, strict=True)),
            *(outputs.exr_type, attributes, contents.extras, contents.layout, compression),
            take.clamped.get(kind.name, 0),
        )
    from defocus_core.io.images.encode import write_image

    return write_image(
        path,
        contents.planes,
        contents.names,
        bits=16 if outputs.format == "png16" else 8,
        jpeg_quality=outputs.jpeg_quality,
        attributes=attributes,
        has_clipped=not take.inputs.color.within_white,
        smooth=_blurred(contents) if kind.rendered else None,
    )


def _blurred(contents: Contents) -> NDArray[np.bool_]:
    """The pixels [H, W] that are out of focus or whose colour differs from the input."""
    take, color = contents.take, contents.take.inputs.color
    given = [*color.planes, take.shown]
    if not take.job.outputs.keep_overscan:
        given = [shown(color, plane) for plane in given]
    every = zip(contents.planes, given[:-1], strict=False)
    changed = [abs(plane - own) > _SAME for plane, own in every]
    found: NDArray[np.bool_] = np.logical_or.reduce([abs(given[-1]) > _SHARP_PX, *changed])
    return found


# Tags of the lens of a photograph, replaced by a field of ours, or removed.
_LENS_TAGS = {
    **dict.fromkeys(("FNumber", "Exif:FNumber"), "fnum"),
    "Exif:FocalLength": "foclen",
    **dict.fromkeys(("Exif:FocalLengthIn35mmFilm", "Exif:SubjectDistance"), ""),
    **dict.fromkeys(("Exif:ApertureValue", "Exif:MaxApertureValue"), ""),
}


def _with_lens(attributes: Mapping[str, object], lens: LensValues) -> dict[str, object]:
    """Metadata of a photograph with the f-number and focal length of the rendered lens.

    Tags that do not fit this lens, such as the subject distance, are removed.
    """
    tags = attributes.keys() & _LENS_TAGS.keys()
    if not tags:
        return dict(attributes)
    from defocus_core.io.images.raster import Tag

    made = {k: v for k, v in attributes.items() if k not in tags}
    for name in tags:
        if (field := _LENS_TAGS[name]) and not lens.is_shape:
            made[name] = Tag(float(getattr(lens, field)))
    return made


def _write_preview(path: Path, contents: Contents) -> None:
    from defocus_core.picture import preview

    kind, planes = contents.kind, contents.planes
    if kind.signed:
        preview.write_signed_preview(path, planes[0])
    elif kind.source == "depth":
        preview.write_depth_preview(path, planes[0])
    else:
        count = len(planes) // max(1, len(kind.rendered))
        views = [np.stack(planes[n : n + count], axis=2) for n in range(0, len(planes), count)]
        attributes = contents.take.inputs.color.attributes
        preview.write_preview(path, np.concatenate(views, axis=1), attributes)


def _attributes(take: Take, kind: Kind) -> dict[str, str]:
    """The attributes ``defocus:*`` of an EXR output.

    They hold no folders and no time, so that a job that is done again writes the same bytes.
    """
    job, lens = take.job, take.lens
    others = {
        role: f"{other.color.name} {other.depth.name}" for role, other in job.picture.others.items()
    }
    values = {
        "version": versions(),
        "kind": kind.name,
        "color": job.picture.color.name,
        "depth": job.picture.depth.name,
        "hidden": others.pop("hidden", ""),
        **others,
        "color_read_as": take.color_note,
        "depth_read_as": take.depth_words(rendered=bool(kind.rendered)),
        **(_repair(take) if kind.rendered else {}),
        **{
            # fields of every lens, without those that decide radii if a file holds them
            row.name.replace("-", "_"): "" if x is None else row.shown(x, 9) + row.optional_unit
            for row, x in ((row, getattr(lens, row.field)) for row in RECORDED.values())
            if not (row.is_optics and lens.is_shape)
        },
        **{name: str(value) for name, value in lens.effects.items()},
        "coc_px": " ".join(f"{radius:.6g}" for radius in take.limits),
        "quality": job.machine.quality,
        "device": take.device,
        "back": take.back,
        "software": software(),
    }
    return {f"defocus:{name}": value for name, value in values.items()}


def _repair(take: Take) -> dict[str, str]:
    """Attributes: options of depth repair that are not the default, and what it changed."""
    reading = take.job.reading
    asked = [f"‹depth-repair› {reading.depth_repair}"] * (reading.depth_repair != "auto")
    if reading.edge_width is not None:
        asked.append(f"‹edge-width› {reading.edge_width:g}px")
    values = {
        "depth_repair_asked": with_dashes(" ".join(asked)),
        "depth_repair": repair_words(take.repair),
    }
    return {name: value for name, value in values.items() if value}


def add_noise(contents: Contents) -> Contents:
    """Add sensor noise to the rendered planes, except alpha."""
    from defocus_core.picture.grain import grain_of, grained

    take, kind, channels = contents.take, contents.kind, contents.take.inputs.color.channels
    lens, job, planes = take.lens, take.job, []
    grain = grain_of(take) if isinstance(lens.noise, str) else None
    for number, plane in enumerate(contents.planes):
        view, channel = kind.rendered[number // len(channels)], number % len(channels)
        words = f"{lens.noise_seed} {job.picture.stem}{job.suffix} {view} {channels[channel]}"
        seed = int.from_bytes(blake2b(words.encode(), digest_size=_SEED_BYTES).digest())
        is_half = KINDS[view].halves
        if channels[channel] == "A":
            planes.append(plane)
        elif grain is not None:
            planes.append(grained(plane, grain[channel], take.shown, seed, is_half=is_half))
        else:
            electrons, read = cast(tuple[float, float], lens.noise)
            planes.append(_noisy(plane, electrons / 2 if is_half else electrons, read, seed))
    return contents._replace(planes=tuple(planes))


def _noisy(plane: Any, electrons: float, read: float, seed: int) -> NDArray[Any]:
    import torch

    from defocus_core.optics.sensor_noise import with_noise

    light = torch.from_numpy(plane.astype("float32"))[None]
    noisy: NDArray[Any] = with_noise(light, electrons=electrons, read=read, seed=seed)[0].numpy()
    return clamped_half(noisy)[0] if plane.dtype == np.float16 else noisy


def cut_overscan(contents: Contents) -> Contents:
    """Cut overscan off; or, if it is kept, set the display window."""
    color, outputs = contents.take.inputs.color, contents.take.job.outputs
    if contents.kind.source == "focus":
        return contents
    if not outputs.keep_overscan:
        return contents.mapped(lambda plane: shown(color, plane))
    (x, y), (width, height), overscan = color.corner, color.size, color.overscan
    display = Window(x, y, x + width - 1, y + height - 1)
    corner = (x - overscan.left, y - overscan.top)
    return contents._replace(layout=Layout(corner, display, contents.layout.views))


def shown(color: Color, plane: Any) -> Any:
    """A plane [H, W] with its overscan cut off."""
    return plane[color.overscan.shown(*color.shape[:2])]


def cut_border(contents: Contents) -> Contents:
    """Cut off the black border that no light reaches."""
    take, layout, data = contents.take, contents.layout, contents.take.inputs.color.data
    assert data is not None
    (height, width), (x, y) = contents.planes[0].shape, layout.corner
    frame = Window(x, y, x + width - 1, y + height - 1)
    drawn = data.grown(Overscan(*[take.reach] * 4)).intersection(frame)
    if drawn == frame or drawn.width < 1 or drawn.height < 1:
        return contents
    rows, columns = frame.cut(drawn)
    layout = layout._replace(corner=(drawn.x0, drawn.y0), display=layout.display or frame)
    return contents.mapped(lambda plane: plane[rows, columns])._replace(layout=layout)


# Cells along an axis of the frame, at whose corners a varying pupil is computed: interpolation errs
# by 0.1 % of the area of a cat's eye, by 0.6 % where the rim begins to clip.
_CELLS = 16


def disparity_map(take: Take) -> NDArray[Any]:
    """Disparity [H, W] in px along x between left and right, with the sign of the CoC radius."""
    beyond = nearer = _per_radius(take)
    if take.lens.spherical:
        nearer = _per_radius(take, nearer=True)
    radii = take.shown
    far, near = (_interpolated(corners, radii.shape) for corners in (beyond, nearer))
    disparity: NDArray[Any] = radii * np.where(radii < 0, near, far)
    return disparity.astype(radii.dtype, copy=False)


def _per_radius(take: Take, *, nearer: bool = False) -> NDArray[Any]:
    """Disparity between left and right, in px per px of CoC radius.

    The result has the shape [n + 1, n + 1], for the corners of n by n cells of the picture; or [1,
    1] without a cat's eye. `nearer` is for points nearer than the focus.
    """
    import torch

    pupil, longer = aperture_in_pixels(take.lens, take.inputs.color.pixel_aspect)
    pixel, (height, width) = dual_pixel_of(take.lens), take.shown.shape
    cat_eye = cat_eye_of(take.lens, take.size, take.inputs.color.pixel_aspect)
    if cat_eye is None:
        return np.full((1, 1), longer * float(pixel.disparity(pupil, nearer=nearer)))
    x = torch.linspace(0, width, _CELLS + 1, dtype=torch.float64)
    of_rows = []
    for y in torch.linspace(0, height, _CELLS + 1, dtype=torch.float64):
        rim = cat_eye.view(x, y.expand(len(x)), (height, width))
        of_rows.append(pixel.disparity(pupil, nearer=nearer, view=rim))
    corners: NDArray[Any] = longer * torch.stack(of_rows).numpy()
    return corners


def _interpolated(corners: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Interpolate values at the corners of cells to all pixels of a picture, [H, W]."""
    if corners.size == 1:
        return corners
    values: NDArray[Any] = _tents(shape[0]) @ corners @ _tents(shape[1]).T
    return values


def _tents(length: int) -> NDArray[Any]:
    """Weights [length, n + 1] to interpolate from n + 1 cell corners to pixels along an axis."""
    cell = (np.arange(length) + 0.5) * (_CELLS / length)
    weights: NDArray[Any] = np.clip(1 - np.abs(cell[:, None] - np.arange(_CELLS + 1)), 0, None)
    return weights

"""The contents of a file, how it would be read, and the frames of a shot, for ``defocus info``.

A record is a report as a dictionary for JSON, a line is a report in words. Evidence is a hint at
the format of a depth file whose format was not given; it does not change how the file is read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.array_files import has_frames
from defocus_core.io.depth_formats.depth import Depth, read_depth
from defocus_core.io.depth_formats.exr_depth_channel import NO_DEPTH
from defocus_core.io.depth_formats.reading import OF_NUKE, DepthReading, own_format
from defocus_core.io.exr.channel_choice import require_part
from defocus_core.io.exr.deep_samples import DEPTH, read_deep_samples
from defocus_core.io.exr.header import Header, is_exr
from defocus_core.io.exr.reading import read_parts
from defocus_core.io.exr.windows import NO_OVERSCAN
from defocus_core.io.images.color import LARGEST_FLOAT, Color, count_beyond, read_color
from defocus_core.io.images.describe import FileInfo, describe
from defocus_core.io.images.raster import read_samples
from defocus_core.io.read_files import read_head
from defocus_core.io.shots.frame_patterns import frames_of, gaps, in_words
from defocus_core.picture.element import element_depth
from defocus_core.picture.focus import with_blur_reach, with_focus
from defocus_core.picture.pair import overscan_of
from defocus_core.picture.radii import of_radii, radii_of, signed_radius
from defocus_core.picture.scene import map_on
from defocus_core.picture.take import InputPair, repair_record, repair_words
from defocus_core.request.job import PictureFiles, Reading
from defocus_core.request.lens import LensValues, lens_record
from defocus_core.request.output_kinds import KINDS
from defocus_core.system.process import delayed_signals

if TYPE_CHECKING:
    from defocus_core.depth.diagnosis import DepthRepair

# Codes of errors of files that lack colour or depth, but may have the other.
_ABSENT = frozenset({"no-color", "no-depth", "ambiguous", "no-such-channel", "no-such-view"})


def _color_figures(color: Color) -> dict[str, Any]:
    """Channels, and numbers of pixels that are not finite, have alpha 0, or have alpha below 1."""
    nonfinite, _ = count_beyond(color, LARGEST_FLOAT)
    told = {"channels": list(color.channels), "nonfinite_pixels": nonfinite}
    if color.alpha is not None:
        told["nothing_pixels"] = int(np.count_nonzero(color.alpha == 0))
        told["partial_pixels"] = int(np.count_nonzero((color.alpha > 0) & (color.alpha < 1)))
    return told


def _depth_figures(
    path: Path, reading: Reading, lens: LensValues | None, color: Color | None
) -> tuple[str, dict[str, Any]]:
    """How the depth is read, in words, and its figures; ranges are None without valid pixels.

    `color`: the colour in the same file, or None; where its alpha is 0, depth is ignored.
    """
    depth = read_depth(
        path,
        reading,
        lens_focal=None if lens is None else lens.foclen / lens.sensor_width,
        overscan=NO_OVERSCAN if color is None else color.overscan,
        alpha=None if color is None else color.alpha,
    )
    if color is not None and depth.metres.shape == color.shape[:2]:
        depth = element_depth(depth, color)
    usable = depth.valid if depth.empty is None else depth.valid & ~depth.empty
    nothing = 0 if depth.empty is None else int(np.count_nonzero(depth.empty))
    metres = depth.metres[usable]
    finite = metres[np.isfinite(metres)]
    limits, reach = ends_of(metres), ends_of(finite) or None
    invalid = usable.size - metres.size - nothing
    coc_px, repair = None, None
    warnings: tuple[str, ...] = ()
    if lens is not None and limits:
        lens = with_blur_reach(with_focus(lens, depth), (depth,))
        # The radius grows with depth all the way: the extreme depths have the extreme radii.
        extremes = np.array(limits, np.float32)
        most = math.inf if lens.clamp_blur is None else lens.clamp_blur
        coc_px = (
            list(radii_of(lens, depth).limits)
            if depth.is_radius
            else signed_radius(lens, extremes, depth.size).clip(-most, most).tolist()
        )
        if not invalid:
            repair, warnings = _repair(depth, lens, reading)
    return depth.note, {
        "range_m": None if depth.is_radius else reach,
        "range": reach if depth.is_radius else None,
        "sky_pixels": metres.size - finite.size,
        "invalid_pixels": invalid,
        "nothing_pixels": nothing,
        "lens": lens_record(lens) if lens else None,
        "coc_px": coc_px,
        "repair": repair_words(repair),
        "depth_repair": repair_record(repair),
        "warnings": list(warnings),
    }


def _repair(
    depth: Depth, lens: LensValues, reading: Reading
) -> tuple[DepthRepair | None, tuple[str, ...]]:
    """The repair of the depth, and warnings if the depth is implausible for the lens."""
    import torch

    from defocus_core.depth.repair import diagnose_depth

    with suppress(InputError):  # the radius shows that it is too near to render
        radii, declared = radii_of(lens, depth), reading.says_scale
        warnings = of_radii(depth, radii.px, radii.limits, lens, declared=declared)
        repair = diagnose_depth(
            map_on(radii.px, "cpu"),
            radii.infinity,
            torch.get_num_threads(),
            depth_repair=reading.depth_repair,
            edge_width=reading.edge_width,
        )
        return repair, tuple(warnings)
    return None, ()


def ends_of(values: NDArray[Any]) -> list[float]:
    """The least and the greatest value; empty if there are no values."""
    return [float(values.min()), float(values.max())] if values.size else []


def inspect(path: Path, reading: Reading, lens: LensValues | None, *, lone: bool) -> dict[str, Any]:
    """The record of a file, read as ``defocus render`` would.

    `lens`: the lens whose blur is reported, or None. `lone`: whether it is the only file.
    """
    with delayed_signals():
        import numpy  # noqa: F401  an import that Ctrl-C interrupts fails as if by a fault

    info = describe(path)
    stacked = has_frames(path)
    if reading.part is not None and not stacked and (lone or len(info.parts) > 1):
        require_part(path, reading.part, len(info.parts))
    color_note = depth_note = info.nearly_empty and f"not decoded: {info.nearly_empty}"
    picture, color, depth = None, None, None
    maps: list[dict[str, Any]] = []
    evidence: list[str] = []
    if not color_note:
        picture, color_note = _color_of(info, reading)
        color = picture and _color_figures(picture)
        depth_note, depth = _depth_of(path, reading, lens, picture, arrays=stacked)
        maps = _maps(info)
        evidence = [] if maps else [*evidence_of(path, reading, info)]
    return {
        "file": str(path),
        "size": [info.width, info.height],
        "parts": [_part_record(path, part) for part in info.parts],
        "color": color,
        "color_note": color_note,
        "depth": depth,
        "depth_note": depth_note,
        "evidence": evidence,
        "maps": maps,
    }


def _color_of(info: FileInfo, reading: Reading) -> tuple[Color | None, str]:
    """The colour of a file, and how it is read; or None, and why there is none."""
    path, overscan = info.path, NO_OVERSCAN
    if not (is_exr(read_head(path)) or {"R", "G", "B"} <= set(info.names) or "Y" in info.names):
        return None, "has no colour channels"
    with suppress(InputError):  # only if depth lies beside the colour
        overscan = overscan_of(InputPair(PictureFiles("", path, path), reading))
    try:
        picture = read_color(
            path,
            layer=reading.color_layer,
            part=reading.part,
            view=reading.view,
            overscan=overscan,
            original=True,
            carried=False,
        )
    except InputError as error:
        if error.code not in _ABSENT or (reading.color_layer and is_exr(read_head(path))):
            raise
        return None, _clause(error)
    return picture, picture.note


def _depth_of(
    path: Path, reading: Reading, lens: LensValues | None, picture: Color | None, *, arrays: bool
) -> tuple[str, dict[str, Any] | None]:
    """How the depth of a file is read, and its figures; or why there is none, and None."""
    if reading.row.rule == "radius":
        return "holds signed radii in px, which 'defocus render' takes as they are", None
    try:
        return _depth_figures(path, reading, lens, picture)
    except InputError as error:
        absent = picture is not None or arrays or error.code in _ABSENT
        if not absent or (reading.depth_channel and is_exr(read_head(path))):
            raise
        usual = picture is not None and error.code in ("unknown-unit", "not-one-channel")
        return error.problem if usual else _clause(error), None


def _part_record(path: Path, part: Header) -> dict[str, Any]:
    """The record of a part of a file, with the windows of an EXR and the samples of a deep one."""
    told = {
        "index": part.index,
        "name": part.name,
        "deep": part.deep,
        "channels": {channel.name: channel.type for channel in part.channels},
        "views": list(part.views),
    }
    if not is_exr(read_head(path)):
        return told
    told["data_window"], told["display_window"] = list(part.data), list(part.display)
    told["pixel_aspect"] = part.pixel_aspect
    if part.deep:
        samples = read_deep_samples(path, part)
        depth = samples.values.get(DEPTH, np.zeros(0))
        told["samples"] = {
            "most_of_a_pixel": samples.maximum,
            "total": len(samples.rank),
            "pixels": int(np.count_nonzero(samples.rank == 0)),
            "range_z": ends_of(depth[np.isfinite(depth)]) or None,
        }
    return told


def _maps(info: FileInfo) -> list[dict[str, Any]]:
    """Records of the maps that ``defocus render`` wrote: kind, and range of the finite values."""
    kinds = [name for name in info.names if name in NO_DEPTH]
    if not kinds or has_frames(info.path):  # an array may have the name of a map, too
        return []
    maps = []
    for kind, values in _values_of_maps(info.path, kinds):
        ends = ends_of(values[np.isfinite(values)])
        maps.append({"kind": kind, range_key(kind): ends or None})
    return maps


def _values_of_maps(path: Path, kinds: Sequence[str]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Each map of an EXR, or the only one of a TIFF: its kind and its values."""
    if not is_exr(read_head(path)):
        yield kinds[0], read_samples(path)
        return
    for part in read_parts(path, wanted=lambda _, name: name in NO_DEPTH):
        yield from part.channels.items()


def range_key(kind: str) -> str:
    """The key of the range of a map in a record, like ``range_px``; ``range`` without a unit."""
    unit = KINDS[kind].unit
    return f"range_{unit}" if unit else "range"


def _clause(error: InputError) -> str:
    return f"{error.problem}; {error.remedy}" if error.remedy else error.problem


def summarised(pattern: Path) -> dict[str, Any]:
    """The record of a shot: frames that exist, frames that are missing, and sizes."""
    by_size: dict[tuple[int, int], list[int]] = {}
    for number, path in frames_of(pattern).items():
        info = describe(path)
        by_size.setdefault((info.width, info.height), []).append(number)
    numbers = sorted(number for frames in by_size.values() for number in frames)
    return {
        "pattern": str(pattern),
        "frames": numbers,
        "gaps": list(gaps(numbers)),
        "sizes": [{"size": list(size), "frames": frames} for size, frames in by_size.items()],
    }


def shot_line(told: Mapping[str, Any]) -> str:
    """The summary of a shot in words."""
    lost = f"{in_words(told['gaps'])} missing" if told["gaps"] else "no gaps"
    sizes = ["{}x{}".format(*each["size"]) for each in told["sizes"]]
    if len(sizes) > 1:
        of = (in_words(each["frames"]) for each in told["sizes"])
        sizes = [f"{size} in {frames}" for size, frames in zip(sizes, of, strict=True)]
    return f"{told['pattern']}: {in_words(told['frames'])}; {lost}; {'; '.join(sizes)}"


def range_words(depth: Mapping[str, Any]) -> str:
    """The range of a depth in words; in metres, unless the file holds radii."""
    for key, unit in (("range_m", " m"), ("range", "")):
        if depth[key]:
            return " to ".join(f"{end:.6g}{unit}" for end in depth[key])
    return "no finite depth"


# Names of channels and arrays that only one format has.
_TELLING_NAMES = {
    "unreal-mrq": ("FinalImage*WorldDepth*", "ImageDepth*"),
    "coc": ("coc",),
    "houdini": ("Pz", "*.Pz"),
    "hypersim": ("dataset",),
    "nyu-mat": ("rawDepths",),
    "vision-blender": ("depth_map",),
}


def evidence_of(path: Path, reading: DepthReading, info: FileInfo) -> Iterator[str]:
    """Sentences on the formats that a depth file could have, and why."""
    if reading.depth_format is not None:
        return
    names = [name.split(" ")[0] for name in info.names]
    for name, patterns in _TELLING_NAMES.items():
        hits = [n for n in names if any(fnmatchcase(n, pattern) for pattern in patterns)]
        if hits:
            yield f"{hits[-1]}: {name}; give ‹depth-format› {name}"
    own = own_format(path)
    if own == "android-gdepth":
        yield "GDepth in its XMP: android-gdepth; give ‹depth-format› android-gdepth"
    elif own == "apple-heic":
        yield "a depth image beside the picture: apple-heic; give ‹depth-format› apple-heic"
    elif any(name.startswith(OF_NUKE) for part in info.parts for name in part.attributes):
        yield "Nuke wrote it, whose ScanlineRender writes 1/z; give ‹depth-format› nuke-scanline"

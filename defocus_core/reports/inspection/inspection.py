"""The contents of a file and how it would be read, as ``defocus info`` finds them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.batch.jobs.output_kinds import KINDS
from defocus_core.batch.lenses.lens import Lens
from defocus_core.errors import DefocusError, InputError
from defocus_core.io.array_files import container_type
from defocus_core.io.arrays import Keeping, bands
from defocus_core.io.depth_formats.exr_depth_channel import NO_DEPTH, choose_depth
from defocus_core.io.depth_formats.reading import holds_depth
from defocus_core.io.exr.channel_choice import choose_color, require_part
from defocus_core.io.exr.deep_samples import summary
from defocus_core.io.exr.header import is_exr, read_headers
from defocus_core.io.exr.reading import read_parts
from defocus_core.io.exr.views import in_view
from defocus_core.io.exr.windows import NO_OVERSCAN
from defocus_core.io.images.describe import FileInfo, PartInfo, describe
from defocus_core.io.images.raster import choose_page
from defocus_core.io.safe_files import read_head
from defocus_core.picture.pair import InputPair
from defocus_core.picture.steps.overscan import overscan_of
from defocus_core.reports.inspection.depth_evidence import (
    evidence_of,
    is_grey_in_color,
    may_be_depth,
)
from defocus_core.reports.inspection.figures import (
    color_figures,
    depth_figures,
    ends_of,
    read_picture,
)
from defocus_core.reports.inspection.pair_evidence import evidence_of_pair
from defocus_core.system.interrupts import delayed_signals
from defocus_core.system.memory import MB

# A file with more numbers, 256 MB as floats, is read into scratch files.
_NUMBERS_IN_MEMORY = 2**26
# Most MB of samples of an interlaced PNG or a JPEG, of which a decoder may hold two copies.
_MAX_AT_ONCE = 512
_BYTES = {"uint8": 1, "uint16": 2, "half": 2, "float64": 8}


def inspect(path: Path, reading: Reading, lens: Lens | None, *, lone: bool) -> dict[str, Any]:
    """Read a file as ``defocus render`` would, and say what is in it.

    `lens`: what to say the blur of; None for none.
    """
    with delayed_signals():
        import numpy  # noqa: F401  an import that Ctrl-C interrupts fails as if by a fault

    info = describe(path)
    has_frames = container_type(read_head(path, 32)) != ""  # whose number --part is
    if reading.part is not None and not has_frames and (lone or len(info.parts) > 1):
        require_part(path, reading.part, len(info.parts))
    too_large = _too_large(info)
    color_note = too_large or _why_no_color(info, reading)
    keeping = _keeping(info)
    grey = not too_large and is_grey_in_color(info, reading, keeping)
    depth_note = too_large or _why_no_depth(info, reading, grey=grey)
    picture, color, depth, overscan = None, None, None, NO_OVERSCAN
    if not color_note and not depth_note and info.parts[0].display_window:
        overscan = overscan_of(InputPair(Picture("", path, path), reading))
    if not color_note:
        picture = read_picture(path, reading, keeping, overscan)
        color_note, color = picture.note, color_figures(picture)
    if not depth_note:
        try:
            depth_note, depth = depth_figures(path, reading, keeping, lens, picture)
        except InputError as error:
            if color is None and not has_frames:
                raise
            depth_note = _clause(error)  # a picture without depth, or arrays to choose from
    maps = [] if too_large else _maps(info, keeping)
    depth_like = ((grey or may_be_depth(info)) and not too_large) or (
        depth is not None and reading.says_scale
    )
    return {
        "file": str(path),
        "size": [info.width, info.height],
        "parts": [_part_record(part) | _samples_of(path, part) for part in info.parts],
        "color": color,
        "color_note": color_note,
        "depth": depth,
        "depth_note": depth_note,
        "evidence": [*evidence_of(path, reading, info, keeping)] if depth_like and not maps else [],
        "maps": maps,
    }


def _keeping(info: FileInfo) -> Keeping:
    return Keeping(scratch=info.numbers > _NUMBERS_IN_MEMORY)


def _too_large(info: FileInfo) -> str:
    """Why a file takes too much time or memory to decode; empty if it does not."""
    if info.nearly_empty:
        return f"not decoded: {info.nearly_empty}"
    samples = max(sum(_BYTES.get(kind, 4) for _, kind in part.channels) for part in info.parts)
    decoded = info.at_once * info.pixels * samples / MB
    if decoded <= _MAX_AT_ONCE:
        return ""
    return f"takes {decoded:.0f} MB to decode; save it as EXR, or not interlaced"


def _samples_of(path: Path, part: PartInfo) -> dict[str, Any]:
    """The samples of a deep part of an EXR in figures; nothing of others."""
    if not part.deep or part.data_window is None:
        return {}
    counts = summary(path, read_headers(path)[part.index])
    return {
        "samples": {
            "most_of_a_pixel": counts.maximum,
            "total": counts.total,
            "pixels": counts.pixels,
            "range_z": None if counts.ends is None else list(counts.ends),
        }
    }


def _part_record(part: PartInfo) -> dict[str, Any]:
    """A part of a file in plain values; windows are those of an EXR."""
    record = {
        "index": part.index,
        "name": part.name,
        "deep": part.deep,
        "channels": dict(part.channels),
        "views": list(part.views),
    }
    if part.data_window is not None and part.display_window is not None:
        record["data_window"] = list(part.data_window)
        record["display_window"] = list(part.display_window)
        record["pixel_aspect"] = part.pixel_aspect
    return record


def inspect_pairs(
    records: Sequence[Mapping[str, Any]], reading: Reading, lens: Lens | None
) -> list[dict[str, Any]]:
    """What is wrong between colour and depth, where the files inspected are those of one picture.

    That are two files of one size, of which one holds colour and the other depth, the first colour
    if both hold both; or an EXR with depth beside its colour.
    """
    from pathlib import Path

    orders = [records, records[::-1]] if len(records) == 2 else [[*records, *records]]
    resized = reading.resize_depth is not None or reading.turn_depth is not None
    pairs = [pair for pair in orders if len(pair) == 2 and _is_picture(*pair, resized=resized)]
    if not pairs:
        return []
    color, depth = (record["file"] for record in pairs[0])
    width, height = pairs[0][0]["size"]
    keeping = Keeping(scratch=4 * width * height > _NUMBERS_IN_MEMORY)
    lens_focal = None if lens is None else lens.foclen / lens.sensor_width
    try:
        evidence = evidence_of_pair(
            Path(color), Path(depth), reading, keeping=keeping, lens_focal=lens_focal
        )
    except DefocusError:  # the two cannot be read as one picture, as with --part of one of them
        return []
    return [{"color": color, "depth": depth, "evidence": list(evidence)}]


def _is_picture(color: Mapping[str, Any], depth: Mapping[str, Any], *, resized: bool) -> bool:
    """Whether two records, or one twice, are of colour and depth that could be one picture."""
    if color is depth and not color["file"].lower().endswith(".exr"):
        return False
    has_both = color["color"] is not None and depth["depth"] is not None
    fits = resized or color["size"] == depth["size"]
    if not (has_both and fits and "R" in color["color"]["channels"]):
        return False
    width, height = depth["size"]
    return bool(depth["depth"]["nothing_pixels"] != width * height)


def _why_no_color(info: FileInfo, reading: Reading) -> str:
    """Why a file has no colour to blur; empty if it has."""
    layer = reading.color_layer
    why, channels = _chosen(info, reading, partial(choose_color, layer=layer), named=layer)
    if why or channels is None:
        return why
    names = {name for name, _ in channels}
    return "" if {"R", "G", "B"} <= names or "Y" in names else "has no colour channels"


def _why_no_depth(info: FileInfo, reading: Reading, *, grey: bool) -> str:
    """Why a file has no depth, which a `grey` one may have in equal channels; empty if it has."""
    row = reading.row
    if row.rule == "radius":
        return "holds signed radii in px, which 'defocus render' takes as they are"
    if reading.depth_format is not None and (row.channels or row.plane is not None):
        return ""  # the format knows its own channels
    channel = reading.depth_channel
    why, channels = _chosen(info, reading, partial(choose_depth, channel=channel), named=channel)
    if why or channels is None:
        return why
    if reading.says_scale or holds_depth(info.path) or container_type(read_head(info.path, 32)):
        return ""  # the decoder names what is wrong
    if len(channels) != 1 and not grey:
        return f"has {len(channels)} channels, and depth is one"
    return "has 8 bits, too few for depth" if channels[0][1] == "uint8" else ""


def _chosen(
    info: FileInfo, reading: Reading, choose: Callable[..., object], *, named: str | None
) -> tuple[str, tuple[tuple[str, str], ...] | None]:
    """Why nothing of a file can be chosen, empty if something can; and the channels of its page.

    An EXR has no pages: its channels are chosen by ``choose``.
    """
    try:
        if not is_exr(read_head(info.path)):
            return "", choose_page(info.path, info.parts, reading.part).channels
        headers = in_view(info.path, read_headers(info.path), reading.view)
        choose(info.path, headers, part=reading.part)
    except InputError as error:
        if named is not None and is_exr(read_head(info.path)):
            raise
        return _clause(error), None
    return "", None


def _maps(info: FileInfo, keeping: Keeping) -> list[dict[str, Any]]:
    """The maps that ``defocus render`` wrote, and the range of their finite values."""
    is_map = any(name in NO_DEPTH for part in info.parts for name, _ in part.channels)
    if not is_map or info.path.suffix.lower() != ".exr":  # an array may be called disparity, too
        return []
    maps = []
    for part in read_parts(info.path, keeping=keeping, wanted=lambda _, name: name in NO_DEPTH):
        for kind, plane in part.channels.items():
            values = (plane[rows] for rows in bands(plane.shape))
            ends = [end for band in values for end in ends_of(band[np.isfinite(band)])]
            maps.append({"kind": kind, range_key(kind): [min(ends), max(ends)] if ends else None})
    return maps


def range_key(kind: str) -> str:
    """The key of the range of a map in a record, which names its unit."""
    unit = KINDS[kind].unit
    return f"range_{unit}" if unit else "range"


def _clause(error: InputError) -> str:
    return f"{error.problem}; {error.remedy}" if error.remedy else error.problem

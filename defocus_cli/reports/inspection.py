"""The contents of a file and how it would be read, as ``defocus info`` finds them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from defocus_cli.formats.kinds import KINDS, MAPS, Kind
from defocus_cli.jobs.job import Lens, Reading
from defocus_cli.system.arrays import Keeping, bands
from defocus_cli.system.errors import InputError
from defocus_cli.system.memory import MB

if TYPE_CHECKING:
    from pathlib import Path

    from defocus_cli.depth_formats.depth import Depth
    from defocus_cli.formats.describe import FileInfo

# A file with more numbers, 256 MB as floats, is read into scratch files.
_NUMBERS_IN_MEMORY = 2**26
# Most MB of samples of an interlaced PNG or a JPEG, of which a decoder may hold two copies.
_MOST_AT_ONCE = 512
_BYTES = {"uint8": 1, "uint16": 2, "half": 2}


@dataclass(frozen=True)
class ColorFound:
    """Colour that ``defocus render`` would take."""

    note: str
    channels: tuple[str, ...]
    nonfinite: int  # pixels that are NaN or infinite


@dataclass(frozen=True)
class DepthFound:
    """Depth that ``defocus render`` would take; ranges are None where no pixel has a depth."""

    note: str
    range_m: tuple[float, float] | None  # without sky
    sky: int
    invalid: int
    lens: Lens | None  # with the focus distance that --focus-at found
    coc_px: tuple[float, float] | None  # sky included; None without a lens
    repair: str = ""  # what would be done to it before it is rendered with the lens


@dataclass(frozen=True)
class MapFound:
    """A map that ``defocus render`` wrote."""

    kind: Kind
    range: tuple[float, float] | None  # in the unit of the kind; None where no pixel is finite


@dataclass(frozen=True)
class Inspection:
    """What is in a file; where colour or depth is missing, the note says why."""

    info: FileInfo
    color: ColorFound | None
    color_note: str
    depth: DepthFound | None
    depth_note: str
    maps: tuple[MapFound, ...] = ()
    evidence: tuple[str, ...] = ()  # formats that the depth could be of, and faults that show


def inspect(path: Path, reading: Reading, lens: Lens | None, *, lone: bool) -> Inspection:
    """Read a file as ``defocus render`` would, and say what is in it.

    Args:
        path: the file.
        reading: what to take from it.
        lens: what to say the blur of; None for none.
        lone: no other file may have the part that is asked for.

    Raises:
        InputError: the file cannot be read, or does not have what ``reading`` names.
        UsageProblem: the options make no sense for this file.
    """
    from defocus_cli.depth_formats.depth import read_depth
    from defocus_cli.formats.color import LARGEST_FLOAT, count_beyond, read_color
    from defocus_cli.formats.containers import container_type
    from defocus_cli.formats.describe import describe
    from defocus_cli.formats.exr_channels import require_part
    from defocus_cli.reports.depth_evidence import evidence_of, may_be_depth
    from defocus_cli.system.safe_files import read_head

    info = describe(path)
    has_frames = container_type(read_head(path, 32)) != ""  # whose number --part is
    if reading.part is not None and not has_frames and (lone or len(info.parts) > 1):
        require_part(path, reading.part, len(info.parts))
    channels = sum(len(part.channels) for part in info.parts)
    keeping = Keeping(scratch=info.width * info.height * channels > _NUMBERS_IN_MEMORY)
    samples = max(sum(_BYTES.get(kind, 4) for _, kind in part.channels) for part in info.parts)
    decoded = info.at_once * info.width * info.height * samples / MB
    if decoded > _MOST_AT_ONCE:
        why = f"takes {decoded:.0f} MB to decode; save it as EXR, or not interlaced"
        return Inspection(info, None, why, None, why)
    color_note = _why_no_color(info, reading)
    depth_note = _why_no_depth(info, reading)
    color = depth = None
    if not color_note:
        read = read_color(path, layer=reading.color_layer, part=reading.part, keeping=keeping)
        color = ColorFound(read.note, read.channels, count_beyond(read, LARGEST_FLOAT)[0])
    if not depth_note:
        lens_focal = None if lens is None else lens.foclen / lens.sensor_width
        try:
            values = read_depth(path, reading, keeping=keeping, lens_focal=lens_focal)
            depth = _summary(values, lens)
        except InputError as error:
            if color is None and not has_frames:
                raise
            depth_note = _clause(error)  # a picture without depth, or arrays to choose from
    maps = _maps(info, keeping)
    depth_like = may_be_depth(info) or (depth is not None and reading.says_scale)
    evidence = evidence_of(path, reading, info) if depth_like and not maps else ()
    return Inspection(info, color, color_note, depth, depth_note, maps, evidence)


def _why_no_color(info: FileInfo, reading: Reading) -> str:
    """Why a file has no colour to blur; empty if it has."""
    from defocus_cli.formats.exr_channels import choose_color

    layer = reading.color_layer
    why, channels = _chosen(info, reading, partial(choose_color, layer=layer), named=layer)
    if why or channels is None:
        return why
    names = {name for name, _ in channels}
    return "" if {"R", "G", "B"} <= names or "Y" in names else "has no colour channels"


def _why_no_depth(info: FileInfo, reading: Reading) -> str:
    """Why a file has no depth; empty if it has."""
    from defocus_cli.formats.containers import container_type
    from defocus_cli.formats.exr_channels import choose_depth
    from defocus_cli.system.safe_files import read_head

    row = reading.row
    if row.rule == "radius":
        return "holds signed radii in px, which 'defocus render' takes as they are"
    if reading.depth_format is not None and (row.channels or row.plane is not None):
        return ""  # the format knows its own channels
    channel = reading.depth_channel
    why, channels = _chosen(info, reading, partial(choose_depth, channel=channel), named=channel)
    if why or channels is None:
        return why
    if reading.says_scale or container_type(read_head(info.path, 32)):
        return ""  # who decodes it says it better
    if len(channels) != 1:
        return f"has {len(channels)} channels, and depth is one"
    return "has 8 bits, too few for depth" if channels[0][1] == "uint8" else ""


def _chosen(
    info: FileInfo, reading: Reading, choose: Callable[..., object], *, named: str | None
) -> tuple[str, tuple[tuple[str, str], ...] | None]:
    """Why nothing of a file can be chosen, empty if something can; and the channels of its page.

    An EXR has no pages: its channels are chosen by ``choose``.

    Raises:
        InputError: an EXR does not have the channels that the user has ``named``.
    """
    from defocus_cli.formats.exr_header import is_exr, read_headers
    from defocus_cli.formats.raster import choose_page
    from defocus_cli.system.safe_files import read_head

    try:
        if not is_exr(read_head(info.path)):
            return "", choose_page(info.path, info.parts, reading.part).channels
        choose(info.path, read_headers(info.path), part=reading.part)
    except InputError as error:
        if named is not None and is_exr(read_head(info.path)):
            raise
        return _clause(error), None
    return "", None


def _maps(info: FileInfo, keeping: Keeping) -> tuple[MapFound, ...]:
    from defocus_cli.formats.exr import read_parts

    is_map = any(name in MAPS for part in info.parts for name, _ in part.channels)
    if not is_map or info.path.suffix.lower() != ".exr":  # an array may be called disparity, too
        return ()
    maps = []
    for part in read_parts(info.path, keeping=keeping, wanted=lambda _, name: name in MAPS):
        maps += [MapFound(KINDS[kind], _range(plane)) for kind, plane in part.channels.items()]
    return tuple(maps)


def _range(values: Any) -> tuple[float, float] | None:
    """Least and greatest of the finite values [H, W]; None if there are none."""
    import numpy as np

    ends = []
    for rows in bands(values.shape):
        band = values[rows]
        band = band[np.isfinite(band)]
        ends += [float(band.min()), float(band.max())] if band.size else []
    return (min(ends), max(ends)) if ends else None


def _clause(error: InputError) -> str:
    return f"{error.problem}; {error.remedy}" if error.remedy else error.problem


def _summary(depth: Depth, lens: Lens | None) -> DepthFound:
    import numpy as np

    from defocus_cli.rendering import focusing

    height, width = depth.metres.shape
    sky = valid = 0
    ends: list[float] = []  # of valid depth, sky included
    finite_ends: list[float] = []
    for rows in bands((height, width)):
        metres = depth.metres[rows][depth.valid(rows)]
        finite = metres[np.isfinite(metres)]
        sky, valid = sky + metres.size - finite.size, valid + metres.size
        ends += [float(metres.min()), float(metres.max())] if metres.size else []
        finite_ends += [float(finite.min()), float(finite.max())] if finite.size else []
    coc_px, repair = None, ""
    if lens is not None and ends:
        lens = focusing.focused(lens, depth)
        # The radius grows with depth all the way: the extreme depths have the extreme radii.
        extremes = np.array([min(ends), max(ends)], np.float32)
        near, far = focusing.signed_radius(lens, extremes, (width, height))
        coc_px = (float(near), float(far))
        if valid == height * width:
            with suppress(InputError):  # too near to be rendered, as the radius shows
                repair = focusing.repair_of(lens, depth)
    return DepthFound(
        note=depth.note,
        range_m=(min(finite_ends), max(finite_ends)) if finite_ends else None,
        sky=sky,
        invalid=height * width - valid,
        lens=lens,
        coc_px=coc_px,
        repair=repair,
    )

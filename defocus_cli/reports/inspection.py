"""The contents of a file and how it would be read, as ``defocus info`` finds them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from defocus_cli.formats.kinds import KINDS, MAPS, Kind
from defocus_cli.jobs.job import Lens, Reading
from defocus_cli.system.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from defocus_cli.formats.depth import Depth
    from defocus_cli.formats.describe import FileInfo


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
    from defocus_cli.formats.color import LARGEST_FLOAT, count_beyond, read_color
    from defocus_cli.formats.depth import read_depth
    from defocus_cli.formats.describe import describe
    from defocus_cli.formats.exr_channels import require_part

    info = describe(path)
    if reading.part is not None and (lone or len(info.parts) > 1):
        require_part(path, reading.part, len(info.parts))
    color_note = _why_no_color(info, reading)
    depth_note = _why_no_depth(info, reading)
    color = depth = None
    if not color_note:
        read = read_color(path, layer=reading.color_layer, part=reading.part)
        color = ColorFound(read.note, read.channels, count_beyond(read, LARGEST_FLOAT)[0])
    if not depth_note:
        channel, unit = reading.depth_channel, reading.depth_unit
        depth = _summary(read_depth(path, channel=channel, part=reading.part, unit=unit), lens)
    return Inspection(info, color, color_note, depth, depth_note, _maps(info))


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
    from defocus_cli.formats.exr_channels import choose_depth

    channel = reading.depth_channel
    why, channels = _chosen(info, reading, partial(choose_depth, channel=channel), named=channel)
    if why or channels is None:
        return why
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


def _maps(info: FileInfo) -> tuple[MapFound, ...]:
    from defocus_cli.formats.exr import read_parts

    if not any(name in MAPS for part in info.parts for name, _ in part.channels):
        return ()
    maps = []
    for part in read_parts(info.path):
        for kind in [name for name in MAPS if name in part.channels]:
            maps.append(MapFound(KINDS[kind], _range(part.channels[kind])))
    return tuple(maps)


def _range(values: NDArray[Any]) -> tuple[float, float] | None:
    """Least and greatest of the finite values; None if there are none."""
    import numpy as np

    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else None


def _clause(error: InputError) -> str:
    return f"{error.problem}; {error.remedy}" if error.remedy else error.problem


def _summary(depth: Depth, lens: Lens | None) -> DepthFound:
    import numpy as np

    from defocus_cli.rendering import focusing

    valid = depth.metres[~depth.invalid]
    coc_px, repair = None, ""
    if lens is not None and valid.size:
        lens = focusing.focused(lens, depth)
        height, width = depth.metres.shape
        # The radius grows with depth all the way: the extreme depths have the extreme radii.
        extremes = np.array([valid.min(), valid.max()])
        near, far = focusing.signed_radius(lens, extremes, (width, height))
        coc_px = (float(near), float(far))
        if not depth.invalid.any():
            with suppress(InputError):  # too near to be rendered, as the radius shows
                repair = focusing.repair_of(lens, depth)
    return DepthFound(
        note=depth.note,
        range_m=_range(valid),
        sky=int(np.isinf(valid).sum()),
        invalid=int(depth.invalid.sum()),
        lens=lens,
        coc_px=coc_px,
        repair=repair,
    )

"""The table of reading options, whose texts become fields of `Reading`.

The command line, jobs files and lens files have them under one name. ``radial`` and ``planar`` are
flags, and set the field ``geometry``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from defocus_core.allowed_values import DEPTH_REPAIRS, WIDEST_EDGE
from defocus_core.io.depth_formats.reading import INVALID, KINDS, RESIZES, UNPREMULTIPLY
from defocus_core.io.depth_formats.table import NAMES, UNITS
from defocus_core.request.parameters import Param
from defocus_core.request.quantities import (
    QuantityError,
    always,
    angle,
    length,
    number,
    one_of,
    pixel_count,
    short,
    whole,
)

_FRACTION = re.compile(r"\s*([\d.e+-]+)\s*/\s*([\d.e+-]+)\s*", re.I)


def format_name(text: str) -> str:
    """The name of a depth format, or one of its aliases; the nearest are named for any other."""
    from difflib import get_close_matches

    name = text.lower()
    if name in NAMES:
        return name
    near = get_close_matches(name, NAMES, n=3, cutoff=0.5)
    near = list(dict.fromkeys([*(n for n in NAMES if name in n or n in name), *near]))[:4]
    nearest = f"did you mean {' or '.join(near)}? " if near else ""
    remedy = f"{nearest}'defocus help depth' lists all of them"
    raise QuantityError(f"'{text}' is not a depth format", remedy)


def scale(text: str) -> float:
    """A factor, from ``0.001``, ``1/256`` or ``-1``."""
    fraction = _FRACTION.fullmatch(short(text))
    if fraction:
        above, below = scale(fraction[1]), scale(fraction[2])
        return above / below
    value = number(text)
    if not 0 < abs(value) < math.inf:
        raise QuantityError(f"'{text}' is 0 or not finite", "write it like 0.001 or 1/256")
    return value


def distance(text: str) -> float:
    """A positive length in mm, from ``2m`` or ``193mm``; a number alone is in metres."""
    try:
        metres = float(text)
    except ValueError:
        return length(text)
    return length(f"{text.strip()}m") if math.isfinite(metres) else length(text)


def far_distance(text: str) -> float:
    """As `distance`, or ``inf``."""
    return math.inf if text.strip().lower() in ("inf", "infinity") else distance(text)


def distances(text: str) -> tuple[float, float]:
    """Two distances in mm, from ``2m 50m``, of which one may be inf."""
    words = text.replace(",", " ").split()
    if len(words) != 2:
        raise QuantityError(f"'{text}' is not two distances", "write them like 2m 50m")
    first, second = map(far_distance, words)
    return first, second


def field_of_view(text: str) -> float:
    """A horizontal field of view in degrees."""
    degrees = angle(text)
    if not 0 < degrees < 180:
        raise QuantityError(
            f"'{text}' is not a field of view", "give more than 0 and less than 180"
        )
    return degrees


def edge_width(text: str) -> float:
    """A width in the picture, from ``8px`` or ``8``; 0 for hard edges."""
    px = 0.0 if re.fullmatch(r"\s*0+(\.0*)?\s*(px)?\s*", short(text), re.I) else pixel_count(text)
    if px > WIDEST_EDGE:
        raise QuantityError(f"{px:g} px is a surface, and no edge", f"give {WIDEST_EDGE}px or less")
    return px


def words(text: str) -> tuple[str, ...]:
    """Words separated by commas or blanks, each once."""
    names = tuple(dict.fromkeys(text.replace(",", " ").split()))
    if not names:
        raise QuantityError(f"'{text}' names nothing", "write it like diffuse.*,specular.*")
    return names


@dataclass(frozen=True, kw_only=True)
class ReadingParam(Param):
    """An option of reading."""

    heading: str = "Files"
    of_pictures: bool = False  # a depth file alone, without a picture and a lens, has no use for it
    of_render: bool = False  # what is not written has no use for it


def _choice(
    name: str,
    choices: Sequence[str],
    text: str,
    *,
    of_pictures: bool = False,
    is_common: bool = False,
) -> ReadingParam:
    return ReadingParam(
        name=name,
        parse=one_of(choices),
        choices=choices,
        help=text,
        of_pictures=of_pictures,
        is_common=is_common,
    )


_ROWS = (
    ReadingParam(
        name="depth-format",
        is_common=True,
        parse=format_name,
        metavar="NAME",
        help="Who wrote the depth, like kitti: 'defocus help depth' lists all.",
    ),
    _choice(
        "depth-unit",
        tuple(UNITS),
        "Unit of the depth.  [default: m; mm in 16-bit PNG]",
        is_common=True,
    ),
    ReadingParam(
        name="depth-scale",
        parse=scale,
        metavar="FACTOR",
        help="Multiplies the numbers of the depth file, like 1/256.",
    ),
    _choice("depth-kind", KINDS, "What the numbers are.  [default: depth]", is_common=True),
    ReadingParam(
        name="depth-range",
        is_common=True,
        parse=distances,
        words=2,
        metavar="NEAR FAR",
        help="Distances of the ends of the number's type, 0 and 255 or 65535, or 0 and 1: of depth "
        "0 is NEAR; of disparity 0 is FAR. Swapped, it is the other way round.",
        unit="mm",
        separator=" ",
    ),
    ReadingParam(
        name="focal-px",
        parse=pixel_count,
        metavar="PX",
        help="Focal length in px, for disparity and for ‹radial›.",
    ),
    ReadingParam(
        name="baseline",
        parse=distance,
        metavar="LENGTH",
        help="Distance between the two cameras of disparity, like 65mm.",
        unit="mm",
    ),
    ReadingParam(
        name="doffs",
        parse=number,
        metavar="PX",
        help="Added to disparity: the difference of the two principal points.",
    ),
    ReadingParam(
        name="radial",
        stored_as="geometry",
        flag=True,
        parse=always("radial"),
        help="The numbers are distances to the point.",
    ),
    ReadingParam(
        name="planar",
        stored_as="geometry",
        flag=True,
        parse=always("planar"),
        help="The numbers are depth along the axis.",
        instead_of="radial",
    ),
    ReadingParam(
        name="invert",
        is_common=True,
        flag=True,
        parse=always("invert"),
        help="Black is near in a depth of relative disparity; with ‹blur›.",
        of_pictures=True,
    ),
    ReadingParam(
        name="fov",
        parse=field_of_view,
        metavar="DEG",
        help="Horizontal field of view, for ‹radial›.  [default: the lens's]",
    ),
    ReadingParam(
        name="sky",
        parse=number,
        metavar="NUMBER",
        help="Numbers of the depth file from this one on are sky; of disparity, to it.",
    ),
    _choice(
        "invalid",
        INVALID,
        "Pixels without depth: an error, infinitely far, or filled from the farther neighbour.  "
        "[default: error]",
    ),
    _choice(
        "resize-depth",
        RESIZES,
        "Take depth of another size than the colour: from the nearest pixel, or with edges where "
        "the colours change.  [default: guided, of smaller depth of the same aspect]",
        of_pictures=True,
    ),
    ReadingParam(
        name="turn-depth",
        flag=True,
        parse=always("turn-depth"),
        help="The depth file is stored as its photograph is: turn it by the Exif orientation of "
        "that.",
        of_pictures=True,
    ),
    _choice(
        "depth-repair",
        DEPTH_REPAIRS,
        "auto repairs depth that is noisy, anti-aliased, soft at edges or of few levels; off "
        "takes it as it is given.  [default: auto]",
        of_pictures=True,
    ),
    ReadingParam(
        name="edge-width",
        parse=edge_width,
        metavar="PX",
        help="Width of the widest soft edges of the depth, like 8px; 0 says that edges are hard.  "
        "[default: as found]",
        of_pictures=True,
    ),
    ReadingParam(
        name="depth-channel",
        metavar="NAME",
        help="Depth channel of an EXR, or array of an NPZ or HDF5.",
    ),
    ReadingParam(
        name="color-layer",
        metavar="NAME",
        help="Colour layer of an EXR.",
        of_pictures=True,
    ),
    ReadingParam(
        name="blur-channels",
        parse=words,
        metavar="NAME,…",
        help="Further channels of an EXR that are light, like diffuse.*: blurred with the picture; "
        "the others are copied.",
        separator=",",
        of_pictures=True,
        of_render=True,
    ),
    ReadingParam(
        name="part",
        parse=whole,
        metavar="N",
        help="Part of an EXR, page of a TIFF or frame of an array, from 0.",
    ),
    ReadingParam(
        name="view",
        metavar="NAME",
        help="View of an EXR of several cameras, like left; in ‹render› several, like left,right.  "
        "[default: the file's first]",
    ),
    _choice(
        "unpremultiply-depth",
        UNPREMULTIPLY,
        "Divide depth by alpha: on, off, or auto, if pixels of half alpha show that it was "
        "multiplied.  [default: auto]",
        of_pictures=True,
    ),
)
READING_OPTIONS: Mapping[str, ReadingParam] = {row.name: row for row in _ROWS}

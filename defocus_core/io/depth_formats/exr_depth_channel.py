"""The depth channel of an EXR file, found by the names of its format or by usual names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from defocus_core.errors import InputError
from defocus_core.io.depth_formats.reading import DepthNumbers, DepthReading, Mark, require_size
from defocus_core.io.exr.channel_choice import (
    ChannelGroup,
    by_name,
    channels_of,
    in_view,
    in_words,
    labels,
    last_word,
    only_one,
    quoted,
)
from defocus_core.io.exr.header import Header, read_headers
from defocus_core.io.exr.reading import read_parts
from defocus_core.io.exr.windows import Overscan

_DEPTH_NAMES = frozenset({"depth", "zdepth"})  # of channels, whatever their layer
_DEPTH_LAYERS = ("depth", "zdepth", "worlddepth")  # ends of names of layers
NO_DEPTH = ("coc", "disparity", "trust")  # channels of maps that defocus writes


class NoDepthChannel(InputError):  # noqa: N818 - it says what the file lacks
    """None of the channels of a file is known to be depth."""


def exr_depth_numbers(
    path: Path, reading: DepthReading, size: tuple[int, int] | None, overscan: Overscan
) -> DepthNumbers:
    """Read the depth channel of an EXR file.

    `size`: (width, height) in px of its colour, or None; `overscan`: the pixels beyond the display
    window to read.
    """
    headers = in_view(path, read_headers(path), reading.view)
    chosen = choose_depth_channel(path, headers, reading)
    header = chosen.header
    require_size(path, reading, (header.display.height, header.display.width), size)
    names = {channel.plain: channel.name for channel in header.channels}
    beside = (f"{chosen.name.rpartition('.')[0]}.A", "A") if reading.row.alpha else ()
    alpha = next((names[name] for name in beside if name in names), None)

    def wanted(other: Header, name: str) -> bool:
        return other.index == header.index and name in (alpha, *chosen.channels.values())

    parts = read_parts(path, headers, wanted, overscan)
    pixels, *others = (parts[header.index].channels[n] for n in chosen.channels.values())
    if not all(np.array_equal(pixels, one) for one in others):
        problem = f"has no depth channel, only {in_words([*chosen.channels])}"
        remedy = "if one of them is the depth, give ‹depth-channel› NAME"
        raise NoDepthChannel("no-depth", problem, remedy, path=path)
    kind = {"float16": "half", "float32": "float"}.get(pixels.dtype.name, pixels.dtype.name)
    place = f" of part {header.label}" if len(headers) > 1 else ""
    view = f" in view {header.shown}" if header.shown else ""
    words = (f"EXR {kind} channel {chosen.name}{place}{view}", header.cut_note(overscan))
    window = header.display.grown(overscan)
    outside = np.ones((window.height, window.width), bool)
    outside[window.cut(header.data)] = False
    marks = [Mark(outside, np.nan, "")] * bool(outside.any())
    if alpha is not None:
        empty = parts[header.index].channels[alpha][:] == 0
        marks.append(Mark(empty, np.inf, "sky where alpha is 0"))
    return DepthNumbers(
        path,
        pixels,
        "integer EXR" if pixels.dtype.kind in "iu" else "EXR",
        ", ".join(filter(None, words)),
        channel=chosen.name,
        marks=tuple(marks),
        data_window="" if header.data.covers(window) else str(header.data),
        metadata=header.attributes,
        is_deep=header.deep,
    )


def choose_depth_channel(
    path: Path, headers: Sequence[Header], reading: DepthReading
) -> ChannelGroup:
    """The depth channel of a file: the one named, that of the format, or one with a usual name.

    In a file with only R, G, B and perhaps A the depth is R; the group then lists G and B, too,
    which must equal R.
    """
    channel = reading.depth_channel
    every = channels_of(path, headers, reading.part)
    if channel is not None:
        return by_name(path, every, channel, "channel", "‹depth-channel›")
    for pattern in reading.row.channels:
        for each in every:
            if fnmatchcase(each.name, pattern):
                return each
    named = [c for c in every if _is_depth(c)]
    lone = [c for c in every if len(every) == 1 and c.name not in NO_DEPTH]
    zs = [c for c in every if last_word(c.name).lower() == "z" and not _is_of_vector(c)]
    candidates = named or lone or zs
    layers = [last_word(c.name.rpartition(".")[0]).lower() for c in candidates]
    if len(candidates) > 1:  # "Denoising Depth" beside "Depth"
        pairs = zip(candidates, layers, strict=True)
        candidates = [c for c, of in pairs if " " not in of or of.rpartition(" ")[2] not in layers]
    # Multi-part files may name only the part: "ViewLayer.Depth" beside "ViewLayer.Mist".
    in_depth_part = [c for c in candidates if last_word(c.header.name).lower() == "depth"]
    candidates = in_depth_part if len(in_depth_part) == 1 else candidates
    colors = {each.name: each.source for each in every}
    if not candidates and set("RGB") <= colors.keys() <= set("RGBA"):
        return ChannelGroup(every[0].header, "R", {name: colors[name] for name in "RGB"})
    if not candidates:
        problem = f"has no depth channel, only {in_words(labels(every))}"
        likely = (
            name
            for name, c in zip(labels(every), every, strict=True)
            if re.search(r"depth|dist|mist|(^|[._])p?z", c.name.lower()) and not _is_of_vector(c)
        )
        remedy = f"if one of them is the depth, give ‹depth-channel› {quoted(next(likely, 'NAME'))}"
        raise NoDepthChannel("no-depth", problem, remedy, path=path)
    return only_one(path, candidates, "depth channel", "‹depth-channel›")


def _is_depth(candidate: ChannelGroup) -> bool:
    """Whether a channel is depth by its name, like Z or depth, or by the name of its layer."""
    layer, _, base = candidate.name.rpartition(".")
    base, own_layer = base.lower(), last_word(layer).lower()
    siblings = candidate.header.folded_names
    dot = f"{layer}.".lower() if layer else ""
    if base in _DEPTH_NAMES:
        return True
    if base == "pz":  # a position has px and py, too
        return f"{dot}px" not in siblings
    if own_layer.endswith(_DEPTH_LAYERS):  # its G and B, if there are any, repeat R
        return base in ("r", "x", "y", "z", "v") and (base == "r" or f"{dot}r" not in siblings)
    if base not in {"z", "v"} or (layer and own_layer not in ("depth", "z")):
        return False
    return not _is_of_vector(candidate)


def _is_of_vector(candidate: ChannelGroup) -> bool:
    layer, siblings = candidate.name.rpartition(".")[0].lower(), candidate.header.folded_names
    dot = f"{layer}." if layer else ""
    return {f"{dot}x", f"{dot}y", f"{dot}z"} <= siblings or {f"{dot}u", f"{dot}v"} <= siblings

"""Views and colour layers of an EXR file, found by name, and the naming of channels.

OpenEXR names channels ``LAYER.CHANNEL``; files may also hold layers in separate parts with names. A
name that the user gives is compared exactly, then without regard to case. Nothing is guessed:
several candidates are an error, which lists them in the form that the option takes.

A file may hold views, the pictures of several cameras, like left and right. A view is named by the
attribute ``view`` of a part, or by ``multiView`` and the second last word of a channel: ``left.R``,
``diffuse.left.R`` (OpenEXR, "Storing Multi-View Images"). The first view is the default one; its
channels without a layer have no view in their names.
"""

from __future__ import annotations

import re
import shlex
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from defocus_core.errors import InputError
from defocus_core.io.exr.header import Channel, Header, is_exr, read_headers
from defocus_core.io.read_files import read_head

# Long names of colour channels, and names of the layer with the whole picture, not a render pass.
_LONG_NAMES = {"RED": "R", "GREEN": "G", "BLUE": "B", "ALPHA": "A"}
_WHOLE_PICTURE = frozenset({"combined", "rgba", "beauty"})
_SHOWN = 40  # names in a message
_ASPECTS = 0.1, 10.0  # least and greatest width of a pixel divided by its height


@dataclass(frozen=True)
class ChannelGroup:
    """Channels of a part that the user chooses by one name: a colour layer, or a depth channel."""

    header: Header  # the part that holds the channels
    name: str  # the name that ``layer`` or ``depth_channel`` takes, without the part
    # Names in the file: of a colour layer by R, G, B or Y, and A; of a depth channel by its name
    # without the view
    channels: Mapping[str, str] = field(default_factory=dict)
    default: bool = False  # whether it is the part's colour layer of channels without a layer name

    @property
    def source(self) -> str:
        """The name in the file of the first channel of the group."""
        return next(iter(self.channels.values()))


def choose_color(
    path: Path, headers: Sequence[Header], *, layer: str | None, part: int | None
) -> ChannelGroup:
    """The colour layer of a file; ``layer`` and ``part`` are as for `images.color.read_color`.

    Without either, the default layer (R, G, B without a layer name) is preferred to named ones, as
    in every viewer. An InputError is raised unless one candidate is left.
    """
    layers = [each for header in _searched(path, headers, part) for each in _color_layers(header)]
    minimum, maximum = _ASPECTS
    for aspect in (each.header.pixel_aspect for each in layers):
        if not minimum <= aspect <= maximum:
            problem = f"has pixels {aspect:g} times as wide as high"
            remedy = f"resample it to pixels of {minimum:g} to {maximum:g} times"
            raise InputError("unsupported", problem, remedy, path=path)
    if layer is not None:
        return by_name(path, layers, layer, "colour layer", "‹color-layer›")
    candidates = [each for each in layers if "R" in each.channels] or layers
    words = [re.split(r"[._\- ]", f"{c.header.name}.{c.name}".lower()) for c in candidates]
    for known in (
        [c for c in candidates if c.default],
        [c for c, of in zip(candidates, words, strict=True) if not _WHOLE_PICTURE.isdisjoint(of)],
    ):
        if len(known) == 1:
            return known[0]
    if not candidates:
        every = in_words(labels(channels_of(path, headers, part)))
        problem = f"has no colour channels (R, G, B or Y), only {every}"
        raise InputError("no-color", problem, "name a file that has them", path=path)
    return only_one(path, candidates, "colour layer", "‹color-layer›")


def channels_of(path: Path, headers: Sequence[Header], part: int | None) -> list[ChannelGroup]:
    """All channels of a file, or of the part with the index `part`, in the order of the file."""
    return [
        ChannelGroup(header, channel.plain, {channel.plain: channel.name})
        for header in _searched(path, headers, part)
        for channel in header.channels
    ]


def light_passes(path: Path, extras: Mapping[str, Any], patterns: Sequence[str]) -> tuple[str, ...]:
    """The names of channels besides the colour that match `patterns`, in the order of the file.

    Channels of depth or whole numbers do not match, as they are never averaged. `extras`: arrays
    [H, W] by name. A pattern without a match is an InputError.
    """
    light = [n for n, plane in extras.items() if plane.dtype.kind not in "iu" and not is_depth(n)]
    chosen: set[str] = set()
    for pattern in patterns:
        named = {n for n in extras if fnmatchcase(n.casefold(), pattern.casefold())}
        if named.isdisjoint(light):
            problem = f"has no channel {pattern} of light beside its colour"
            if named:
                problem = f"has {pattern}, which is depth or whole numbers and is never averaged"
            known = f"it has {in_words(light)}" if light else "it has none"
            remedy = f"check ‹blur-channels›: {known}"
            raise InputError("no-such-channel", problem, remedy, path=path)
        chosen |= named
    return tuple(name for name in light if name in chosen)


def require_part(path: Path, part: int, count: int) -> None:
    """Refuse the index of a part that a file with ``count`` parts does not have."""
    if not 0 <= part < count:
        problem = f"has no part {part}, only {count}"
        remedy = "leave ‹part› out" if count == 1 else f"‹part› counts from 0 to {count - 1}"
        raise InputError("no-such-part", problem, remedy, path=path)


def _searched(path: Path, headers: Sequence[Header], part: int | None) -> Sequence[Header]:
    """The parts to search: that of index `part`, or else the flat parts, or all if none is flat."""
    # One option serves the colour and the depth file: it is ignored for a file of a single part.
    if part is not None and len(headers) > 1:
        require_part(path, part, len(headers))
        headers = headers[part : part + 1]
    return [header for header in headers if not header.deep] or headers


def _color_layers(header: Header) -> Iterable[ChannelGroup]:
    layers: dict[str, list[Channel]] = defaultdict(list)
    for channel in header.channels:
        layers[channel.plain.rpartition(".")[0]].append(channel)
    for prefix, members in layers.items():
        bases: dict[str, str] = {}
        for fold in (lambda base: _LONG_NAMES.get(base.upper(), ""), str.upper, str):
            bases |= {fold(last_word(channel.plain)): channel.name for channel in members}
        if {"R", "G", "B"} <= bases.keys():
            wanted = ["R", "G", "B", "A"]
        elif "Y" in bases and not bases.keys() & {"X", "RY", "BY"}:  # no vector, no lone chroma
            wanted = ["Y", "A"]
        else:
            continue
        channels = {c: bases[c] for c in wanted if c in bases}
        name = prefix or "".join(channels).removesuffix("A")
        yield ChannelGroup(header, name, channels, default=not prefix)


def by_name(
    path: Path, groups: Sequence[ChannelGroup], wanted: str, kind: str, option: str
) -> ChannelGroup:
    """The only group with the name ``wanted``; an InputError if there is not exactly one.

    `kind` and `option` are texts for errors: what is looked for, and the option that chooses it.
    """
    exact = [c for c in groups if wanted in _names(c)]
    folded = wanted.casefold()
    matches = exact or [c for c in groups if folded in {n.casefold() for n in _names(c)}]
    if not matches:  # the name of a layer with one channel stands for the channel
        members = [c for c in groups if c.name.rpartition(".")[0].casefold() == folded]
        matches = members if len(members) == 1 else []
    if not matches:
        known = in_words(labels(groups)) or "none"
        problem = f"has no {kind} {wanted}; it has {known}"
        raise InputError("no-such-channel", problem, f"check {option}", path=path)
    return only_one(path, matches, kind, option)


def _names(candidate: ChannelGroup) -> set[str]:
    """All names by which a user may choose the candidate."""
    header, name = candidate.header, candidate.name
    names = {name, f"{header.index}/{name}", f"{header.label}/{name}"}
    if candidate.default and header.name:
        names.add(header.name)
    return names


def labels(candidates: Sequence[ChannelGroup]) -> list[str]:
    """Names by which the candidates can be chosen, as PART/NAME if they are in several parts."""
    parts = {candidate.header.index for candidate in candidates}
    if len(parts) < 2:
        return [candidate.name for candidate in candidates]
    of_parts = [f"{c.header.label}/{c.name}" for c in candidates]
    if len(set(of_parts)) == len(of_parts):
        return of_parts
    return [f"{c.header.index}/{c.name}" for c in candidates]


def only_one(
    path: Path, candidates: Sequence[ChannelGroup], kind: str, option: str
) -> ChannelGroup:
    """The only candidate; an InputError if there are several; `kind`, `option`: as in `by_name`."""
    if len(candidates) == 1:
        return candidates[0]
    names = labels(candidates)
    problem = f"has {len(candidates)} candidates for the {kind}: {in_words(names)}"
    remedy = f"choose one, like {option} {quoted(names[0])}, or a part with ‹part›"
    raise InputError("ambiguous", problem, remedy, path=path)


def quoted(name: str) -> str:
    """A name quoted for a shell."""
    return shlex.quote(name) if name.isprintable() else name


def in_words(names: Sequence[str]) -> str:
    """Names joined for a message; of more than 40 names only the first 40."""
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def is_depth(name: str) -> bool:
    """Whether the name of a channel says that it holds distances: Z, ZBack or depth."""
    return last_word(name).lower() in ("z", "zback", "depth")


def last_word(name: str) -> str:
    """The name of a channel without its layers: the text after the last dot."""
    return name.rpartition(".")[2]


def views_of(headers: Sequence[Header]) -> tuple[str, ...]:
    """The names of the views of a file, the default one first; empty if it has no named views."""
    if len(headers) == 1 and headers[0].multi_view:
        return tuple(dict.fromkeys(headers[0].multi_view))
    return tuple(dict.fromkeys(header.view for header in headers if header.view))


def in_view(path: Path, headers: Sequence[Header], view: str | None) -> tuple[Header, ...]:
    """The headers, restricted to the channels of one view and those of no view.

    `view`: the name of the view, or None for the default one. The `plain` names of the channels
    lose the name of the view.
    """
    views = views_of(headers)
    if not views or (view is None and len(views) == 1):
        return tuple(headers)
    known = {name.casefold(): name for name in views}
    if view is not None and view.casefold() not in known:
        problem = f"has no view {view}; it has {', '.join(views)}"
        raise InputError("no-such-view", problem, "check ‹view›", path=path)
    chosen = views[0] if view is None else known[view.casefold()]
    return tuple(_restrict(header, views, chosen) for header in headers)


def require_view(paths: Sequence[Path], view: str | None) -> None:
    """Refuse a named view if none of the files has views."""
    if view is None:
        return
    exrs = [path for path in paths if is_exr(read_head(path))]
    if not any(views_of(read_headers(path)) for path in exrs):
        problem = f"has no views, and so no view {view}"
        raise InputError("no-such-view", problem, "leave ‹view› out", path=paths[0])


def default_warning(headers: Sequence[Header], view: str | None) -> tuple[str, ...]:
    """A tuple with a warning if a file has several views but `view` is None; else empty."""
    views = views_of(headers)
    if view is not None or len(views) < 2:
        return ()
    return (f"view {views[0]} taken, the default of {', '.join(views)}; ‹view› names another",)


def name_in_view(name: str, view: str) -> str:
    """The name of a channel with the view inserted before its last word, as ``diffuse.left.R``.

    The default view is not written in names.
    """
    layer, _, base = name.rpartition(".")
    return ".".join(filter(None, (layer, view, base)))


def _restrict(header: Header, views: Sequence[str], chosen: str) -> Header:
    """The header of a part with only the channels of the view `chosen` and those of no view."""
    if header.view in views:
        channels = header.channels if header.view == chosen else ()
        return replace(header, channels=channels, shown=chosen)
    restricted = []
    for channel in header.channels:
        words, view, plain = channel.name.split("."), "", channel.name
        if len(words) == 1 and header.multi_view:
            view = views[0]
        elif len(words) > 1 and words[-2] in views:
            view, plain = words[-2], ".".join([*words[:-2], words[-1]])
        if view in ("", chosen):
            restricted.append(Channel(channel.name, channel.type, plain))
    # Channels of the view replace those of no view with the same plain name.
    own = {channel.plain for channel in restricted if channel.plain != channel.name}
    kept = tuple(c for c in restricted if c.plain != c.name or c.plain not in own)
    return replace(header, channels=kept, shown=chosen)

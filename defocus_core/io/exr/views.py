"""Views of an OpenEXR file: the pictures of several cameras, like left and right.

A view is named by the attribute ``view`` of a part, or by ``multiView`` and the last but one word
of a channel: ``left.R``, ``diffuse.left.R`` (OpenEXR, "Storing Multi-View Images"). The first view
is the default one; its plain channels have no view in their names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from defocus_core.errors import InputError
from defocus_core.io.exr.header import Channel, Header, is_exr, read_headers
from defocus_core.io.safe_files import read_head


def views_of(headers: Sequence[Header]) -> tuple[str, ...]:
    """The views of a file, the default one first; none of a file of one picture."""
    if len(headers) == 1 and headers[0].multi_view:
        return tuple(dict.fromkeys(headers[0].multi_view))
    return tuple(dict.fromkeys(header.view for header in headers if header.view))


def in_view(path: Path, headers: Sequence[Header], view: str | None) -> tuple[Header, ...]:
    """The headers of a file with the channels of one view, and of none; their names without it.

    `view`: the name of the view; None for the default one.
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
    """Refuse the name of a view for files of which none has views."""
    if view is None:
        return
    exrs = [path for path in paths if is_exr(read_head(path))]
    if not any(views_of(read_headers(path)) for path in exrs):
        problem = f"has no views, and so no view {view}"
        raise InputError("no-such-view", problem, "leave ‹view› out", path=paths[0])


def default_warning(headers: Sequence[Header], view: str | None) -> str:
    """What is said of a file of several views of which none was asked for; else empty."""
    views = views_of(headers)
    if view is not None or len(views) < 2:
        return ""
    return f"view {views[0]} taken, the default of {', '.join(views)}; ‹view› names another"


def name_in_view(name: str, view: str) -> str:
    """The name of a channel in a view that is not the default one."""
    layer, _, base = name.rpartition(".")
    return ".".join(filter(None, (layer, view, base)))


def _restrict(header: Header, views: Sequence[str], chosen: str) -> Header:
    """A part with the channels of a view and those of none."""
    if header.view in views:
        channels = header.channels if header.view == chosen else ()
        return replace(header, channels=channels, shown=chosen)
    restricted = []
    for channel in header.channels:
        view, plain = _split(channel, header, views)
        if view in ("", chosen):
            restricted.append(Channel(channel.name, channel.type, plain))
    # Channels of the view stand for those of no view with the same plain name.
    own = {channel.plain for channel in restricted if channel.plain != channel.name}
    kept = tuple(c for c in restricted if c.plain != c.name or c.plain not in own)
    return replace(header, channels=kept, shown=chosen)


def _split(channel: Channel, header: Header, views: Sequence[str]) -> tuple[str, str]:
    """The view of a channel, empty if it is of none, and its name without it."""
    words = channel.name.split(".")
    if len(words) == 1 and header.multi_view:
        return views[0], channel.name
    if len(words) > 1 and words[-2] in views:
        return words[-2], ".".join([*words[:-2], words[-1]])
    return "", channel.name

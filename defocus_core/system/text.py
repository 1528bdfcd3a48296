"""Counts and durations in words, and the version."""

from __future__ import annotations

from functools import cache
from importlib import metadata


@cache
def version() -> str:
    """The version of the installed package."""
    try:
        return metadata.version("defocus")
    except metadata.PackageNotFoundError:
        return "unknown"


def counted(count: int, one: str, several: str = "") -> str:
    """A number of things: ``1 job``, ``2 jobs``."""
    return f"{count} {one if count == 1 else several or f'{one}s'}"


def percent(share: float) -> str:
    """A share of all, like ``0.25 %`` or ``100 %``."""
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def duration(seconds: float) -> str:
    """Like ``0.3 s``, ``12 s``, ``3 min 20 s`` or ``2 h 5 min``."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"

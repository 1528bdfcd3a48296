"""Texts for people: notes while the library works, counts, durations, commands to copy."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from importlib import metadata
from logging import getLogger
from pathlib import Path

from defocus_core.renderer_version import RENDERER_VERSION


@cache
def version() -> str:
    """The version of the installed package."""
    try:
        return metadata.version("defocus")
    except metadata.PackageNotFoundError:
        return "unknown"


def versions() -> str:
    """The versions that a picture depends on, like ``0.2.0, renderer 14``."""
    return f"{version()}, renderer {RENDERER_VERSION}"


@cache
def software() -> str:
    """The libraries with their versions and the CPU, on which the last digits of results depend."""
    found = []
    for name in ("torch", "numpy", "numba"):
        with suppress(metadata.PackageNotFoundError):
            found.append(f"{name} {metadata.version(name)}")
    return ", ".join([*found, f"CPU {_cpu()}"])


def _cpu() -> str:
    """The name of the CPU, or without Numba its instruction set, and ATEN_CPU_CAPABILITY if set.

    torch is imported only without Numba, as then it renders anyway.
    """
    try:
        from llvmlite import binding  # type: ignore[import-untyped]

        name: str = binding.get_host_cpu_name()
    except ImportError:
        import torch

        return torch.backends.cpu.get_cpu_capability()
    told = os.environ.get("ATEN_CPU_CAPABILITY")
    return f"{name} {told}" if told else name


def back_words() -> str:
    """The back that renders on the CPU here, in words like ``compiled by Numba 0.68.1``."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
        return "by torch, as NUMBA_DISABLE_JIT is set"
    try:
        return f"compiled by Numba {metadata.version('numba')}"
    except metadata.PackageNotFoundError:
        return "by torch, as Numba is not installed"


def counted(count: int, one: str) -> str:
    """A count with its noun, which gets an s in the plural, like ``1 job``, ``2 jobs``."""
    return f"{count} {one}" if count == 1 else f"{count} {one}s"


def times(shape: Iterable[int]) -> str:
    """The lengths of an array's axes in words, like ``2 × 3``; ``no`` if it has no axis."""
    return " × ".join(map(str, shape)) or "no"


_LOGGER = getLogger("defocus_core")


def note(line: str) -> None:
    """Log a line for the user as a warning, which goes to stderr if no log handler is set."""
    _LOGGER.warning("%s", line)


def command_line(words: Iterable[object]) -> str:
    """Words joined to a command line, quoted for a POSIX shell like bash or zsh."""
    return " ".join(map(_word, words))


def _word(word: object) -> str:
    text = str(word)
    if text.isprintable():
        return shlex.quote(text)
    # Line breaks, escapes and bytes that are not UTF-8 are written as in $'…'.
    codes = os.fsencode(text) if isinstance(word, Path) else text.encode("utf-8", "surrogateescape")
    return "$'" + "".join(map(_code, codes)) + "'"


def _code(byte: int) -> str:
    char = chr(byte)
    plain = byte < 0x7F and char.isprintable() and char not in "'\\"
    return char if plain else f"\\x{byte:02x}"

"""Command lines to copy into a shell."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable
from pathlib import Path


def command_line(words: Iterable[object]) -> str:
    """The words as a POSIX shell, like bash or zsh, reads them."""
    return " ".join(map(_word, words))


def _word(word: object) -> str:
    text = str(word)
    if text.isprintable():
        return shlex.quote(text)
    # Line breaks, escapes, bytes that are no UTF-8: as $'…' has them.
    codes = os.fsencode(text) if isinstance(word, Path) else text.encode("utf-8", "surrogateescape")
    return "$'" + "".join(map(_code, codes)) + "'"


def _code(byte: int) -> str:
    char = chr(byte)
    plain = byte < 0x7F and char.isprintable() and char not in "'\\"
    return char if plain else f"\\x{byte:02x}"

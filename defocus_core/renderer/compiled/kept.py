"""The cache of compiled functions on disk, and which process fills it; Numba is not imported.

Compiled functions depend on each other, so one cache serves all sources of this folder. It lies in
their ``__pycache__``, or else in the user's cache folder.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import blake2b
from importlib import metadata
from pathlib import Path

from filelock import FileLock

_PREFIX, _ALL = "compiled-", "all"


@cache
def folder() -> Path | None:
    """The folder in which compiled functions are cached; None if no such folder can be written."""
    sources = sorted(Path(__file__).parent.glob("*.py"))
    checks = os.environ.get("NUMBA_BOUNDSCHECK", "")
    versions = f"{metadata.version('numba')} {sys.implementation.cache_tag} {checks}"
    content = b"".join(source.read_bytes() for source in sources)
    name = _PREFIX + blake2b(versions.encode() + content, digest_size=8).hexdigest()
    users = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "defocus"
    for parent in (Path(__file__).parent / "__pycache__", users):
        with suppress(OSError):
            (parent / name).mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=parent / name).close()
            return parent / name
    return None


@contextmanager
def one_process() -> Iterator[bool]:
    """Yield whether this process is to compile the functions; other processes wait for it.

    Functions count as cached when the block ends.
    """
    place = folder()
    if place is None:
        yield True
        return
    every = place / _ALL
    if every.exists():
        yield False
        return
    with FileLock(place / "lock"):
        yield not every.exists()
        every.touch()

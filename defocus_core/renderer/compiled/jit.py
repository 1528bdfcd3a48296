"""Compilation of functions to machine code that runs without the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

from defocus_core.renderer.compiled.kept import folder

# Sums may be reordered; NaN and infinity keep their meaning.
_FASTMATH = {"reassoc", "contract", "arcp", "nsz"}
_OPTIONS: dict[str, Any] = {
    **{"nogil": True, "fastmath": _FASTMATH, "error_model": "numpy"},
    "no_cfunc_wrapper": True,  # nothing is called from C; wrappers take long to compile
}


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` as machine code, which only other compiled functions can call."""
    options = {**_OPTIONS, "no_cpython_wrapper": True}
    return numba.njit(**options)(function)  # type: ignore[no-any-return]


def entry(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function` as machine code that Python can call, cached on disk with all that it calls."""
    config: Any = numba.config
    place, before = folder(), config.CACHE_DIR
    config.CACHE_DIR = str(place or before)
    try:
        return numba.njit(cache=place is not None, **_OPTIONS)(function)  # type: ignore[no-any-return]
    finally:
        config.CACHE_DIR = before

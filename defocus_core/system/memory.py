"""The memory that this process holds and that is available, in MB.

A megabyte is a million bytes, as in sizes on the command line.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache, lru_cache
from pathlib import Path

MB = 10**6
_KIB = 2**10
_STATUS = Path("/proc/self/status")
_MEMINFO = Path("/proc/meminfo")
# Files of limit and use of a container's control group, for both versions of Linux cgroups.
_GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)

# Settings of glibc's allocator by number, and bytes: mallopt(3), malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_LARGEST, _FOREVER = 2**25, 2**31 - 1


@contextmanager
def without_collections() -> Iterator[None]:
    """Pause garbage collection during the block, where it would find nothing and cost time."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def held_mb() -> float:
    """Memory in MB that the process holds now; 0 where the system does not report it."""
    with suppress(OSError, ValueError, IndexError):
        return _entry(_STATUS, "VmRSS:")
    return 0.0


def available_mb(device: str = "cpu") -> float | None:
    """Memory in MB that can be taken without swapping or being killed; None if unknown.

    `device`: "cpu", or "cuda" for the memory of the GPU.
    """
    if device == "cuda":
        import torch

        return torch.cuda.mem_get_info()[0] / MB
    # cached for a second, as asking takes longer than a small picture
    return _available_mb(int(time.monotonic()))


@lru_cache(maxsize=1)
def _available_mb(_second: int) -> float | None:
    limits = []
    with suppress(OSError, ValueError, IndexError):
        limits.append(_entry(_MEMINFO, "MemAvailable:"))
    with suppress(ImportError, OSError, ValueError, IndexError):
        import resource

        soft = resource.getrlimit(resource.RLIMIT_AS)[0]  # 'ulimit -v'
        if soft != resource.RLIM_INFINITY:
            limits.append(soft / MB - _entry(_STATUS, "VmSize:"))
    for limit, used in _limited_groups():
        with suppress(OSError, ValueError):
            limits.append((int(Path(limit).read_text()) - int(Path(used).read_text())) / MB)
    return max(min(limits), 0.0) if limits else None


@cache
def _limited_groups() -> list[tuple[str, str]]:
    """Pairs of files (limit, use) of the control groups of this process that have a limit."""
    found = []
    for limit, used in _GROUPS:
        with suppress(OSError, ValueError):  # "max" is no number: no limit
            int(Path(limit).read_text())
            found.append((limit, used))
    return found


def _entry(file: Path, name: str) -> float:
    """The number in MB of a line like ``VmRSS: 123 kB``, where kB means KiB."""
    return int(file.read_text().partition(name)[2].split()[0]) * _KIB / MB


def trim() -> None:
    """Give freed memory back to the system; has no effect on allocators other than glibc's."""
    _glibc("malloc_trim", 0)


def keep_freed() -> None:
    """Let glibc keep freed blocks below _LARGEST bytes: new pages would cost 3 to 10 % of time."""
    _glibc("mallopt", _M_MMAP_THRESHOLD, _LARGEST)
    _glibc("mallopt", _M_TRIM_THRESHOLD, _FOREVER)


def share_heap() -> None:
    """Let threads started later share one heap of glibc, so that each can use what others freed."""
    _glibc("mallopt", _M_ARENA_MAX, 1)


def _glibc(name: str, *numbers: int) -> None:
    import ctypes

    with suppress(OSError, TypeError, AttributeError):  # another C library has no such function
        getattr(ctypes.CDLL(None), name)(*numbers)

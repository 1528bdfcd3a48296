"""Memory of this process: held now, its peak, and what is available. In MB.

A megabyte is a million bytes, as in sizes on the command line.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

MB = 10**6
_KIB = 2**10
_STATUS = Path("/proc/self/status")
_MEMINFO = Path("/proc/meminfo")
# Limit and use of the group of processes that a container is, of either generation of Linux.
_GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    (
        "/sys/fs/cgroup/memory/memory.limit_in_bytes",
        "/sys/fs/cgroup/memory/memory.usage_in_bytes",
    ),
)

# Settings of glibc's allocator by number, and bytes: mallopt(3), malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
_LARGEST, _FOREVER = 2**25, 2**31 - 1


def reset_peak(device: str = "cpu") -> None:
    """Let the peak begin anew, where the system can; what is free goes back to it before."""
    if device == "cuda":
        import torch

        torch.cuda.reset_peak_memory_stats()
        return
    trim()
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_mb(device: str = "cpu") -> float | None:
    """Most that the process held since the reset, or ever where there is none; None if unknown.

    On a GPU it is the most that tensors held there.
    """
    if device == "cuda":
        import torch

        return torch.cuda.max_memory_allocated() / MB
    try:
        import resource
    except ImportError:  # Windows
        return None
    with suppress(OSError, ValueError, IndexError):  # Linux: can be reset
        return _entry(_STATUS, "VmHWM:")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else _KIB) / MB


def held_mb(device: str = "cpu") -> float:
    """What is held now; 0 where no system tells."""
    if device == "cuda":
        import torch

        return torch.cuda.memory_allocated() / MB
    with suppress(OSError, ValueError, IndexError):
        return _entry(_STATUS, "VmRSS:")
    return 0.0


def available_mb(device: str = "cpu") -> float | None:
    """What can still be taken without swapping or being killed; None where no system tells."""
    if device == "cuda":
        import torch

        return torch.cuda.mem_get_info()[0] / MB
    found = []
    with suppress(OSError, ValueError, IndexError):
        found.append(_entry(_MEMINFO, "MemAvailable:"))
    for limit, used in _GROUPS:
        with suppress(OSError, ValueError):  # "max" is no number: no limit
            found.append((int(Path(limit).read_text()) - int(Path(used).read_text())) / MB)
    return max(min(found), 0.0) if found else None


def _entry(file: Path, name: str) -> float:
    """A line like ``VmRSS: 123 kB``, which means KiB, in MB."""
    return int(file.read_text().partition(name)[2].split()[0]) * _KIB / MB


def trim() -> None:
    """Hand back what the allocator of glibc keeps for later; others are left alone."""
    _glibc("malloc_trim", 0)


def keep_freed(keep: bool) -> None:
    """Whether the allocator of glibc keeps all that is set free for later; others are left alone.

    Where it does not, it hands back what ends its heap beyond the most that it comes to by itself,
    and what is taken next is taken from the system page by page: 3 to 10 % of the time of a
    picture. What is as large as _LARGEST is handed back anyhow.
    """
    _glibc("mallopt", _M_MMAP_THRESHOLD, _LARGEST)
    _glibc("mallopt", _M_TRIM_THRESHOLD, _FOREVER if keep else 2 * _LARGEST)


def share_heap() -> None:
    """Have threads begun later take from one heap of glibc: what one sets free another finds.

    Heaps of their own are new for each of them, and taken page by page.
    """
    _glibc("mallopt", _M_ARENA_MAX, 1)


def _glibc(name: str, *numbers: int) -> None:
    if not sys.platform.startswith("linux"):
        return
    import ctypes

    with suppress(OSError, AttributeError):  # another library of C has no such function
        getattr(ctypes.CDLL(None), name)(*numbers)

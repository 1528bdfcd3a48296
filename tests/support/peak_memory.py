"""The most memory that the process held: for tests, on Linux."""

from pathlib import Path

from defocus_core.system import memory


def reset_peak():
    """Set the peak back to what is held now; free memory goes back to the system first."""
    memory.trim()
    Path("/proc/self/clear_refs").write_text("5")


def peak_mb():
    """The most memory of the process since `reset_peak`, in MB."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / memory.MB

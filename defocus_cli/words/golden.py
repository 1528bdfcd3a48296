"""The report of ``defocus golden check --must-fail``: which planted faults the rules notice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from defocus_core.compare.goldens.faults import Planted
from defocus_core.system.text import counted

Faults = Mapping[str, Sequence[Planted]]


def planted_lines(name: str, faults: Sequence[Planted]) -> Iterator[str]:
    """A line for each fault that passes, and one each of those that are warned of, and noticed."""
    yield from (f"{name}: PASSES: {fault.fault}" for fault in faults if fault.is_silent)
    warned = [fault.fault for fault in faults if fault.warned]
    if warned:
        yield f"{name}: only a warning: {', '.join(warned)}"
    weakest = [f"{fault.fault} (from {fault.weakest})" for fault in faults if fault.weakest]
    if weakest:
        yield f"{name}: noticed: {', '.join(weakest)}"


def planted_summary(planted: Faults) -> str:
    """How many faults were planted, how many pass, and how many with a warning."""
    every = [fault for faults in planted.values() for fault in faults]
    missed, warned = (sum(getattr(f, kind) for f in every) for kind in ("is_silent", "warned"))
    verdict = f"{missed} PASS" if missed else "all are noticed"
    verdict += f", {warned} with only a warning" if warned else ""
    return f"{counted(len(every), 'fault')} in {counted(len(planted), 'golden')}: {verdict}"


def planted_document(planted: Faults) -> dict[str, Any]:
    """All faults, for JSON."""
    return {
        "all_noticed": not any(fault.is_silent for faults in planted.values() for fault in faults),
        "goldens": {
            name: [
                {
                    "fault": f.fault,
                    "noticed": f.noticed,
                    "warned": f.warned,
                    "weakest": f.weakest or None,
                }
                for f in faults
            ]
            for name, faults in planted.items()
        },
    }

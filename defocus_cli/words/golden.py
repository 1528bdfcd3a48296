"""The report of ``defocus golden check --must-fail``: which planted faults the rules notice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from defocus_core.compare.goldens.faults import Planted
from defocus_core.system.text import counted

Faults = Mapping[str, Sequence[Planted]]


def planted_lines(name: str, faults: Sequence[Planted]) -> Iterator[str]:
    """A line for each fault that passes, and one with the weakest faults that fail."""
    for fault in faults:
        if not fault.noticed:
            yield f"{name}: PASSES: {fault.fault}"
    weakest = [f"{fault.fault} (from {fault.weakest})" for fault in faults if fault.weakest]
    if weakest:
        yield f"{name}: noticed: {', '.join(weakest)}"


def planted_summary(planted: Faults) -> str:
    """How many faults were planted, and how many pass."""
    every = [fault for faults in planted.values() for fault in faults]
    missed = sum(not fault.noticed for fault in every)
    verdict = f"{missed} PASS" if missed else "all are noticed"
    return f"{counted(len(every), 'fault')} in {counted(len(planted), 'golden')}: {verdict}"


def planted_document(planted: Faults) -> dict[str, Any]:
    """All faults, for JSON."""
    return {
        "all_noticed": all(fault.noticed for faults in planted.values() for fault in faults),
        "goldens": {
            name: [
                {"fault": f.fault, "noticed": f.noticed, "weakest": f.weakest or None}
                for f in faults
            ]
            for name, faults in planted.items()
        },
    }

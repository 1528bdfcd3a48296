"""Comparison with a stored run of ``defocus bench --time --json > FILE``, to find slower cases.

What is compared is the cost in transforms measured beside each rendering, not in seconds: the
stored run may be of another machine, or of this one when it was busy.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from defocus_core.bench.timing import Case, MeasuredCost
from defocus_core.errors import InputError, cannot_read, reason
from defocus_core.io.below import read_plain
from defocus_core.io.safe_files import MALFORMED

TOLERANCE = 0.25  # how much slower, in transforms, counts as slower


@dataclass(frozen=True)
class Baseline:
    """A stored run."""

    path: Path
    threads: int  # number of threads that it was measured with
    device: str  # device that it was measured on
    fft_units: Mapping[str, float]  # cost of each case, by name

    def refuse_incomparable(self, cases: Sequence[Case], *, threads: int, device: str) -> None:
        """Refuse other numbers of threads, a GPU instead of a CPU, and other cases."""
        if (self.threads, self.device) != (threads, device):
            problem = f"was measured on {self.device} with ‹threads› {self.threads}"
            remedy = f"add ‹device› {self.device} ‹threads› {self.threads}, or store a new one"
            raise InputError("other-machine", problem, remedy, path=self.path)
        if not any(case.name in self.fft_units for case in cases):
            problem = "holds none of the cases asked for"
            raise InputError(
                "empty", problem, "ask for the same sizes, radii and qualities", path=self.path
            )

    def compare(self, costs: Mapping[Case, MeasuredCost]) -> list[dict[str, Any]]:
        """The ratio, new to stored, of each case that both have; the slowest first."""
        units = {case.name: cost.fft_units for case, cost in costs.items()}
        compared = [
            {"case": name, "fft_units": units[name], "stored": old, "ratio": units[name] / old}
            for name, old in self.fft_units.items()
            if name in units
        ]
        return sorted(compared, key=lambda each: -float(each["ratio"]))

    def confirmed(
        self, costs: Mapping[Case, MeasuredCost], again: Callable[[Case], MeasuredCost]
    ) -> dict[Case, MeasuredCost]:
        """Time slower cases once more, and keep the faster: a busy machine is not slow twice."""
        names = {each["case"] for each in slower(self.compare(costs))}
        retimed = {case: again(case) for case in costs if case.name in names}
        return {
            case: min(cost, retimed.get(case, cost), key=lambda each: each.fft_units)
            for case, cost in costs.items()
        }


def slower(compared: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The cases whose ratio exceeds 1 by more than the tolerance, in their order."""
    return [each for each in compared if each["ratio"] > 1 + TOLERANCE]


def read_baseline(path: Path) -> Baseline:
    """Read what ``--json`` wrote."""
    try:
        document = json.loads(read_plain(path))
        fft_units = {str(row["case"]): float(row["fft_units"]) for row in document["rows"]}
        threads, device = int(document["threads"]), str(document["device"])
    except OSError as error:
        raise cannot_read(path, error, "check the path") from error
    except MALFORMED as error:
        problem = f"is no stored run ({type(error).__name__}: {reason(error)})"
        raise InputError(
            "malformed", problem, "make one with: defocus bench ‹time› ‹json› > FILE", path=path
        ) from None
    if not all(value > 0 for value in fft_units.values()):
        raise InputError(
            "damaged", "holds a time that is not positive", "store a new run", path=path
        )
    return Baseline(path, threads, device, fft_units)

"""What timing found, as lines of a table, exponents, comparisons and records."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from defocus_cli.bench_scaling import QUANTITIES, exponents
from defocus_cli.bench_time import KINDS

if TYPE_CHECKING:
    from defocus_cli.bench_time import Timing

_NAMES = {"kind": 8, "size": 11, "radius": 6, "quality": 10, "outputs": 8}
# Name in records, title of the column, width and decimals.
_COLUMNS = (
    ("seconds", "seconds", 9, 3),
    ("cpu_seconds", "CPU s", 9, 3),
    ("fft_units", "FFTs", 8, 1),
    ("work_percent", "work %", 8, 1),
    ("peak_mb", "MB", 7, 0),
)
# Those of predictions, which stand beside what was measured.
_PREDICTED = (("predicted_seconds", "pred. s", 9, 3), ("predicted_mb", "pred. MB", 10, 0))
_MOST_TOLD = 10
# By what factor a prediction may be off.
_NEAR = 1.5


def record(timing: Timing) -> dict[str, Any]:
    """A timing in plain words and numbers."""
    case = timing.case
    return {
        "case": case.name,
        "kind": case.kind,
        "width": case.size[0],
        "height": case.size[1],
        "radius": case.radius,
        "quality": case.quality,
        "outputs": case.outputs,
        "seconds": timing.seconds,
        "cpu_seconds": timing.cpu_seconds,
        "fft_units": timing.fft_units,
        "peak_mb": timing.peak_mb,
        "predicted_seconds": timing.predicted_seconds,
        "predicted_mb": timing.predicted_mb,
        "repeats": timing.repeats,
        "work_percent": 100 * timing.stats["slice_tiles_done"] / timing.stats["slice_tiles"],
        **timing.stats,
    }


def heading(*, predicted: bool) -> str:
    """The titles of the columns, with or without those of predictions."""
    names = "".join(f"{'r' if name == 'radius' else name:<{n}}" for name, n in _NAMES.items())
    return names + "".join(f"{title:>{width}}" for _, title, width, _ in _columns(predicted))


def line(timing: Timing) -> str:
    """A row of the table."""
    case, values = timing.case, record(timing)
    told = {"kind": case.kind, "size": "{}x{}".format(*case.size), "radius": f"{case.radius:g}"}
    told |= {"quality": case.quality, "outputs": case.outputs}
    names = "".join(f"{told[name]:<{width}}" for name, width in _NAMES.items())
    columns = _columns(timing.predicted_seconds is not None)
    return names + "".join(
        f"{_cell(values[name], decimals):>{width}}" for name, _, width, decimals in columns
    )


def scaling_lines(timings: Sequence[Timing]) -> Iterator[str]:
    """Exponents in words."""
    yield ""
    yield "seconds grow like pixels^a, radius^b, slices^c, all else being equal"
    yield f"{'kind':<8}{'a':>7}{'b':>7}{'c':>7}"
    for found in exponents(timings):
        cells = "".join(f"{_cell(found[name], 2):>7}" for name in QUANTITIES)
        yield f"{found['kind']:<8}{cells}   {KINDS[found['kind']]}"


def comparison_lines(
    compared: Sequence[Mapping[str, Any]], worse: Sequence[Mapping[str, Any]], tolerance: float
) -> Iterator[str]:
    """What got slower since a stored run."""
    yield ""
    for each in worse[:_MOST_TOLD]:
        yield (
            f"! {each['case']}: {each['fft_units']:.1f} FFTs, stored {each['stored']:.1f}: "
            f"{each['ratio']:.2f} x"
        )
    if len(worse) > _MOST_TOLD:
        yield f"! and {len(worse) - _MOST_TOLD} more"
    ratios = sorted(each["ratio"] for each in compared)
    yield (
        f"{len(worse)} of {len(compared)} cases slower than stored by more than "
        f"{100 * tolerance:g} %; ratio {ratios[0]:.2f} to {ratios[-1]:.2f}, "
        f"median {ratios[len(ratios) // 2]:.2f}"
    )


def prediction_lines(timings: Sequence[Timing]) -> Iterator[str]:
    """How far off predictions were, in words."""
    yield ""
    for name, truth, what in (
        ("predicted_seconds", "seconds", "seconds"),
        ("predicted_mb", "peak_mb", "peak memory"),
    ):
        values = [(record(timing), timing.case.name) for timing in timings]
        ratios = [(r[name] / r[truth], case) for r, case in values if r[name] and r[truth]]
        if ratios:
            near = sum(1 for ratio, _ in ratios if 1 / _NEAR <= ratio <= _NEAR)
            worst, case = max(ratios, key=lambda each: max(each[0], 1 / each[0]))
            yield (
                f"{what}: {near} of {len(ratios)} predicted within a factor of {_NEAR}; "
                f"farthest off {worst:.2f} x, {case}"
            )


def document(timings: Sequence[Timing]) -> dict[str, Any]:
    """All rows and exponents, for JSON."""
    return {"rows": [record(timing) for timing in timings], "exponents": exponents(timings)}


def csv_text(timings: Sequence[Timing]) -> str:
    """All rows as CSV with a header."""
    records = [record(timing) for timing in timings]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()


def _cell(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"


def _columns(predicted: bool) -> tuple[tuple[str, str, int, int], ...]:
    return (*_COLUMNS, *_PREDICTED) if predicted else _COLUMNS

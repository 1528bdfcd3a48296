"""What a benchmark found, as lines of a table, means, regressions and records.

A regression is a shot on which `standard` is worse than a baseline by more than truth in half
floats can tell: 0.1 dB, 0.001 SSIM, or 1 % of relative RMSE.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from statistics import fmean
from typing import TYPE_CHECKING, Any

from defocus_cli.bench_run import BASELINES

if TYPE_CHECKING:
    from defocus_cli.bench_run import Row

JUDGED = "standard"
CAP = 50.0  # dB that a shot adds to a mean at most: easy scenes do not hide hard ones
_LEAST_DB, _LEAST_SSIM, _LEAST_SHARE = 0.1, 0.001, 0.01
# Relative RMSE of rounding to half, which truth and input have both.
_ROUNDING = 1.4e-4
_DECIMALS = {
    **{"psnr": 2, "psnr_edges": 2, "psnr_elsewhere": 2, "rel_rmse": 5, "ssim": 5, "p999": 4},
    **{"seconds": 3, "fft_units": 1, "peak_mb": 0},
}
_WIDTHS = {"psnr": 7, "psnr_edges": 7, "psnr_elsewhere": 7, "peak_mb": 7}
_TITLES = {"psnr": "PSNR", "psnr_edges": "edges", "psnr_elsewhere": "other", "rel_rmse": "relRMSE"}
_TITLES |= {"ssim": "SSIM", "fft_units": "FFTs", "peak_mb": "MB"}


def record(row: Row) -> dict[str, Any]:
    """A row in plain words and numbers."""
    cost = {"seconds": row.seconds, "fft_units": row.fft_units, "peak_mb": row.peak_mb}
    names = {"scene": row.scene, "shot": row.shot, "method": row.method}
    return {**names, **asdict(row.errors), **cost}


def means(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """For each method the means over all shots, each PSNR capped at 50 dB.

    Shots that all methods get right, as a white picture, tell nothing and are left out; unless
    there is nothing else. Memory is the most of any shot.
    """
    records = [record(row) for row in rows]
    told = {(r["scene"], r["shot"]) for r in records if r["psnr"] < 90}
    records = [r for r in records if not told or (r["scene"], r["shot"]) in told]
    found = []
    for method in dict.fromkeys(r["method"] for r in records):
        own = [r for r in records if r["method"] == method]
        mean: dict[str, Any] = {"method": method, "shots": len(own)}
        for name in _DECIMALS:
            values = [r[name] for r in own if r[name] is not None]
            if name.startswith("psnr"):
                values = [min(value, CAP) for value in values]
            gather = max if name == "peak_mb" else fmean
            mean[name] = gather(values) if values else None
        found.append(mean)
    return found


def regressions(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Where the standard quality is worse than a baseline, and by how much, the worst first."""
    judged = {(row.scene, row.shot): row.errors for row in rows if row.method == JUDGED}
    found = []
    for row in rows:
        own, other = judged.get((row.scene, row.shot)), row.errors
        if own is None or row.method not in BASELINES:
            continue
        decibels, similarity = other.psnr - own.psnr, other.ssim - own.ssim
        excess = own.rel_rmse - other.rel_rmse
        worse = {
            "psnr": decibels if decibels > _LEAST_DB else None,
            "ssim": similarity if similarity > _LEAST_SSIM else None,
            "rel_rmse": excess if excess > max(_LEAST_SHARE * other.rel_rmse, _ROUNDING) else None,
        }
        lost = {name: by for name, by in worse.items() if by is not None}
        if lost:
            where = {"scene": row.scene, "shot": row.shot, "baseline": row.method}
            found.append({**where, "lost": lost, "share": excess / max(other.rel_rmse, 1e-12)})
    return sorted(found, key=lambda r: -float(r["lost"].get("psnr", 0.0)))


def heading() -> str:
    """The titles of the columns."""
    titles = (f"{_TITLES.get(name, name):>{_WIDTHS.get(name, 9)}}" for name in _DECIMALS)
    return f"{'scene':<10}{'shot':<8}{'method':<9}" + "".join(titles)


def line(row: Row, *, worse: bool = False) -> str:
    """A row of the table, marked if it is a regression."""
    names = f"{row.scene:<10}{row.shot:<8}{row.method:<9}"
    return names + _cells(record(row)) + (" !" if worse else "")


def shot_lines(rows: Sequence[Row]) -> Iterator[str]:
    """The rows of one shot."""
    worse = bool(regressions(rows))
    for row in rows:
        yield line(row, worse=worse and row.method == JUDGED)


def summary_lines(rows: Sequence[Row]) -> Iterator[str]:
    """Means and regressions in words."""
    found = means(rows)
    shots = found[0]["shots"]
    yield ""
    yield f"means of {shots} shot{'s' * (shots != 1)}, PSNR capped at {CAP:g} dB"
    for mean in found:
        yield f"{'mean':<18}{mean['method']:<9}" + _cells(mean)
    worse = regressions(rows)
    if worse:
        yield ""
    for lost in worse:
        yield _loss(lost)


def _loss(found: dict[str, Any]) -> str:
    lost = found["lost"]
    words = []
    if "psnr" in lost:
        words.append(f"{lost['psnr']:.2f} dB")
    if "ssim" in lost:
        words.append(f"{lost['ssim']:.4f} SSIM")
    if "rel_rmse" in lost:
        words.append(f"{100 * found['share']:.1f} % relative RMSE")
    baseline = BASELINES[found["baseline"]]
    return f"! {found['scene']} {found['shot']}: {JUDGED} loses {', '.join(words)} to {baseline}"


def _cells(values: dict[str, Any]) -> str:
    cells = []
    for name, decimals in _DECIMALS.items():
        value = values[name]
        told = "-" if value is None else f"{value:.{decimals}f}"
        cells.append(f"{told:>{_WIDTHS.get(name, 9)}}")
    return "".join(cells)


def csv_text(rows: Sequence[Row]) -> str:
    """All rows as CSV with a header."""
    records = [record(row) for row in rows]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()

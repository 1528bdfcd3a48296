"""Error and cost of shots of known truth, by each quality and baseline method; tables of them.

Methods are the qualities of the renderer and the baselines it has to beat. A regression is a shot
on which `standard` is worse than a baseline by more than truth in half floats can show: 0.1 dB,
0.001 SSIM, or 1 % of relative RMSE.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import fmean
from typing import TYPE_CHECKING, Any

from defocus_core.bench.timing import Case, FftUnit, MeasuredCost, measured
from defocus_core.bench.truth_set import Pictures, TruthShot
from defocus_core.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    from defocus_core.evaluation.metrics import Errors

BASELINES = {"input": "the sharp input", "sum": "plain sum of slices", "over": "over / alpha"}
Columns = dict[str, tuple[str, int, int | None]]
JUDGED = "standard"
CAP = 50.0  # dB that a shot adds to a mean at most: easy scenes do not hide hard ones
_MIN_DB, _MIN_SSIM, _MIN_FRACTION = 0.1, 0.001, 0.01
# Relative RMSE of rounding to half, which truth and input have both.
_ROUNDING = 1.4e-4
# Title, width and decimals of each column, of words None; of errors, then of times.
ERRORS: Columns = {
    "scene": ("scene", 10, None),
    "shot": ("shot", 8, None),
    "method": ("method", 9, None),
    "psnr": ("PSNR", 7, 2),
    "psnr_edges": ("edges", 7, 2),
    "psnr_elsewhere": ("other", 7, 2),
    "rel_rmse": ("relRMSE", 9, 5),
    "ssim": ("SSIM", 9, 5),
    "p999": ("p999", 9, 4),
    "seconds": ("seconds", 9, 3),
    "fft_units": ("FFTs", 9, 1),
    "peak_mb": ("MB", 7, 0),
}
TIMES: Columns = {
    "kind": ("kind", 8, None),
    "size": ("size", 11, None),
    "radius": ("r", 6, None),
    "quality": ("quality", 10, None),
    "seconds": ("seconds", 9, 3),
    "fft_units": ("FFTs", 8, 1),
    "peak_mb": ("MB", 7, 0),
    "launches": ("launches", 10, 0),
    "waits": ("waits", 7, 0),
    "written_mb": ("MB written", 12, 0),
}


@dataclass(frozen=True)
class Row:
    """One shot by one method."""

    scene: str  # name of the scene
    shot: str  # name of the shot
    method: str  # a quality or a baseline method
    errors: Errors  # errors against the truth
    cost: MeasuredCost  # cost of the rendering alone


def measure_shot(
    shot: TruthShot,
    pictures: Pictures,
    methods: Sequence[str],
    *,
    device: str,
    threads: int,
) -> Iterator[Row]:
    """One row for each method, when it is done."""
    import torch

    from defocus_core.evaluation import metrics

    sharp, radius = pictures.sharp.to(device), pictures.signed_radius.to(device)
    there = replace(pictures, sharp=sharp, signed_radius=radius)
    try:
        unit = FftUnit(sharp)
        for method in methods:
            picture, cost = measured(_work(method, shot, there, threads), unit, repeats=1)
            picture = picture.cpu()
            errors = metrics.measure(
                picture, pictures.truth, pictures.signed_radius, border=shot.border
            )
            yield Row(shot.scene, shot.name, method, errors, cost)
    except torch.OutOfMemoryError:
        problem = "does not fit into the memory of the GPU"
        raise InputError("out-of-memory", problem, "use ‹device› cpu", path=shot.folder) from None


def _work(method: str, shot: TruthShot, pictures: Pictures, threads: int) -> Callable[[], Tensor]:
    """The rendering of a shot by a method."""
    from defocus_core.evaluation import baselines
    from defocus_core.optics.aperture import Aperture
    from defocus_core.renderer.render import render

    aperture = Aperture(shot.lens.blades, shot.lens.blade_rotation)
    sharp, radius = pictures.sharp, pictures.signed_radius
    if method == "input":
        return lambda: sharp
    if method in BASELINES:
        layered = {"sum": baselines.plain_sum, "over": baselines.over}[method]
        return lambda: layered(sharp, radius, aperture=aperture, threads=threads)
    return lambda: (
        render(
            sharp,
            radius,
            aperture=aperture,
            quality=method,
            threads=threads,
            infinity=pictures.infinity,
        ).render
    )


def record(row: Row) -> dict[str, Any]:
    """A row in plain words and numbers."""
    names = {"scene": row.scene, "shot": row.shot, "method": row.method}
    return {**names, **asdict(row.errors), **asdict(row.cost)}


def means(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """For each method the means over all shots, each PSNR capped at 50 dB.

    Shots that every method renders right, like a white picture, are left out unless there are no
    others. Memory is the maximum over the shots.
    """
    records = [record(row) for row in rows]
    hard = {(r["scene"], r["shot"]) for r in records if r["psnr"] < 90}
    records = [r for r in records if not hard or (r["scene"], r["shot"]) in hard]
    averages = []
    for method in dict.fromkeys(r["method"] for r in records):
        own = [r for r in records if r["method"] == method]
        mean: dict[str, Any] = {"method": method, "shots": len(own)}
        for name in [name for name, (*_, decimals) in ERRORS.items() if decimals is not None]:
            values = [r[name] for r in own if r[name] is not None]
            if name.startswith("psnr"):
                values = [min(value, CAP) for value in values]
            gather = max if name == "peak_mb" else fmean
            mean[name] = gather(values) if values else None
        averages.append(mean)
    return averages


def losses(row: Row, rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Losses of a row of the standard quality to each baseline in `rows`; none for other rows."""
    if row.method != JUDGED:
        return []
    lost_to = []
    for other in rows:
        if (other.scene, other.shot) != (row.scene, row.shot) or other.method not in BASELINES:
            continue
        own, best = row.errors, other.errors
        excess = own.rel_rmse - best.rel_rmse
        by = {
            "psnr": (best.psnr - own.psnr, _MIN_DB),
            "ssim": (best.ssim - own.ssim, _MIN_SSIM),
            "rel_rmse": (excess, max(_MIN_FRACTION * best.rel_rmse, _ROUNDING)),
        }
        lost = {name: value for name, (value, minimum) in by.items() if value > minimum}
        if lost:
            where = {"scene": row.scene, "shot": row.shot, "baseline": other.method}
            lost_to.append({**where, "lost": lost, "share": excess / max(best.rel_rmse, 1e-12)})
    return lost_to


def regressions(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Where the standard quality is worse than a baseline, and by how much, the worst first."""
    every = (loss for row in rows for loss in losses(row, rows))
    return sorted(every, key=lambda loss: -float(loss["lost"].get("psnr", 0.0)))


def error_document(rows: Sequence[Row]) -> dict[str, Any]:
    """All rows, means and regressions, for JSON."""
    records = [record(row) for row in rows]
    return {"rows": records, "means": means(rows), "regressions": regressions(rows)}


def heading(columns: Columns) -> str:
    """The titles of a table."""
    return line({name: title for name, (title, *_) in columns.items()}, columns)


def line(values: dict[str, Any], columns: Columns) -> str:
    """A row of a table: words from the left, numbers from the right."""
    cells = []
    for name, (_, width, decimals) in columns.items():
        value = "-" if values[name] is None else values[name]
        is_number = decimals is not None and not isinstance(value, str)
        text = f"{value:.{decimals}f}" if is_number else f"{value}"
        cells.append(f"{text:<{width}}" if decimals is None else f"{text:>{width}}")
    return "".join(cells)


def summary_lines(rows: Sequence[Row]) -> Iterator[str]:
    """Means and regressions in words."""
    averages = means(rows)
    shots = averages[0]["shots"]
    yield ""
    yield f"means of {shots} shot{'s' * (shots != 1)}, PSNR capped at {CAP:g} dB"
    for mean in averages:
        yield line({"scene": "mean", "shot": "", **mean}, ERRORS)
    worse = regressions(rows)
    if worse:
        yield ""
    for lost in worse:
        yield _loss(lost)


def _loss(loss: dict[str, Any]) -> str:
    lost = loss["lost"] | {"share": 100 * loss["share"]}
    formats = {"psnr": "{psnr:.2f} dB", "ssim": "{ssim:.4f} SSIM"}
    formats["rel_rmse"] = "{share:.1f} % relative RMSE"
    words = ", ".join(text.format(**lost) for name, text in formats.items() if name in lost)
    baseline = BASELINES[loss["baseline"]]
    return f"! {loss['scene']} {loss['shot']}: {JUDGED} loses {words} to {baseline}"


def time_record(case: Case, cost: MeasuredCost) -> dict[str, Any]:
    """A case and its cost in plain words and numbers."""
    size = {"width": case.size[0], "height": case.size[1]}
    settings = {"kind": case.kind, **size, "radius": case.radius, "quality": case.quality}
    return {"case": case.name, **settings, **asdict(cost)}

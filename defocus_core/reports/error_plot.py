"""Plot of a benchmark: run time against error, one mark for each shot and method."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from defocus_core.allowed_values import QUALITIES
from defocus_core.bench.error import BASELINES, Row
from defocus_core.bench.tables import CAP, means
from defocus_core.errors import UsageProblem
from defocus_core.io.safe_files import written_whole

SUFFIXES = (".png", ".svg", ".pdf")
_COLORS = {"draft": "#e69f00", "standard": "#0072b2", "high": "#009e73", "reference": "#000000"}
_COLORS |= {"sum": "#cc79a7", "over": "#d55e00", "input": "#777777"}
# Where labels of means stand from their marks: offset in points, and alignment.
_PLACES = {"draft": (-9, -22, "right"), "standard": (0, 12, "center"), "high": (9, 6, "left")}
_PLACES |= {"reference": (9, 6, "left"), "sum": (9, 6, "left"), "over": (9, -26, "left")}
_MARKS = {"sum": "x", "over": "+"}


def refuse_unplottable(path: Path) -> None:
    """Find out before the work whether there can be a plot."""
    if path.suffix.lower() not in SUFFIXES:
        problem = f"{path} has no suffix of a picture"
        raise UsageProblem("malformed", problem, f"use one of {', '.join(SUFFIXES)}", field="plot")
    if find_spec("matplotlib") is None:
        problem = "needs matplotlib, which is not installed"
        raise UsageProblem(
            "needs-extra", problem, "run: pip install 'defocus[bench]'", field="plot"
        )


def draw(path: Path, rows: Sequence[Row]) -> None:
    """Write the plot."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 5.5), layout="constrained")
    _draw_shots(axes, rows)
    _draw_means(axes, means(rows))
    axes.set_xscale("log")
    axes.set_xlabel("run time in FFT units (one transform of the frame there and back)")
    axes.set_ylabel(f"PSNR against the truth in dB, at most {CAP:g}")
    axes.margins(x=0.15)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize="small")
    try:
        with written_whole(path) as file:
            figure.savefig(file, format=path.suffix[1:].lower(), dpi=150)
    finally:
        pyplot.close(figure)


def _draw_shots(axes: Any, rows: Sequence[Row]) -> None:
    for method in dict.fromkeys(row.method for row in rows):
        of_method = [row for row in rows if row.method == method]
        if method == "input":
            continue
        axes.scatter(
            [row.cost.fft_units for row in of_method],
            [min(row.errors.psnr, CAP) for row in of_method],
            marker=_MARKS.get(method, "o"),
            color=_COLORS[method],
            s=22,
            alpha=0.5,
            label=f"{BASELINES.get(method, method)}, each shot",
        )


def _draw_means(axes: Any, method_means: Sequence[dict[str, Any]]) -> None:
    """Means: a line through the qualities, one mark for each baseline, a level for the input."""
    by_method = {mean["method"]: mean for mean in method_means}
    line = [by_method[name] for name in QUALITIES if name in by_method]
    times, values = [m["fft_units"] for m in line], [m["psnr"] for m in line]
    axes.plot(times, values, "-D", color="black", markersize=8, label="means of the qualities")
    for mean in method_means:
        name, at = mean["method"], (mean["fft_units"], mean["psnr"])
        if name == "input":
            axes.axhline(at[1], linestyle="--", color=_COLORS[name], label=BASELINES[name])
            continue
        if name in BASELINES:
            axes.plot(*at, _MARKS[name], color=_COLORS[name], markersize=13, markeredgewidth=3)
        x, y, side = _PLACES[name]
        axes.annotate(
            f"{BASELINES.get(name, name)}\n{at[1]:.1f} dB, {mean['seconds']:.2g} s",
            at,
            textcoords="offset points",
            xytext=(x, y),
            ha=side,
            fontsize="small",
            fontweight="normal" if name in BASELINES else "bold",
        )

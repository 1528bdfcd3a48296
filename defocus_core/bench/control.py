"""Controllability of each method on shots: ten strengths asked for, and the blur made of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import fmean
from typing import Any

from defocus_core.bench.error import work
from defocus_core.bench.truth_set import Pictures, TruthShot


@dataclass(frozen=True)
class Control:
    """One shot by one method, at several strengths of its blur.

    Attributes:
        scene: name of the scene.
        shot: name of the shot.
        method: a quality or a baseline method.
        rank_correlation: of the strengths asked for and the blur made; 1 if more is always more.
        rises: steps from a strength to the next that made more blur.
        blur: made at each strength, the share of the RMS gradient that is lost.
    """

    scene: str
    shot: str
    method: str
    rank_correlation: float
    rises: int
    blur: tuple[float, ...]


def measure_control(
    shot: TruthShot, pictures: Pictures, methods: Sequence[str], *, device: str, threads: int
) -> Iterator[Control]:
    """One row for each method, when it is done."""
    from defocus_core.evaluation.controllability import (
        STRENGTHS,
        blur_made,
        rank_correlation,
        rises,
    )

    sharp, radius = pictures.sharp.to(device), pictures.signed_radius.to(device)
    there = replace(pictures, sharp=sharp, signed_radius=radius)
    for method in methods:
        made = []
        for strength in STRENGTHS:
            picture = work(method, shot, there, threads, strength)()
            made.append(blur_made(picture, sharp, border=shot.border))
        correlation = rank_correlation(STRENGTHS, made)
        yield Control(shot.scene, shot.name, method, correlation, rises(made), tuple(made))


def control_document(rows: Sequence[Control]) -> list[dict[str, Any]]:
    """The rows, for JSON."""
    return [asdict(row) for row in rows]


def control_lines(rows: Sequence[Control]) -> Iterator[str]:
    """For each method the rank correlation, on the mean and at worst, and the steps that rose."""
    steps = len(rows[0].blur) - 1
    yield ""
    yield f"more blur asked for, more blur made? {steps + 1} strengths of each shot, by rank"
    yield f"{'':<18}{'method':<9}{'mean':>7}{'minimum':>7}{'rises':>9}  least at"
    for method in dict.fromkeys(row.method for row in rows):
        of_method = [row for row in rows if row.method == method]
        minimum = min(of_method, key=lambda row: row.rank_correlation)
        rose = f"{sum(row.rises for row in of_method)}/{steps * len(of_method)}"
        mean = fmean(row.rank_correlation for row in of_method)
        numbers = f"{mean:>7.3f}{minimum.rank_correlation:>7.3f}{rose:>9}"
        yield f"{'control':<18}{method:<9}{numbers}  {minimum.scene} {minimum.shot}"

"""The report of ``defocus bench``: an item for each shot by each method, beside the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_core.batch.lenses.lens import lens_words
from defocus_core.bench import tables
from defocus_core.bench.error import BASELINES, Row
from defocus_core.bench.truth_set import Pictures, TruthShot
from defocus_core.compare.picture import DecodedPicture
from defocus_core.reports.html.item import Column, Item, Layer, Report
from defocus_core.reports.html.layers import A, B, difference_of, draw, valued_layers
from defocus_core.reports.html.page import write_report
from defocus_core.system.text import command_line

if TYPE_CHECKING:
    from torch import Tensor

_COLUMNS = (
    Column("psnr", "PSNR", "dB", high=True),
    Column("psnr_edges", "edges", "dB", high=True),
    Column("ssim", "SSIM", high=True),
    Column("rel_rmse", "relRMSE"),
    Column("seconds", "seconds", "s"),
)
_OK, _WORSE = "ok", "worse"


class Gallery:
    """Pictures of shots, drawn as soon as they are rendered, since not all fit into memory."""

    def __init__(self) -> None:
        self._drawings: dict[tuple[str, str, str], tuple[list[Layer], float, str]] = {}

    def add(self, shot: TruthShot, pictures: Pictures, method: str, picture: Tensor) -> None:
        """Draw what a method made of a shot, its difference from the truth, and the CoC.

        `picture`: [3, H, W], linear.
        """
        radius = pictures.signed_radius.numpy()
        drawn = [
            draw(
                key, title, _picture(dict(zip("RGB", values.numpy(), strict=True))), ("R", "G", "B")
            )
            for key, title, values in ((A, "truth", pictures.truth), (B, method, picture))
        ]
        difference, full = difference_of(*drawn)
        drawn += [] if difference is None else [difference]
        drawn.append(draw("coc", "coc", _picture({"coc": radius}), ("coc",)))
        is_baseline = method in BASELINES
        layers = [each.layer for each in drawn] if is_baseline else valued_layers(drawn)
        self._drawings[shot.scene, shot.name, method] = layers, full, lens_words(shot.lens)

    def write(self, path: Path, truth: Path, rows: Sequence[Row]) -> None:
        """Write the report, rows that lose to a baseline first, then by their PSNR."""
        losses = {id(row): tables.loss_words(row, rows) for row in rows}

        def rank(row: Row) -> tuple[bool, bool, float]:
            return not losses[id(row)], row.method in BASELINES, row.errors.psnr

        items = [self._item(row, losses[id(row)], truth) for row in sorted(rows, key=rank)]
        words = ["A: what a thin lens photographs (truth)", "B: what the method makes of it"]
        write_report(path, Report(f"Errors on {truth}", words, items, _COLUMNS))

    def _item(self, row: Row, losses: Sequence[str], truth: Path) -> Item:
        layers, full, lens = self._drawings[row.scene, row.shot, row.method]
        words = ["defocus", "bench", "‹truth›", truth]
        if row.method not in BASELINES:
            words += ["‹quality›", row.method]
        return Item(
            name=f"{row.scene} {row.shot} {row.method}",
            status=_WORSE if losses else _OK,
            passes=not losses,
            words="; ".join(losses),
            facts=[(name, f"{value:.6g}") for name, value in _numbers(row).items()],
            metrics=_numbers(row),
            facets={"method": row.method, "scene": row.scene, "lens": lens},
            commands=[("Measure again", command_line(words))],
            layers=layers,
            full=full,
        )


def _numbers(row: Row) -> Mapping[str, float]:
    values: Mapping[str, Any] = tables.record(row)
    return {k: float(v) for k, v in values.items() if isinstance(v, int | float)}


def _picture(planes: Mapping[str, Any]) -> DecodedPicture:
    height, width = next(iter(planes.values())).shape
    return DecodedPicture(Path(), width, height, planes, dict.fromkeys(planes, "float"))

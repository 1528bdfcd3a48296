"""The HTML file of a report: a template filled with items, and payloads after them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from defocus_core.errors import printable
from defocus_core.reports.html import thumbnails
from defocus_core.reports.html.budget import fitted
from defocus_core.reports.html.item import Column, Item, Layer, Report
from defocus_core.reports.html.layers import DIFFERENCE, B
from defocus_core.reports.html.template import Payloads, write_page
from defocus_core.system.text import counted

_KEYS = (
    ("← → ↑ ↓", "previous or next item"),
    ("1 2", "first or second picture alone"),
    ("s", "slider between the two"),
    ("f", "flicker between the two"),
    ("d", "heat map of their difference"),
    ("w", "wiggle: left and right view in turn"),
    ("c", "CoC over the picture; again: other maps, none"),
    ("[ ]", "exposure down or up by half a stop"),
    ("+ − 0", "zoom in, zoom out, whole picture"),
    ("g", "go to the worst pixel"),
    ("space", "play the items as a film"),
    ("/", "filter"),
    ("?", "this help"),
)
# How a status looks: well, to be looked at, or bad.
_TONES = {"same": "good", "done": "good", "ok": "good", "warning": "fair"}


def write_report(path: Path, report: Report) -> None:
    """Write the HTML file of a report, whole or not at all."""
    items = fitted(report.items)
    payloads = Payloads()
    drawn = [_item(item, payloads) for item in items]
    counts = Counter(item.status for item in items)
    write_page(
        path,
        "report",
        data={"items": drawn, **_constants()},
        payloads=payloads,
        title=printable(report.title),
        report=_printed(report, items),
        counts=sorted(counts.items(), key=lambda each: _first(items, each[0])),
        tones={item.status: _TONES.get(item.status, "bad") for item in items},
        facets=_facets(items),
        pictures=[list(_row_pictures(item)) for item in drawn],
        numbers=_number,
        keys=_KEYS,
    )


def _printed(report: Report, items: Sequence[Item]) -> dict[str, Any]:
    """The report as the template has it, each text without control characters."""
    valued = sum(any(layer.halves for layer in item.layers) for item in items)
    pictured = sum(any(layer.thumbnail for layer in item.layers) for item in items)
    words = [*map(printable, report.words)]
    words.append(
        f"{counted(len(items), 'item')}: values of the first {valued} in their order, as half "
        f"floats; thumbnails of {pictured}. The file has room for no more."
        if valued < len(items)
        else f"{counted(len(items), 'item')}, each with its values as half floats."
    )
    rows = [
        {
            "name": printable(item.name),
            "status": item.status,
            "words": printable(item.words),
            "metrics": item.metrics,
            "facets": {name: printable(value) for name, value in item.facets.items()},
        }
        for item in items
    ]
    return {
        "words": words,
        "columns": report.columns,
        "tables": [
            {
                "title": printable(table.title),
                "heading": table.heading,
                "rows": [[printable(cell) for cell in row] for row in table.rows],
            }
            for table in report.tables
        ],
        "rows": rows,
    }


def _item(item: Item, payloads: Payloads) -> dict[str, Any]:
    """An item as the script has it."""
    layers = [_layer(layer, payloads) for layer in item.layers]
    return {
        "name": printable(item.name),
        "status": item.status,
        "passes": item.passes,
        "words": printable(item.words),
        "facts": [[term, printable(text)] for term, text in item.facts],
        "metrics": {name: _plain(value) for name, value in item.metrics.items()},
        "facets": {name: printable(value) for name, value in item.facets.items()},
        "commands": [list(each) for each in item.commands],
        "layers": layers,
        "wiggle": list(item.wiggle),
        "full": item.full,
        "place": item.place,
        "depth": item.depth and {**item.depth._asdict(), "shot": printable(item.depth.shot)},
    }


def _layer(layer: Layer, payloads: Payloads) -> dict[str, Any]:
    values = layer.halves
    return {
        "key": layer.key,
        "title": layer.title,
        "kind": layer.kind,
        "channels": list(layer.channels),
        "size": layer.size,
        "gamma": layer.gamma,
        "ends": layer.value_range,
        "type": layer.type,
        "thumbnail": payloads.add(layer.thumbnail),
        "values": values
        and {
            "payload": payloads.add(values.data),
            "corner": values.corner,
            "size": values.size,
            "scale": values.scale,
            "base": values.base,
        },
    }


def _row_pictures(item: Mapping[str, Any]) -> Iterator[str]:
    """Payloads of the pictures of a row: of B, a rendering or what is first; the difference."""
    by_key = {layer["key"]: layer["thumbnail"] for layer in item["layers"]}
    first = by_key.get(B) or by_key.get("render") or next(filter(None, by_key.values()), "")
    yield from filter(None, (first, by_key.get(DIFFERENCE, "")))


def _facets(items: Sequence[Item]) -> list[tuple[str, list[str]]]:
    """Names of facets, and the values of each."""
    names = dict.fromkeys(name for item in items for name in item.facets)
    return [
        (name, sorted({printable(item.facets[name]) for item in items if name in item.facets}))
        for name in names
    ]


def _constants() -> dict[str, Any]:
    return {
        "heats": thumbnails.HEATS,
        "signed": thumbnails.SIGNED_COLORS,
        "nonfinite": thumbnails.NONFINITE,
    }


def _number(item: Mapping[str, Any], column: Column) -> str:
    value = item["metrics"].get(column.name)
    return "" if value is None else f"{value:.4g}"


def _plain(value: float) -> float | str:
    """A number of JSON, or the name that the script gives to one that JSON has not."""
    if math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"


def _first(items: Sequence[Item], status: str) -> int:
    return next(n for n, item in enumerate(items) if item.status == status)

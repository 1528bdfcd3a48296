"""A page of one HTML file: a template with its style and its script, data, and payloads after them.

Nothing is loaded: the style, the script and all pictures are in the file. What comes from names of
files is escaped, and the browser runs no script but ours (by its hash, Content-Security-Policy).
What pages share is in ``templates/page.*``.

A file has a bounded size: thumbnails of the first two layers and their difference come first, up to
a half of the room; then the values of the items in their order, each with all its layers; then the
other thumbnails.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from defocus_core.errors import printable, with_dashes
from defocus_core.io.safe_files import written_whole
from defocus_core.reports.html import thumbnails
from defocus_core.reports.html.item import Column, Item, Layer, Report
from defocus_core.reports.html.layers import DIFFERENCE, WHOLE, B
from defocus_core.reports.replaceable import refuse_other
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
ROOM = 38_500_000  # characters of items; the file is to have less than 40 MB
_FRAME = 1500  # characters of an item beside its texts: names of layers, elements of the table
_PACKED = 1.0  # halves that a character holds at most, where B is like A
_THUMBNAILS = 30_000  # characters of the thumbnails of an item


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


def length(data: bytes) -> int:
    """Characters of base64."""
    return -(-len(data) // 3) * 4


class ValuesRoom:
    """The room that so many items leave for values, as a guess before they are drawn."""

    def __init__(self, items: int) -> None:
        self.left = float(ROOM - min(ROOM // 2, items * _THUMBNAILS))

    def takes(self, size: Sequence[int], planes: int) -> bool:
        """Whether there may be room for the values of an item of (width, height) px."""
        wanted = self.left > 0
        self.left -= wanted * min(math.prod(size), WHOLE) * planes / _PACKED
        return wanted


def _thumbnails(item: Item, *, first: bool) -> int:
    own = (each for each in item.layers if _is_first(item, each) == first)
    return sum(length(each.thumbnail) for each in own)


def _is_first(item: Item, layer: Layer) -> bool:
    """Whether a layer is one of the two that are shown at first, or their difference."""
    return layer.key == DIFFERENCE or layer in item.layers[:2]


def _values(item: Item) -> int:
    return sum(length(each.halves.data) for each in item.layers if each.halves)


class ByteBudget:
    """Room that is spent on items in their order."""

    def __init__(self, room: int) -> None:
        self.room = room

    def spend(self, costs: Iterable[int]) -> set[int]:
        """Numbers of the items that fit; one that does not lets smaller ones come after it."""
        fitting = set()
        for number, cost in enumerate(costs):
            if 0 < cost <= self.room:
                self.room -= cost
                fitting.add(number)
        return fitting


def fitted(items: Sequence[Item]) -> list[Item]:
    """The items without the payloads that there is no room for."""
    room = ROOM - sum(map(_text, items))
    budget = ByteBudget(room // 2)
    shown = budget.spend(_thumbnails(item, first=True) for item in items)
    budget.room += room - room // 2
    valued = budget.spend(_values(item) + bool(_values(item)) * _rest(item) for item in items)
    beside = budget.spend(0 if n in valued else _rest(item) for n, item in enumerate(items))
    beside |= valued

    return [
        replace(
            item,
            layers=_present(item, first=n in shown, others=n in beside, values=n in valued),
        )
        for n, item in enumerate(items)
    ]


def _text(item: Item) -> int:
    """Characters of the texts of an item, of which its name and words stand there twice."""
    texts = [*(text for pair in (*item.facts, *item.commands) for text in pair)]
    return _FRAME + 2 * len(item.name + item.words) + sum(map(len, texts))


def _rest(item: Item) -> int:
    return _thumbnails(item, first=False)


def _present(item: Item, *, first: bool, others: bool, values: bool) -> list[Layer]:
    """The layers that have something to show."""
    layers = []
    for layer in item.layers:
        stays = first if _is_first(item, layer) else others
        thumbnail = layer.thumbnail if stays else b""
        layers.append(replace(layer, thumbnail=thumbnail, halves=layer.halves if values else None))
    return [layer for layer in layers if layer.thumbnail or layer.halves]


class Payloads:
    """Base64 of pictures and values by the name of its element."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}

    def add(self, data: bytes) -> str:
        """The name of the element with some bytes; empty if there are none."""
        if not data:
            return ""
        name = f"p{len(self.texts)}"
        self.texts[name] = base64.b64encode(data).decode("ascii")
        return name


def write_page(path: Path, name: str, *, data: object, payloads: Payloads, **values: Any) -> None:
    """Write the page of a template, whole or not at all."""
    import jinja2

    folder = files("defocus_core.reports.html") / "templates"

    def source(file: str) -> str:
        return (folder / file).read_text("utf-8")

    style, script = (source(f"page.{kind}") + source(f"{name}.{kind}") for kind in ("css", "js"))
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(source),
        autoescape=True,
        trim_blocks=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    safe = environment.filters["safe"]
    parts = environment.get_template(f"{name}.html").generate(
        style=safe(style),
        style_hash=_hash(style),
        script=safe(script),
        script_hash=_hash(script),
        data=safe(_in_script(data)),
        payloads=payloads.texts.items(),
        **values,
    )
    refuse_other(path, "html")
    with written_whole(path) as file:
        for part in parts:
            file.write(with_dashes(part).encode("utf-8", "replace"))


def _in_script(value: object) -> str:
    """JSON that cannot end the element it stands in."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))  # ASCII alone
    text = with_dashes(text.replace("\\u2039", "‹").replace("\\u203a", "›"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()

"""A page in one HTML file: a template with style and script, then data, then payloads.

A payload is a picture or the values of a layer, in base64.

The page loads nothing: style, script and all pictures are in the file. Names of files are escaped,
and the browser runs only our script (by its hash, Content-Security-Policy). ``templates/page.*``
has the common parts of pages, ``viewer.js`` the viewer of pictures.

The size of a file is limited to `ROOM`: half of it is for thumbnails of the items, in their order,
and the rest for values.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from defocus_core.errors import printable, with_dashes
from defocus_core.io.write_files import require_replaceable, written_whole
from defocus_core.reports.html import thumbnails
from defocus_core.reports.html.item import Item, Layer
from defocus_core.reports.html.layers import DIFFERENCE, B
from defocus_core.system.text import counted

# Keys of every page, and those of a report, with what they do.
KEYS = (
    ("1 2", "first or second picture alone"),
    ("s", "slider between the two"),
    ("f", "flicker between the two"),
    ("d", "heat map of their difference"),
    ("[ ]", "exposure down or up by half a stop"),
    ("+ − 0", "zoom in, zoom out, whole picture"),
    ("?", "this help"),
)
_REPORT_KEYS = (
    ("← → ↑ ↓", "previous or next item"),
    ("g", "go to the worst pixel"),
    ("space", "play the items as a film"),
    ("/", "filter"),
)
# The look of a status: good, warning or bad.
_TONES = {"same": "good", "warning": "fair"}
ROOM = 38_500_000  # characters of items, for a file of less than 40 MB
_FRAME = 1500  # characters of an item besides its texts: names of layers, elements of the table
THUMBNAILS = 30_000  # characters of the thumbnails of an item


def write_report(
    path: Path,
    items: Sequence[Item],
    columns: Sequence[Mapping[str, Any]],
    *,
    title: str,
    words: Sequence[str],
    accept: str,
) -> None:
    """Write the HTML file of a report, whole or not at all.

    `items`: the most important first. `columns`: name, title and metric of each column of numbers.
    `words`: lines on what was compared. `accept`: the beginning of the command that accepts the
    ticked items; empty for none.
    """
    items = fitted(items)
    payloads: dict[str, str] = {}
    drawn = [plain(item, payloads) for item in items]
    write_page(
        path,
        "report",
        data={"items": drawn, "accept": printable(accept)},
        payloads=payloads,
        title=printable(title),
        words=[*map(printable, words), _room_words(items)],
        columns=columns,
        rows=drawn,
        counts=Counter(item.status for item in items).items(),
        tones={item.status: _TONES.get(item.status, "bad") for item in items},
        pictures=[_row_pictures(item) for item in drawn],
        number=lambda value: value if isinstance(value, str) else f"{value:.4g}",
        keys=_REPORT_KEYS + KEYS,
    )


def _room_words(items: Sequence[Item]) -> str:
    """A sentence on how many items have thumbnails and values."""
    valued = sum(any(layer.values for layer in item.layers) for item in items)
    pictured = sum(any(layer.thumbnail for layer in item.layers) for item in items)
    if valued == len(items):
        return f"{counted(len(items), 'item')}, each with its values."
    return (
        f"{counted(len(items), 'item')}: values of the first {valued} in their order, "
        f"thumbnails of {pictured}. The file has room for no more."
    )


def plain(value: Any, payloads: dict[str, str]) -> Any:
    """A record as values that JSON has: a dictionary of its fields.

    Control characters in texts are removed. Bytes are added to `payloads`, in base64, and become
    their name there (empty for no bytes). NaN and infinity become the texts NaN, Infinity and
    -Infinity.
    """
    if is_dataclass(value):
        return {each.name: plain(getattr(value, each.name), payloads) for each in fields(value)}
    if hasattr(value, "_asdict"):
        return plain(value._asdict(), payloads)
    if isinstance(value, Mapping):
        return {key: plain(each, payloads) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each, payloads) for each in value]
    if isinstance(value, bytes):
        name = f"p{len(payloads)}" if value else ""
        payloads |= {name: base64.b64encode(value).decode("ascii")} if value else {}
        return name
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def _row_pictures(item: Mapping[str, Any]) -> list[str]:
    """Names of the payloads shown in a row: B, or else the first layer, and the difference."""
    by_key = {layer["key"]: layer["thumbnail"] for layer in item["layers"]}
    first = by_key.get(B) or next(filter(None, by_key.values()), "")
    return [*filter(None, (first, by_key.get(DIFFERENCE, "")))]


def length(data: bytes) -> int:
    """The number of characters of data in base64."""
    return -(-len(data) // 3) * 4


def fitted(items: Sequence[Item], room: int = ROOM) -> list[Item]:
    """The items, without those payloads that do not fit into `room` characters."""
    room -= sum(map(text_room, items))
    thumbnails = [sum(length(layer.thumbnail) for layer in item.layers) for item in items]
    values = [
        sum(length(layer.values.payload) for layer in item.layers if layer.values) for item in items
    ]
    pictured, left = _fitting(thumbnails, room // 2)
    valued, _ = _fitting(values, room - room // 2 + left)
    return [
        replace(item, layers=_kept(item.layers, thumbnail=n in pictured, values=n in valued))
        for n, item in enumerate(items)
    ]


def _fitting(costs: Sequence[int], room: int) -> tuple[set[int], int]:
    """The indices of the costs that fit, one after another; then the room that is left.

    A cost that is too large is skipped, and later ones may fit.
    """
    fitting = set[int]()
    for number, cost in enumerate(costs):
        if cost <= room:
            fitting.add(number)
            room -= cost
    return fitting, room


def _kept(layers: Sequence[Layer], *, thumbnail: bool, values: bool) -> list[Layer]:
    """The layers with thumbnails, values or both, as asked; those with neither are left out."""
    kept = (
        replace(
            layer,
            thumbnail=layer.thumbnail if thumbnail else b"",
            values=layer.values if values else None,
        )
        for layer in layers
    )
    return [layer for layer in kept if layer.thumbnail or layer.values]


def text_room(item: Item) -> int:
    """The number of characters that the texts of an item take; name and words occur twice."""
    texts = [*(text for pair in (*item.facts, *item.commands) for text in pair)]
    return _FRAME + 2 * len(item.name + item.words) + sum(map(len, texts))


def write_page(
    path: Path, name: str, *, data: Mapping[str, Any], payloads: dict[str, str], **values: Any
) -> None:
    """Write the page of the template `name`, whole or not at all.

    `data`: what the script of the page gets. `values`: what the template gets.
    """
    import jinja2

    folder = files("defocus_core.reports.html") / "templates"

    def source(file: str) -> str:
        return (folder / file).read_text("utf-8")

    style, script = source("page.css"), source("viewer.js") + source(f"{name}.js")
    colors = {
        "heats": thumbnails.HEATS,
        "signed": thumbnails.SIGNED_COLORS,
        "nonfinite": thumbnails.NONFINITE,
    }
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(source),
        autoescape=True,
        trim_blocks=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
    )
    safe = environment.filters["safe"]
    # JSON in ASCII that cannot end the element around it
    text = json.dumps({**data, **colors}, allow_nan=False, separators=(",", ":"))
    text = with_dashes(text.replace("\\u2039", "‹").replace("\\u203a", "›"))
    for letter in "&<>":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    parts = environment.get_template(f"{name}.html").generate(
        style=safe(style),
        style_hash=_hash(style),
        script=safe(script),
        script_hash=_hash(script),
        data=safe(text),
        payloads=payloads.items(),
        **values,
    )
    require_replaceable(path, "html")
    with written_whole(path) as file:
        for part in parts:
            file.write(with_dashes(part).encode("utf-8", "replace"))


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()

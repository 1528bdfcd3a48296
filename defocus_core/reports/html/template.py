"""A page of one HTML file: a template with its style and its script, data, and payloads after them.

Nothing is loaded: the style, the script and all pictures are in the file. What comes from names of
files is escaped, and the browser runs no script but ours (by its hash, Content-Security-Policy).
What pages share is in ``templates/page.*``.
"""

from __future__ import annotations

import base64
import hashlib
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from defocus_core.errors import with_dashes
from defocus_core.io.safe_files import written_whole
from defocus_core.reports.replaceable import refuse_other


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

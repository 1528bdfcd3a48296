"""Options of the rows of a table, whose values are texts that the resolver reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from defocus_cli.options.types import Decorator, FilePath, option
from defocus_core.errors import CALLER, with_dashes
from defocus_core.request.parameters import Param
from defocus_core.request.quantities import read_at
from defocus_core.request.resolver import Given, Layer, refuse_contradiction, value_of


def param_option(param: Param, text: str = "") -> Decorator:
    """The option of a row of a table of options, whose value is a text or a path.

    `text`: what it does, if not what the row says.
    """
    settings: dict[str, Any] = {"heading": param.heading, "is_common": param.is_common}
    spelling = f"--{param.name} {param.metavar}"
    if param.toggle:
        spelling = f"--{param.name}/--no-{param.name}"
    elif not param.flag:
        spelling += f"[{'|'.join(param.choices)}]" if param.choices else ""
        settings["kind"] = FilePath() if param.is_path else click.STRING
        settings |= {"multiple": True} if param.multiple else {"nargs": param.words}
    if not param.multiple:
        settings["default"] = None
    return option(spelling, with_dashes(text or param.help), **settings)


def given_options(values: Mapping[str, Any], rows: Mapping[str, Param]) -> Layer:
    """The options of rows that are given, of the values of parameters."""
    layer = {}
    for name, row in rows.items():
        value = values.get(name.replace("-", "_"))
        if value is not None and (value is not False or row.toggle):
            text = " ".join(value) if isinstance(value, tuple) else str(value)
            text = {True: "on", False: "off"}[value] if row.toggle else text
            read_at(CALLER.at(name), value_of, name, text)
            layer[name] = Given(text, CALLER.at(name))
    refuse_contradiction(layer)
    return layer

"""Options of the rows of a table, whose values are texts that the resolver reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from defocus_cli.options.types import Decorator, option, position_of
from defocus_core.errors import CALLER, with_dashes
from defocus_core.request.parameters import Param
from defocus_core.request.quantities import read_at
from defocus_core.request.resolver import Given, Layer, refuse_contradiction, value_of


class OptionText(click.ParamType[str]):
    """The text of an option of a table, once it makes sense by itself."""

    def __init__(self, name: str, metavar: str) -> None:
        self.option = name
        self.name = metavar

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The text as it is."""
        read_at(position_of(param), value_of, self.option, value)
        return str(value)


def param_option(heading: str, param: Param, default: str | None = None) -> Decorator:
    """The option of a row of a table of options, whose value is a text."""
    settings: dict[str, Any] = {"heading": heading, "is_common": param.is_common}
    kind: click.ParamType[str] | None = None
    spelling = f"--{param.name} {param.metavar}"
    if param.toggle:
        spelling, settings["default"] = f"--{param.name}/--no-{param.name}", None
    elif param.words > 1:
        kind, settings["nargs"] = click.STRING, param.words
    elif not param.flag:
        kind = OptionText(param.name, param.metavar)
        spelling += f"[{'|'.join(param.choices)}]" if param.choices else ""
    return option(spelling, with_dashes(param.help), kind, **{"default": default, **settings})


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

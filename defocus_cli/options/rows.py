"""Options of the rows of a table, whose values are texts that the resolver reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from defocus_cli.options.types import Decorator, GroupedOption, position_of
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


def param_option(heading: str, param: Param) -> Decorator:
    """The option of a row of a table of options, whose value is a text."""
    metavar = param.metavar or (f"[{'|'.join(param.choices)}]" if param.choices else None)
    settings: dict[str, Any] = {"help": with_dashes(param.help), "is_common": param.is_common}
    if param.flag or param.toggle:
        settings |= {"is_flag": True, "default": None if param.toggle else False}
    elif param.words > 1:
        settings |= {"type": str, "nargs": param.words, "default": None}
    else:
        settings["type"] = OptionText(param.name, param.metavar)
    spelling = f"--{param.name}/--no-{param.name}" if param.toggle else f"--{param.name}"
    return click.option(spelling, cls=GroupedOption, heading=heading, metavar=metavar, **settings)


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

"""Reading options: what to take from colour and depth files, and what their numbers mean.

``@reading_options`` adds ``--depth-format``, … and hands the command ``reading: Reading``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import click

from defocus_cli.options.types import Command, Decorator, bundle, param_option
from defocus_core.request.job import Reading
from defocus_core.request.parameters import Param
from defocus_core.request.reading_options import READING_OPTIONS, lens_file_reading, make_reading


def reading_options(command: Command) -> Command:
    """Hand a command ``reading``: what to take from the input files, those of a lens file below."""
    return _bundle(READING_OPTIONS.values())(command)


def depth_reading_options(command: Command) -> Command:
    """Hand a command ``reading``: what to take from depth files alone."""
    return _bundle(row for row in READING_OPTIONS.values() if not row.of_pictures)(command)


def _bundle(rows: Iterable[Param]) -> Decorator:
    return bundle("reading", _make, [param_option("Files", row) for row in rows])


def _make(**fields: Any) -> Reading:
    file = click.get_current_context().params.get("lens_file")
    return make_reading(fields, lens_file_reading(file))

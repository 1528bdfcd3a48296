"""Reading options: what to take from colour and depth files, and what their numbers mean.

``@reading_options`` adds ``--depth-format``, … and hands the command ``reading: Reading``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import click

from defocus_cli.options.rows import given_options, param_option
from defocus_cli.options.types import Command, Decorator, bundle
from defocus_core.request.job import Reading
from defocus_core.request.lens_files import reading_in
from defocus_core.request.parameters import Param
from defocus_core.request.reading_options import READING_OPTIONS
from defocus_core.request.resolver import reading_of


def rendered_reading_options(command: Command) -> Command:
    """Hand a command ``reading``: what to take from files whose pictures are written."""
    return _bundle(READING_OPTIONS.values())(command)


def reading_options(command: Command) -> Command:
    """Hand a command ``reading``: what to take from the input files, those of a lens file below."""
    return _bundle(row for row in READING_OPTIONS.values() if not row.of_render)(command)


def depth_reading_options(command: Command) -> Command:
    """Hand a command ``reading``: what to take from depth files alone."""
    return _bundle(row for row in READING_OPTIONS.values() if not row.of_pictures)(command)


def asked_reading(**_: Any) -> Reading:
    """The reading that the options of the command, and of its lens file, ask for."""
    params = click.get_current_context().params
    return reading_of(reading_in(params.get("lens_file")), given_options(params, READING_OPTIONS))


def _bundle(rows: Iterable[Param]) -> Decorator:
    return bundle("reading", asked_reading, list(map(param_option, rows)))

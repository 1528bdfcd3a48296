"""Lens options: those of ``--lens FILE.toml`` and those given beside it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from defocus_cli.options.types import (
    Decorator,
    FilePath,
    bundle,
    lens_option,
    param_option,
    position_of,
)
from defocus_core.request.lens import Lens
from defocus_core.request.lens_from_options import lens_path, make_lens
from defocus_core.request.parameters import LENS_OPTIONS, OPENING


class LensFile(FilePath):
    """The path of a lens file, or @NAME of one that ships."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path of the file."""
        return lens_path(super().convert(value, param, ctx), position_of(param))


def _lens_file_option() -> Decorator:
    text = (
        'File of lens options, like focal-length = "50mm", or @NAME of one that ships '
        "('defocus lenses'); what is given beside it wins. For 'render', also a folder of a file "
        "for each picture, as 'defocus fit' writes it."
    )
    kind = LensFile()
    return lens_option("--lens FILE.toml", text, kind, into="lens_file")


def lens_decorators() -> list[Decorator]:
    """The options of a lens, and the one of a lens file."""
    return [*_options_of(LENS_OPTIONS), _lens_file_option()]


def _options_of(names: Iterable[str]) -> list[Decorator]:
    return [param_option("Lens", LENS_OPTIONS[name]) for name in names]


def opening_options() -> Decorator:
    """Hand a command ``lens``: its opening and its photodiodes, and no more of a lens."""

    def make(lens_file: Path | None, **values: Any) -> Lens:
        flags = {name.replace("_", "-"): value for name, value in values.items()}
        return make_lens(flags, lens_file, radii=True)

    return bundle("lens", make, [*_options_of(OPENING), _lens_file_option()])

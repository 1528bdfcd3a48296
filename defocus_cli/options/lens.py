"""Lens options: those of ``--lens FILE.toml`` and those given beside it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from defocus_cli.options.rows import given_options, param_option
from defocus_cli.options.types import (
    Decorator,
    FilePath,
    bundle,
    lens_option,
    position_of,
)
from defocus_core.errors import CALLER
from defocus_core.request.lens import Lens
from defocus_core.request.lens_files import lens_path, read_lens_file
from defocus_core.request.parameters import LENS_OPTIONS, OPENING, SHAPES
from defocus_core.request.resolver import check_lens, laid_over, lens_of


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
    return lens_option("--lens FILE.toml", text, kind, into="lens_file", is_common=True)


def lens_decorators(names: Iterable[str]) -> list[Decorator]:
    """Options of a lens, and the one of a lens file."""
    return [*_options_of(names), _lens_file_option()]


def _options_of(names: Iterable[str]) -> list[Decorator]:
    return [param_option(LENS_OPTIONS[name]) for name in names]


def opening_options() -> Decorator:
    """Hand a command ``lens``: its opening and its photodiodes, and no more of a lens."""

    def make(lens_file: Path | None, **values: Any) -> Lens:
        stored = read_lens_file(lens_file) if lens_file else {}
        shape = {name: each for name, each in stored.items() if name in SHAPES}
        options = laid_over(shape, given_options(values, LENS_OPTIONS))
        check_lens(options, CALLER, radii=True)
        return lens_of(options)

    return bundle("lens", make, lens_decorators(OPENING))

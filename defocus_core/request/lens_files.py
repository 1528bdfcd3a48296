"""Lens files: TOML files with options of a lens and of reading; some ship with the package."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

from defocus_core.errors import Place, UsageProblem, did_you_mean
from defocus_core.request.job_options import READING_OPTIONS
from defocus_core.request.parameters import BESIDE_BLUR, LENS_OPTIONS, OPENING
from defocus_core.request.resolver import Given, Layer, layer_of
from defocus_core.request.toml_file import read_toml, refuse_unknown
from defocus_core.system.text import note

MARK = "@"


def read_lens_file(file: Path | None, wanted: Container[str] = LENS_OPTIONS) -> dict[str, Given]:
    """The options in a lens file whose names are in `wanted`; empty if `file` is None."""
    if file is None:
        return {}
    remedy = 'give a TOML file, with lines like focal-length = "50mm"'
    stored = read_toml(file, what="lens file", remedy=remedy)
    rows = {**LENS_OPTIONS, **READING_OPTIONS}
    refuse_unknown(stored, tuple(rows), file, "a lens file")
    layer = layer_of(stored, rows, Place(file).with_field)
    return {name: each for name, each in layer.items() if name in wanted}


def lens_in(file: Path, where: Place, *, in_pixels: bool, radii: bool) -> Layer:
    """The options in a lens file, unless they conflict with blur radii that are given otherwise.

    With `in_pixels`, another option gives the blur, and options of the file that decide radii raise
    UsageProblem at `where`. With `radii`, input files hold radii; such options are left out.
    """
    stored = read_lens_file(file)
    if "blur" in stored:
        return stored
    if in_pixels:
        if optics := [name for name in stored if name not in BESIDE_BLUR]:
            problem = f"{file.name} has {', '.join(optics)}, which a blur in pixels replaces"
            opening = " ".join(f"‹{n}› {stored[n].text}" for n in OPENING if n in stored)
            remedy = f"leave it out; for its aperture give {opening}" if opening else "leave it out"
            raise UsageProblem("contradiction", problem, remedy, path=where)
    elif radii and (idle := [name for name in stored if LENS_OPTIONS[name].is_optics]):
        note(f"defocus: {file}: {', '.join(idle)} left out: the depth files hold the radii")
        return {name: each for name, each in stored.items() if name not in idle}
    return stored


@dataclass(frozen=True)
class ShippedLens:
    """A lens file that is part of the package."""

    name: str  # as for ``--lens``, with the @
    path: Path
    subject: str  # the first line of the file


@cache
def shipped_lenses() -> tuple[ShippedLens, ...]:
    """The lens files that are part of the package, sorted by name."""
    folder = Path(str(files("defocus_core.request"))) / "lenses"
    return tuple(
        ShippedLens(f"{MARK}{path.stem}", path, text.splitlines()[0].removeprefix("# "))
        for path in sorted(folder.glob("*.toml"))
        for text in [path.read_text(encoding="utf-8")]
    )


def lens_path(path: Path, where: Place) -> Path:
    """The path of a lens file, given as a path or as the name of a shipped lens.

    Names of shipped lenses begin with @, like ``@portrait-85``; ``where`` is the place for errors.
    """
    known = {lens.name: lens.path for lens in shipped_lenses()}
    if not str(path).startswith(MARK):
        if not path.exists() and f"{MARK}{path}" in known:
            problem, remedy = f"no file {path}", f"did you mean {MARK}{path}?"
            raise UsageProblem("unknown-name", problem, remedy, path=where)
        return path
    if str(path) in known:
        return known[str(path)]
    remedy = did_you_mean(str(path), tuple(known), "see 'defocus lenses'")
    raise UsageProblem("unknown-name", f"no lens {path} ships with defocus", remedy, path=where)

"""Lens files that ship, by the names that begin with @."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

from defocus_core.errors import Place, UsageProblem, did_you_mean

MARK = "@"


@dataclass(frozen=True)
class ShippedLens:
    """A lens file that ships."""

    name: str  # as ``--lens`` takes it, with the mark
    path: Path
    subject: str  # its first line, in words


@cache
def shipped_lenses() -> tuple[ShippedLens, ...]:
    """The lens files that ship, sorted by name."""
    folder = Path(str(files("defocus_core.batch.lenses")))
    return tuple(
        ShippedLens(f"{MARK}{path.stem}", path, _subject(path))
        for path in sorted(folder.glob("*.toml"))
    )


def lens_path(path: Path, where: Place) -> Path:
    """The lens file of a path, or of a name like ``@portrait-85``."""
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


def _subject(path: Path) -> str:
    return path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")

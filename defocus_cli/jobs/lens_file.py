"""The lens asked for: command-line options over those of a TOML file.

A lens file holds the lens options under their names, with the units they have on the command line::

    focal-length = "50mm"
    fnumber = 1.4
    focus = "2m"
    blades = 6
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from defocus_cli.jobs import quantities
from defocus_cli.jobs.job import Lens
from defocus_cli.jobs.lens_options import (
    ALTERNATIVES,
    EXAMPLES,
    merged,
    parsed,
    refuse_both,
    refuse_idle_turn,
    refuse_unknown,
    text_of,
)
from defocus_cli.jobs.reading_options import NAMES_OF_OPTIONS
from defocus_cli.jobs.toml_file import read_toml
from defocus_cli.system.errors import UsageProblem


def make_lens(flags: Mapping[str, Any], file: Path | None) -> Lens:
    """The lens that flags and a lens file describe together; flags win.

    Args:
        flags: option name (``focal-length``, …) to parsed value; absent or None where not given.
        file: a lens file, if there is one.

    Raises:
        InputError: the file cannot be read as TOML.
        UsageProblem: an option is missing, contradicts another or makes no sense.
    """
    given = {name: value for name, value in flags.items() if value is not None}
    refuse_both(given)
    stored = {} if file is None else read_lens_file(file)
    values = merged(stored, given)
    for name, other in (("focal-length", None), *ALTERNATIVES):
        if name not in values and other not in values:
            raise UsageProblem(
                f"--{name}", "is missing", f"add {_how(name, other)}, or a --lens FILE that has it"
            )
    where = "" if "blade-rotation" in given else f"{file}: "
    refuse_idle_turn(values.get("blade-rotation"), values.get("blades"), where)
    source = "--" if {"focus", "focus-at"} & given.keys() else f"{file}: "
    lens = lens_of(values, source)
    if lens.foc_dist is not None:
        refuse_near_focus(lens.foc_dist, lens.foclen, f"{source}focus")
    return lens


def lens_of(values: Mapping[str, Any], source: str = "") -> Lens:
    """The lens of parsed options, of which none is missing and none contradicts another.

    Args:
        values: the options.
        source: who says where its focus is, as `Lens` has it.
    """
    foclen, focus = values["focal-length"], values.get("focus")
    fnum = values["fnumber"] if "fnumber" in values else foclen / values["aperture-diameter"]
    percentile = focus.percent if isinstance(focus, quantities.Percentile) else None
    return Lens(
        foclen=foclen,
        fnum=fnum,
        foc_dist=focus if percentile is None else None,
        focus_at=values.get("focus-at"),
        sensor_width=values.get("sensor-width", Lens.sensor_width),
        blades=values.get("blades", Lens.blades),
        blade_rotation=values.get("blade-rotation", Lens.blade_rotation),
        focus_percentile=percentile,
        focus_source=source,
    )


def read_lens_file(file: Path) -> dict[str, Any]:
    """Names and parsed values of the lens options of a lens file, which may have reading options.

    Raises:
        InputError: the file cannot be read as TOML.
        UsageProblem: a key is unknown or its value makes no sense.
    """
    remedy = 'give a TOML file, with lines like focal-length = "50mm"'
    stored = read_toml(file, what="lens file", remedy=remedy)
    own = {name: value for name, value in stored.items() if name not in NAMES_OF_OPTIONS}
    values = {name: _parsed(name, value, file) for name, value in own.items()}
    refuse_both(values, f"{file}: ")
    return values


def refuse_near_focus(foc_dist: float, foclen: float, source: str) -> None:
    """Raise UsageProblem, naming ``source``, unless a lens of ``foclen`` can focus there (mm)."""
    if foc_dist <= foclen:
        text = quantities.length_text
        raise UsageProblem(
            source,
            f"{text(foc_dist)} is not farther than the focal length {text(foclen)}",
            "focus farther away than that, or give a shorter focal length",
        )


def _parsed(name: str, value: object, file: Path) -> Any:
    refuse_unknown(name, file, "a lens file")
    try:
        return parsed(name, text_of(value))
    except quantities.QuantityError as error:
        raise UsageProblem(f"{file}: {name}", error.problem, error.remedy) from None


def _how(name: str, other: str | None) -> str:
    example = f"--{name} {EXAMPLES[name]}"
    return f"{example} or --{other}" if other else example

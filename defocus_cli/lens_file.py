"""The lens asked for: options of the command line over those of a TOML file.

A lens file holds the lens options under their names, with the units they have on the command line::

    focal-length = "50mm"
    fnumber = 1.4
    focus = "2m"
    blades = 6
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from defocus_cli import quantities
from defocus_cli.errors import InputError, UsageProblem, did_you_mean, reason
from defocus_cli.job import Lens

PARSERS: dict[str, Callable[[str], Any]] = {
    "focal-length": quantities.length,
    "fnumber": quantities.fnumber,
    "aperture-diameter": quantities.length,
    "sensor-width": quantities.length,
    "focus": quantities.focus,
    "focus-at": quantities.pixel,
    "blades": quantities.blades,
    "blade-rotation": quantities.angle,
}
LARGEST_FILE = 2**20  # bytes
_ALTERNATIVES = (("fnumber", "aperture-diameter"), ("focus", "focus-at"))
_EXAMPLES = {"focal-length": "50mm", "fnumber": "1.4", "focus": "2m"}


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
    _refuse_both(given)
    stored = {} if file is None else read_lens_file(file)
    for pair in _ALTERNATIVES:
        if any(name in given for name in pair):
            stored = {name: value for name, value in stored.items() if name not in pair}
    values = stored | given
    for name, other in (("focal-length", None), *_ALTERNATIVES):
        if name not in values and other not in values:
            raise UsageProblem(
                f"--{name}", "is missing", f"add {_how(name, other)}, or a --lens FILE that has it"
            )
    lens = Lens(
        foclen=values["focal-length"],
        fnum=values["fnumber"]
        if "fnumber" in values
        else values["focal-length"] / values["aperture-diameter"],
        foc_dist=values.get("focus"),
        focus_at=values.get("focus-at"),
        sensor_width=values.get("sensor-width", Lens.sensor_width),
        blades=values.get("blades", Lens.blades),
        blade_rotation=values.get("blade-rotation", Lens.blade_rotation),
    )
    if lens.foc_dist is not None:
        source = "--focus" if "focus" in given else f"{file}: focus"
        refuse_near_focus(lens.foc_dist, lens.foclen, source)
    return lens


def read_lens_file(file: Path) -> dict[str, Any]:
    """Option names and parsed values of a lens file.

    Raises:
        InputError: the file cannot be read as TOML.
        UsageProblem: a key is unknown or its value makes no sense.
    """
    try:
        stored = tomllib.loads(_text(file))
    except (ValueError, RecursionError) as error:  # ValueError: a number of 5000 digits
        raise InputError(file, f"is not TOML: {reason(error)}", "mend that line") from None
    values = {name: _parsed(name, value, file) for name, value in stored.items()}
    _refuse_both(values, file)
    return values


def refuse_near_focus(foc_dist: float, foclen: float, source: str) -> None:
    """Raise UsageProblem, naming ``source``, unless a lens of ``foclen`` can focus there (mm)."""
    if foc_dist <= foclen:
        text = quantities.length_text
        raise UsageProblem(
            source,
            f"{text(foc_dist)} is not farther than the focal length {text(foclen)}",
            "focus farther away than that, or give a shorter --focal-length",
        )


def _text(file: Path) -> str:
    remedy = 'give --lens a TOML file, with lines like focal-length = "50mm"'
    try:
        with file.open("rb") as opened:
            data = opened.read(LARGEST_FILE + 1)  # not all of /dev/zero
        text = data.decode("utf-8-sig")
    except OSError as error:
        raise InputError(file, f"cannot be read: {reason(error)}", remedy) from None
    except UnicodeDecodeError:
        raise InputError(file, "is not a text file", remedy) from None
    if "\0" in text or len(data) > LARGEST_FILE:
        raise InputError(file, "is not a lens file", remedy)
    return text


def _parsed(name: str, value: object, file: Path) -> Any:
    if name not in PARSERS:
        known = f"a lens file knows {', '.join(PARSERS)}"
        remedy = did_you_mean(name.replace("_", "-"), tuple(PARSERS), known)
        raise UsageProblem(file, f"unknown key '{name}'", remedy)
    text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
    try:
        return PARSERS[name](text)
    except quantities.QuantityError as error:
        raise UsageProblem(f"{file}: {name}", error.problem, error.remedy) from None


def _refuse_both(values: Mapping[str, Any], file: Path | None = None) -> None:
    where, dashes = (f"{file}: ", "") if file else ("", "--")
    for one, other in _ALTERNATIVES:
        if one in values and other in values:
            raise UsageProblem(
                f"{where}{dashes}{one}", f"contradicts {dashes}{other}", "give one of them"
            )


def _how(name: str, other: str | None) -> str:
    example = f"--{name} {_EXAMPLES[name]}"
    return f"{example} or --{other}" if other else example

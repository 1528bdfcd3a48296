"""The command that renders a sample of a batch again, from its record in the journal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from defocus_core.batch.jobs.job import Machine
from defocus_core.batch.journal.journal import Record
from defocus_core.batch.journal.revived_jobs import input_place, revived
from defocus_core.batch.lenses.lens import EFFECTS, LENS_FILES
from defocus_core.errors import InputError
from defocus_core.reports.html.shell import command_line

OUT = "again"  # where the command writes
# Option and unit of each number of a lens; of other keys of its record, effects are options, too,
# and the rest says how the lens was chosen.
_LENS = {
    "focal_length_mm": ("--focal-length", "mm"),
    "fnumber": ("--fnumber", ""),
    "sensor_width_mm": ("--sensor-width", "mm"),
    "focus_mm": ("--focus", "mm"),
    "blades": ("--blades", ""),
    "blade_rotation_deg": ("--blade-rotation", "deg"),
    "dp_kernels": ("--dp-model", ""),
}
# What stands between two numbers of an effect, and the unit of each.
_PAIRS = {"sharp_range": ("..", "mm"), "highlights": (":", ""), "noise": (":", "")}
_CHOICE = frozenset({"focus_at_px", "focus_percentile", "max_coc_px", "draw"})
_DEFAULTS = {"blades": 0, "blade_rotation_deg": 0.0, "sensor_width_mm": 36.0}
_MILLIMETRES = frozenset({"baseline", "depth_range"})
_MACHINE = ("quality", "tolerance", "depth_repair", "tile")
# Settings that a command line says; a frame of a shot needs the shot.
_SETTINGS = frozenset({"stem", "suffix", "lens", "reading", "outputs", *_MACHINE})


def render_command(record: Record, out: Path) -> str:
    """The command line that does a job again; empty where no command line says its settings.

    Args:
        record: of a job that was done.
        out: the directory of its batch.
    """
    try:
        picture = revived(record, out).picture
    except InputError:
        return ""
    settings, inputs = record["settings"], record["inputs"]
    lens = {**record["lens"], **{k: v for k, v in settings["lens"].items() if k in _PAIRS}}
    for name in LENS_FILES:
        if name in inputs:
            lens[name] = input_place(inputs[name]["path"], out)
    if settings.keys() - _SETTINGS or lens.keys() - _LENS.keys() - _CHOICE - EFFECTS.keys():
        return ""
    words: list[object] = ["defocus", "render", picture.color]
    words += [] if picture.depth == picture.color else [picture.depth]
    words += ["-o", OUT, *_lens_words(lens)]
    for role, other in picture.others.items():
        words += [f"--{role}", other.color]
        words += [other.depth] if role == "hidden" or other.depth != other.color else []
    words += _option_words(settings["reading"]) + _option_words(settings["outputs"])
    machine = {key: settings[key] for key in _MACHINE if key in settings}
    if "tolerance" in machine or machine["quality"] == Machine.quality:
        del machine["quality"]
    return command_line(words + _option_words(machine))


def _lens_words(lens: Mapping[str, Any]) -> list[object]:
    """The options of a lens."""
    words: list[object] = []
    for key, value in lens.items():
        if value is None or key in _CHOICE or value == _DEFAULTS.get(key):
            continue
        option, unit = _LENS.get(key, (f"--{key.replace('_', '-')}", ""))
        if key in _PAIRS:
            between, unit = _PAIRS[key]
            words += [option, between.join(_number(each, unit) for each in value)]
        else:
            words += [option, value if isinstance(value, Path) else _number(value, unit)]
    return words


def _number(value: object, unit: str) -> str:
    """A number of a record, exactly, with its unit; infinity has none, and a switch is on."""
    if value is True:
        return "on"
    return "inf" if value == "inf" else str(value).removesuffix(".0") + unit


def _option_words(values: Mapping[str, Any]) -> list[object]:
    """The options of plain settings, which lack those that have their default."""
    words: list[object] = []
    for field, value in values.items():
        option, unit = f"--{field.replace('_', '-')}", "mm" if field in _MILLIMETRES else ""
        if field == "geometry":
            words.append(f"--{value}")
        elif field == "kinds":
            words += ["--outputs", ",".join(value)]
        elif value is True:
            words.append(option)
        elif field == "depth_range":
            words += [option, *(_number(each, unit) for each in value)]
        else:
            words += [option, ",".join(value) if isinstance(value, list) else f"{value}{unit}"]
    return words

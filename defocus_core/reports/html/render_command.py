"""The command line that renders a picture with a lens and settings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from defocus_core.request.job import Machine, PictureFiles
from defocus_core.request.job_options import READING_OPTIONS
from defocus_core.request.lens import DEFAULTS
from defocus_core.request.parameters import EFFECT_OPTIONS, RECORDED

# Options by the keys of a lens record; other keys tell how the lens was chosen.
_LENS = {**RECORDED, **EFFECT_OPTIONS}
_CHOICE = frozenset({"focus_at_px", "focus_percentile", "draw"})
_MACHINE = ("quality", "depth_repair", "tile")


def render_words(
    picture: PictureFiles, out: object, lens: Mapping[str, Any], settings: Mapping[str, Any]
) -> list[object]:
    """The words of a command that renders a picture."""
    words: list[object] = ["defocus", "render", picture.color]
    words += [] if picture.depth == picture.color else [picture.depth]
    words += ["-o", out, *_lens_words(lens)]
    for role, other in picture.others.items():
        words += [f"--{role}", other.color]
        words += [other.depth] if role == "hidden" or other.depth != other.color else []
    words += _option_words(settings["reading"]) + _option_words(settings["outputs"])
    machine = {key: settings[key] for key in _MACHINE if key in settings}
    if machine["quality"] == Machine.quality:
        del machine["quality"]
    return words + _option_words(machine)


def _lens_words(lens: Mapping[str, Any]) -> list[object]:
    """The options of a lens."""
    words: list[object] = []
    for key, value in lens.items():
        if value is None or key in _CHOICE or value == DEFAULTS.get(_LENS[key].field):
            continue
        row = _LENS[key]
        text = value if isinstance(value, Path) else row.text(value) + row.optional_unit
        words += [f"--{row.name}", text]
    return words


def _option_words(values: Mapping[str, Any]) -> list[object]:
    """The options of plain settings; those at their default are left out."""
    words: list[object] = []
    for field, value in values.items():
        if field == "relative":  # implied by a blur in pixels
            continue
        option = f"--{field.replace('_', '-')}"
        row = READING_OPTIONS.get(option.removeprefix("--"))
        if row is not None and row.flag:
            words.append(option)
        elif row is not None and row.toggle:
            words.append(option if value else f"--no-{row.name}")
        elif row is not None:
            text = row.text(value)
            words += [option, *(text.split() if row.words > 1 else [text])]
        elif field == "geometry":
            words.append(f"--{value}")
        elif field == "kinds":
            words += ["--outputs", ",".join(value)]
        else:
            words += [option] if value is True else [option, f"{value}"]
    return words

"""Colour spaces that files declare: how samples become light, and which declarations are ignored.

sRGB, power laws and linear samples are decoded. Primaries stay as they are, since the blur does not
depend on them. Another declaration, as an embedded profile or a curve of HDR television, is not
applied, and a warning says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

_SAMPLES = {"uint8": "8-bit", "uint16": "16-bit"}
_CURVES = {None: "sRGB", 1.0: "linear"}
_FLOATS = frozenset({"half", "float", "double"})


@dataclass(frozen=True)
class ColorSpace:
    """How the samples of a file are understood.

    Attributes:
        gamma: exponent of the power law that decodes them, 1 for linear, None for sRGB.
        note: the same in words.
        unheeded: what the file declares that is not applied; empty if nothing.
    """

    gamma: float | None
    note: str
    unheeded: str


def color_space(spec: Any) -> ColorSpace:
    """How the samples of an OpenImageIO ``spec`` are understood."""
    declared, gamma = _declared(spec)
    kind = str(spec.format)
    if not declared:
        gamma = 1.0 if kind in _FLOATS else None
    curve = _CURVES.get(gamma) or f"the power {gamma:g}"
    note = f"{_SAMPLES.get(kind, kind)}, taken as {curve}"
    return ColorSpace(gamma, note, _unheeded(spec, declared=declared))


def _declared(spec: Any) -> tuple[bool, float | None]:
    """Whether the file declares a curve that is known, and its exponent."""
    space = _name(spec)
    if space.startswith("lin") or space == "scene_linear":
        return True, 1.0
    if space.startswith("srgb"):
        return True, None
    power = spec.get_float_attribute("oiio:Gamma", 0.0)
    return power > 0, float(power)


def _unheeded(spec: Any, *, declared: bool) -> str:
    if spec.getattribute("ICCProfile") is not None:
        profile = spec.get_string_attribute("ICCProfile:profile_description")
        if "srgb" not in profile.lower():
            return f"colour profile '{profile}'" if profile else "colour profile without a name"
    space = _name(spec)
    of_srgb = "_" not in space or "rec709" in space or space == "scene_linear"
    return "" if not space or (declared and of_srgb) else f"colour space {space}"


def _name(spec: Any) -> str:
    """Name of the declared space, like ``srgb_rec709_scene``: curve, primaries, reference."""
    return str(spec.get_string_attribute("oiio:ColorSpace")).lower()

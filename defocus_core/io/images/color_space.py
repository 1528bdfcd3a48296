"""Colour spaces of files: what they declare, and the curves between their samples and light.

sRGB (IEC 61966-2-1, exact), power laws, linear samples and ICC profiles of curves and a matrix are
decoded. Primaries stay as they are, since the blur does not depend on them. Another declaration, as
a profile of tables or a curve of HDR television, is not applied, and a warning says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.images.icc import Embedded, Profile, read_profile
from defocus_core.io.images.primaries import REC_709, Chromaticities, primaries_name

PROFILE = "ICCProfile"  # OpenImageIO's name of it
_SAMPLES = {"uint8": "8-bit", "uint16": "16-bit"}
_CURVES = {None: "sRGB", 1.0: "linear"}
_FLOATS = frozenset({"half", "float", "double"})


@dataclass(frozen=True)
class ColorSpace:
    """How the samples of a file are understood."""

    gamma: float | None  # exponent of the power law that decodes them, 1 for linear, None for sRGB
    note: str  # the same in words
    unheeded: str  # what the file declares that is not applied; empty if nothing
    # The ICC profile that decodes them instead; None if there is none
    profile: Profile | None = None
    data: bytes = b""  # the bytes of the profile that the file has, whether it decodes them or not

    @property
    def primaries(self) -> Chromaticities:
        """Those of the decoded light."""
        return REC_709 if self.profile is None else self.profile.primaries

    @property
    def attributes(self) -> dict[str, Embedded]:
        """The attribute by which another file has the profile; none if there is none."""
        return {PROFILE: Embedded(self.data, self.profile)} if self.data else {}


def color_space(spec: Any) -> ColorSpace:
    """How the samples of an OpenImageIO ``spec`` are understood."""
    declared, gamma = _declaration(spec)
    kind = str(spec.format)
    named, profile, data = _profile(spec)
    if profile is not None:
        primaries = primaries_name(profile.primaries)
        curve = f"profile '{named}'" if named else "its profile"
        note = f"{_SAMPLES.get(kind, kind)}, decoded by {curve}, primaries {primaries}"
        return ColorSpace(None, note, "", profile, data)
    if not declared:
        gamma = 1.0 if kind in _FLOATS else None
    curve = _CURVES.get(gamma) or f"the power {gamma:g}"
    note = f"{_SAMPLES.get(kind, kind)}, taken as {curve}"
    return ColorSpace(gamma, note, _unheeded(spec, declared=declared), data=data)


def profiled_space(data: bytes) -> ColorSpace:
    """How 8 bits with a profile are understood, as sRGB where it has no curve or is missing."""
    profile = read_profile(data) if data else None
    name = (
        "sRGB" if profile is None else f"its profile, primaries {primaries_name(profile.primaries)}"
    )
    return ColorSpace(None, f"8-bit, decoded by {name}", "", profile, data)


def _declaration(spec: Any) -> tuple[bool, float | None]:
    """Whether the file declares a curve that is known, and its exponent."""
    space = _name(spec)
    if space.startswith("lin") or space == "scene_linear":
        return True, 1.0
    if space.startswith("srgb") or space == "rec709":  # which OpenImageIO says of every PPM
        return True, None
    power = spec.get_float_attribute("oiio:Gamma", 0.0)
    return power > 0, float(power)


def _profile(spec: Any) -> tuple[str, Profile | None, bytes]:
    """The name of the embedded profile, what it says of light where it is not sRGB, its bytes."""
    name = str(spec.get_string_attribute("ICCProfile:profile_description"))
    stored = spec.getattribute(PROFILE)
    data = b"" if stored is None else bytes(stored)
    profile = None if not data or "srgb" in name.lower() else read_profile(data)
    colors = spec.nchannels - (spec.alpha_channel >= 0)
    return name, profile if profile is None or len(profile.curves) == colors else None, data


def _unheeded(spec: Any, *, declared: bool) -> str:
    if spec.getattribute(PROFILE) is not None:
        profile = spec.get_string_attribute("ICCProfile:profile_description")
        if "srgb" not in profile.lower():
            return f"colour profile '{profile}'" if profile else "colour profile without a name"
    space = _name(spec)
    has_srgb_primaries = "_" not in space or "rec709" in space or space == "scene_linear"
    return "" if not space or (declared and has_srgb_primaries) else f"colour space {space}"


def _name(spec: Any) -> str:
    """Name of the declared space, like ``srgb_rec709_scene``: curve, primaries, reference."""
    return str(spec.get_string_attribute("oiio:ColorSpace")).lower()


def srgb_to_linear(encoded: NDArray[Any]) -> NDArray[np.float64]:
    """Linear light of sRGB values, both 0…1."""
    value = np.asarray(encoded, np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Encoded sRGB values of linear light, both 0…1; negative light is taken as 0."""
    value = np.maximum(linear, np.float32(0.0))
    toe = np.minimum(value, np.float32(1.0)) * np.float32(12.92)  # what is near the largest float
    curve = np.float32(1.055) * value ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(value <= np.float32(0.0031308), toe, curve)


@cache
def decoding_table(bits: int, gamma: float | None = None) -> NDArray[np.float32]:
    """Linear light of every integer of a file with 8 or 16 bits, [2^bits].

    `gamma`: exponent of a file that declares a power law (1 = linear); None for sRGB.
    """
    encoded = np.arange(2**bits) / (2**bits - 1)
    linear = srgb_to_linear(encoded) if gamma is None else encoded**gamma
    return linear.astype(np.float32)


def linear_light(
    colour: NDArray[Any],  # [H, W, C] as in the file
    alpha: NDArray[np.float32] | None,  # [H, W, 1], 0…1
    *,
    gamma: float | None,  # exponent of the power law that decodes them, 1 for linear, None for sRGB
    associated: bool,
    profile: Profile | None = None,
) -> NDArray[np.float32]:
    """Linear light of the samples of a file, premultiplied by alpha if there is one."""
    linear: NDArray[np.float32]
    if alpha is not None and associated and gamma != 1.0:
        # Such files were premultiplied after encoding, as editors do: undo that first.
        visible = np.where(alpha > 0, alpha, np.float32(1.0))
        straight = np.minimum(unit(colour) / visible, 1.0)
        light = _decode(straight, gamma) if profile is None else profile.light(straight)
        return light * alpha
    if profile is not None:
        linear = profile.light(colour)
    elif colour.dtype.kind == "u":
        linear = decoding_table(colour.dtype.itemsize * 8, gamma)[colour]
    else:
        linear = _decode(colour, gamma)
    return linear if alpha is None or associated else linear * alpha


def _decode(values: NDArray[np.float32], gamma: float | None) -> NDArray[np.float32]:
    if gamma == 1.0:
        return values
    linear = srgb_to_linear(values) if gamma is None else np.maximum(values, 0.0) ** gamma
    return linear.astype(np.float32)


def unit(samples: NDArray[Any]) -> NDArray[np.float32]:
    """Integers as 0…1, floats as they are."""
    if samples.dtype.kind != "u":
        return samples.astype(np.float32)
    top = np.iinfo(samples.dtype).max
    return (samples / top).astype(np.float32)


def quantised(values: NDArray[np.float32], bits: int) -> NDArray[Any]:
    """Values 0…1 as the nearest integers of 8 or 16 bits; what lies outside is clipped."""
    clipped = np.clip(np.nan_to_num(values, nan=0.0), 0.0, 1.0)
    levels: NDArray[np.float32] = np.rint(clipped * np.float32(2**bits - 1))
    return levels.astype(np.uint8 if bits == 8 else np.uint16)

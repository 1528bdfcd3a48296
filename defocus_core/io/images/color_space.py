"""Colour spaces of files: what they declare, and the curves between their samples and light.

The curve is sRGB's (IEC 61966-2-1), a power, or none. In an ICC profile of a matrix and curves
(ICC.1:2022, 8.3.4), or of grey (8.3.5), the TRC tags hold the curve, as a formula or a table. A
blur is linear in light and needs only the curve: primaries and profile stay unchanged. Any other
curve, as in a profile of tables, is not applied, and a warning says so.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.images.primaries import (
    NAMED,
    PROFILE,
    REC_709,
    Chromaticities,
    primaries_name,
    primaries_of_columns,
    same_primaries,
)

_HEAD = 128  # bytes of a profile
_MAX_TAGS = 200
_PARAMETERS = (1, 3, 4, 5, 7)  # numbers of each type of parametric curve
_STEPS = np.linspace(0, 1, 257)  # samples at which curves are compared
_SAME_LIGHT = 1e-3  # greatest difference of equal curves, which tables and fixed point round
_GAMMAS = (0.1, 10.0)  # least and greatest exponent that is accepted
_SAMPLES = {"uint8": "8-bit", "uint16": "16-bit"}
_CURVES = {None: "sRGB", 1.0: "linear"}
_FLOATS = frozenset({"half", "float", "double"})
# Codes of ITU-T H.273 in PNG and HEIC
_PRIMARIES_OF_CODE = {1: REC_709, 9: NAMED["Rec. 2020"], 12: NAMED["Display P3"]}
_HDR = {16: "PQ", 18: "HLG"}  # curves whose light is not relative to white
CODES = "CICP"  # OpenImageIO's name of the attribute


class Profile(NamedTuple):
    """The curve and the primaries of an ICC profile."""

    gamma: float | None  # exponent of the power law that decodes them, 1 for linear, None for sRGB
    primaries: Chromaticities


class Embedded(NamedTuple):
    """The colour profile of an input, to be embedded in outputs."""

    data: bytes  # the profile itself
    gamma: float | None  # as in `Profile`; also None if the curve is unknown


def read_profile(data: bytes) -> Profile | None:
    """The profile decoded from its bytes; None if it has no known curve."""
    try:
        (count,) = struct.unpack_from(">I", data, _HEAD)
        table = data[_HEAD + 4 : _HEAD + 4 + 12 * min(count, _MAX_TAGS)]
        entries = struct.iter_unpack(">4sII", table)
        tags = {name: data[start : start + size] for name, start, size in entries}
        if data[16:20] == b"GRAY":
            return Profile(_gamma(tags[b"kTRC"]), REC_709)
        gammas = {_gamma(tags[c + b"TRC"]) for c in (b"r", b"g", b"b")}
        columns = np.array([_fixed(tags[c + b"XYZ"][8:20]) for c in (b"r", b"g", b"b")]).T
        if data[16:24] == b"RGB XYZ " and len(gammas) == 1 and (columns.sum(0) != 0).all():
            return Profile(gammas.pop(), primaries_of_columns(columns))
    except (struct.error, ValueError, KeyError, IndexError, ArithmeticError):
        pass
    return None


def sound_profile(data: bytes, colors: int) -> bytes:
    """The bytes of the profile at the start of `data`; empty if encoders would not accept it.

    ICC.1:2022, 7.2. `colors`: number of colour channels, 1 or 3; a wrong number makes libpng end
    the process.
    """
    if len(data) < _HEAD + 4:
        return b""
    size, count = (struct.unpack_from(">I", data, place)[0] for place in (0, _HEAD))
    data = data[:size]
    table = data[_HEAD + 4 :][: 12 * count]
    entries = struct.iter_unpack(">4sII", table[: len(table) // 12 * 12])
    ends = [start + of for _, start, of in entries]
    space = b"GRAY" if colors == 1 else b"RGB "
    fits = data[16:20] == space and data[20:24] in (b"XYZ ", b"Lab ") and data[36:40] == b"acsp"
    is_whole = len(data) == size and len(ends) == count and max(ends, default=0) <= size
    return data if is_whole and fits and data[12:16] not in (b"abst", b"link") else b""


def _fixed(data: bytes) -> tuple[float, ...]:
    """Fixed-point numbers with 16 integer and 16 fractional bits."""
    return tuple(value / 65536 for (value,) in struct.iter_unpack(">i", data))


def _gamma(data: bytes) -> float | None:
    """The exponent of a curve, None for sRGB; raises ValueError for any other curve."""
    light = _curve(data)
    if np.allclose(light, srgb_to_linear(_STEPS), rtol=0, atol=_SAME_LIGHT):
        return None
    gamma = round(-math.log2(light[len(light) // 2]), 8)  # of the sample 0.5
    if abs(gamma - 1) < _SAME_LIGHT:
        gamma = 1.0
    is_power = np.allclose(light, _STEPS**gamma, rtol=0, atol=_SAME_LIGHT)
    if not (_GAMMAS[0] < gamma < _GAMMAS[1] and is_power):
        raise ValueError("a curve that is not known")
    return gamma


def _curve(data: bytes) -> NDArray[np.float64]:
    """The light at the samples `_STEPS` by the bytes of a curve (ICC.1:2022, 10.6 and table 68)."""
    if data[:4] == b"curv":
        (count,) = struct.unpack_from(">I", data, 8)
        numbers = np.frombuffer(data, ">u2", count, 12) if count else np.array([256])
        if len(numbers) == 1:
            power: NDArray[np.float64] = _STEPS ** (float(numbers[0]) / 256)
            return power
        return np.interp(_STEPS, np.linspace(0, 1, len(numbers)), numbers / 65535)
    if data[:4] != b"para":
        raise ValueError("a curve of no known type")
    kind = struct.unpack_from(">H", data, 8)[0]
    g, *more = _fixed(data[12 : 12 + 4 * _PARAMETERS[kind]])
    a, b, *more = more or (1.0, 0.0)
    curved: NDArray[np.float64] = np.maximum(a * _STEPS + b, 0.0) ** g
    if kind < 3:
        return curved + sum(more)
    slope, start, above, below = (*more, 0.0, 0.0)[:4]
    return np.where(start <= _STEPS, curved + above, slope * _STEPS + below)


@dataclass(frozen=True)
class ColorSpace:
    """How the samples of a file become light."""

    gamma: float | None  # exponent of the power law that decodes them, 1 for linear, None for sRGB
    note: str  # type of the samples and curve, in words
    unheeded: str  # declared profile or space that is not applied, in words; empty if none
    hdr: str = ""  # the curve of HDR television that the file declares, which is not decoded
    primaries: Chromaticities = REC_709  # of the decoded light
    # The attribute that embeds the profile in another file; empty without a profile
    attributes: Mapping[str, Embedded] = field(default_factory=dict)


def color_space(spec: Any) -> ColorSpace:
    """The colour space of the samples of an OpenImageIO ``spec``, the header of an image."""
    kind, stored = str(spec.format), spec.getattribute(PROFILE)
    color_count = spec.nchannels - (spec.alpha_channel >= 0)
    data = b"" if stored is None else sound_profile(bytes(stored), color_count)
    named = str(spec.get_string_attribute("ICCProfile:profile_description"))
    profile, codes, by = read_profile(data), spec.getattribute(CODES) or (0, 0), ""
    if profile is not None:
        (gamma, primaries), unheeded = profile, ""
        if gamma is not None or not same_primaries(primaries, REC_709):
            by = f" by profile '{named}'" if named else " by its profile"
    else:
        gamma, unheeded = _declared(spec, kind)
        primaries = _PRIMARIES_OF_CODE.get(codes[0], REC_709)
    if profile is None and stored is not None:
        unheeded = f"colour profile '{named}'" if named else "colour profile without a name"
        unheeded = unheeded if data else "colour profile, which is damaged and left out,"
    curve = _CURVES.get(gamma) or f"the power {gamma:g}"
    note = f"{_SAMPLES.get(kind, kind)}, taken as {curve}{by}"
    if not same_primaries(primaries, REC_709):
        note = f"{note}, primaries {primaries_name(primaries)}"
    embedded = {PROFILE: Embedded(data, profile and profile.gamma)} if data else {}
    hdr = "" if profile else _HDR.get(codes[1], "")
    return ColorSpace(gamma, note, unheeded, hdr, primaries, embedded)


def _declared(spec: Any, kind: str) -> tuple[float | None, str]:
    """The exponent that a file declares or its type implies, and the colour space not applied.

    The exponent is 1 for linear, None for sRGB; the space is in words, empty if none. `kind`: the
    type of the samples.
    """
    # named like ``srgb_rec709_scene``: curve, primaries, reference
    space = str(spec.get_string_attribute("oiio:ColorSpace")).lower()
    gamma: float | None = spec.get_float_attribute("oiio:Gamma", 0.0)
    is_linear = space.startswith("lin") or space == "scene_linear"
    if is_linear or space.startswith("srgb") or space == "rec709":
        gamma = 1.0 if is_linear else None
    has_primaries = "_" not in space or "rec709" in space or space == "scene_linear"
    is_known = gamma != 0 and (has_primaries or spec.getattribute(CODES) is not None)
    if gamma == 0:
        gamma = 1.0 if kind in _FLOATS else None
    return gamma, "" if is_known or not space else f"colour space {space}"


def srgb_to_linear(encoded: NDArray[Any]) -> NDArray[np.float64]:
    """Linear light of sRGB values, both 0…1."""
    value = np.asarray(encoded, np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Encoded sRGB values of linear light, both 0…1; negative light is taken as 0."""
    value = np.maximum(linear, np.float32(0.0))
    toe = np.minimum(value, np.float32(1.0)) * np.float32(12.92)  # the largest floats overflow
    curve = np.float32(1.055) * value ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(value <= np.float32(0.0031308), toe, curve)


def encoded_light(light: NDArray[np.float32], gamma: float | None) -> NDArray[np.float32]:
    """Encoded samples of linear light, both 0…1; `gamma` is 1 for linear, None for sRGB."""
    if gamma is None or gamma == 1:
        return linear_to_srgb(light) if gamma is None else light
    return np.maximum(light, np.float32(0)) ** np.float32(1 / gamma)


@cache
def _table(bits: int, gamma: float | None) -> NDArray[np.float32]:
    """The linear light [2^bits] of every integer of 8 or 16 bits, by its value."""
    return _light(np.arange(2**bits) / (2**bits - 1), gamma)


def _light(values: NDArray[Any], gamma: float | None) -> NDArray[np.float32]:
    """Linear light of samples: of floats 0…1, or of integers by a table; `gamma`: see `Profile`."""
    if values.dtype.kind == "u":
        light: NDArray[np.float32] = _table(values.dtype.itemsize * 8, gamma)[values]
        return light
    linear: NDArray[Any] = values
    if gamma != 1.0:
        linear = srgb_to_linear(values) if gamma is None else np.maximum(values, 0.0) ** gamma
    return linear.astype(np.float32, copy=False)


def linear_light(
    colour: NDArray[Any],  # [H, W, C] as in the file
    alpha: NDArray[np.float32] | None,  # [H, W, 1], 0…1
    *,
    gamma: float | None,  # exponent of the power law that decodes them, 1 for linear, None for sRGB
    associated: bool = False,
) -> NDArray[np.float32]:
    """Linear light of the samples of a file, premultiplied by alpha if there is one.

    `associated`: whether the samples are already multiplied by alpha.
    """
    if alpha is not None and associated and gamma != 1.0:
        # Such files were premultiplied after encoding, as editors do: undo that first.
        visible = np.where(alpha > 0, alpha, np.float32(1.0))
        straight = np.minimum(unit(colour) / visible, 1.0)
        return _light(straight, gamma) * alpha
    linear = _light(colour, gamma)
    return linear if alpha is None or associated else linear * alpha


def unit(samples: NDArray[Any]) -> NDArray[np.float32]:
    """Samples as float32: integers scaled to 0…1, floats as they are."""
    if samples.dtype.kind != "u":
        return samples.astype(np.float32)
    scaled: NDArray[np.float32] = np.divide(samples, np.iinfo(samples.dtype).max, dtype=np.float32)
    return scaled


def quantised(
    values: NDArray[np.float32], bits: int, dither: NDArray[np.float32] | None = None
) -> NDArray[Any]:
    """Values 0…1 as the nearest integers of 8 or 16 bits; values outside are clipped.

    `dither`: fractions of a step, within ±0.5, added before rounding; None for no dither.
    """
    clipped = np.clip(np.nan_to_num(values, nan=0.0), 0.0, 1.0)
    scaled = clipped * np.float32(2**bits - 1)
    levels: NDArray[np.float32] = np.rint(scaled if dither is None else scaled + dither)
    return levels.astype(np.uint8 if bits == 8 else np.uint16)

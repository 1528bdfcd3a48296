"""Colour spaces of files: what they declare, and the curves between their samples and light.

sRGB (IEC 61966-2-1, exact), power laws, linear samples and ICC profiles are decoded. Of ICC.1:2022
these are 8.3.4, "three-component matrix-based", R, G and B become light by curves, and light X, Y
and Z relative to the white D50 by a matrix; and 8.3.5, "monochrome", a curve alone. A blur is
linear in light, so that curves are all it needs: primaries and profile stay as they came. What else
is declared, like a profile of tables or a curve of HDR television, is not applied, and a warning
says so.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from defocus_core.io.images.primaries import (
    PROFILE,
    REC_709,
    Chromaticities,
    adaptation,
    chromaticities_of,
    primaries_name,
    same_primaries,
)

_D50 = (0.9642, 1.0, 0.8249)  # of all profiles
_HEAD = 128  # bytes
_MAX_TAGS = 200
_PARAMETERS = (1, 3, 4, 5, 7)  # numbers of each type of parametric curve
_LEAST_RISE = 0.1  # of a curve, from black to white
_CURVE_STEPS = 4096  # of a curve: floats between them are interpolated
_ROOTS = 1 << 16  # steps of the square root of light, near which samples of all curves are even


@dataclass(frozen=True)
class Profile:
    """How R, G and B of a file, or its grey, become light."""

    # Light of each channel of 0…1 at even steps, `_CURVE_STEPS` numbers each
    curves: tuple[tuple[float, ...], ...]
    primaries: Chromaticities

    def samples(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """The samples 0…1 of linear light [H, W, 3], whose curves never fall; NaN is black."""
        place = np.fmin(np.fmax(light, np.float32(0)), np.float32(1))
        place = np.sqrt(place, dtype=np.float32) * np.float32(_ROOTS)
        index = place.astype(np.int32)
        place -= index
        samples = np.empty_like(place)
        for c, table in enumerate(_inverses(self)):
            below, above = (table.take(index[..., c] + step) for step in (0, 1))
            samples[..., c] = below + place[..., c] * (above - below)
        return samples


class Embedded(NamedTuple):
    """The profile of a file, for others made of it to have: its bytes, and its curves if known."""

    data: bytes
    profile: Profile | None


@cache
def _inverses(profile: Profile) -> list[NDArray[np.float32]]:
    """Samples of each channel at even steps of the square root of light, with one more."""
    steps = np.linspace(0, 1, _CURVE_STEPS)
    light = np.minimum(np.arange(_ROOTS + 2) / _ROOTS, 1) ** 2
    return [np.interp(light, curve, steps).astype(np.float32) for curve in profile.curves]


def read_profile(data: bytes) -> Profile | None:
    """The profile in the bytes of a file; None where it is none of curves and a matrix."""
    try:
        return _parsed(data)
    except (struct.error, ValueError, KeyError, IndexError, ArithmeticError):
        return None


def sound_profile(data: bytes, colors: int) -> bytes:
    """The profile at the beginning of bytes; empty if it is none that encoders take.

    ICC.1:2022, 7.2. libpng ends the process at one of another number of colours.
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


def _parsed(data: bytes) -> Profile | None:
    tags = _tags(data)
    if data[16:20] == b"GRAY":
        return _rising((_curve(tags["kTRC"]),), REC_709)
    if data[16:24] != b"RGB XYZ ":
        return None
    curves = tuple(_curve(tags[f"{c}TRC"]) for c in "rgb")
    relative = np.array([_fixed(tags[f"{c}XYZ"][8:20]) for c in "rgb"]).T
    if "chad" in tags:
        adapted = np.array(_fixed(tags["chad"][8:44])).reshape(3, 3)
    else:
        white = np.array(_fixed(tags["wtpt"][8:20])) if "wtpt" in tags else np.array(_D50)
        adapted = adaptation(white, np.array(_D50))
    return _rising(curves, chromaticities_of(np.linalg.inv(adapted) @ relative))


def _rising(curves: tuple[tuple[float, ...], ...], primaries: Chromaticities) -> Profile | None:
    """A profile of finite numbers whose curves rise from black to white, so that none is flat."""
    is_finite = np.isfinite([*primaries, *np.ravel(curves)]).all()
    rises = all(curve[-1] - curve[0] > _LEAST_RISE for curve in curves)
    is_sound = is_finite and rises and (np.diff(curves) >= 0).all()
    return Profile(curves, primaries) if is_sound else None


def _tags(data: bytes) -> dict[str, bytes]:
    (count,) = struct.unpack_from(">I", data, _HEAD)
    entries = struct.iter_unpack(">4sII", data[_HEAD + 4 : _HEAD + 4 + 12 * min(count, _MAX_TAGS)])
    return {
        name.decode("latin-1"): data[start : start + size]
        for name, start, size in entries
        if start + size <= len(data)
    }


def _fixed(data: bytes) -> tuple[float, ...]:
    """Numbers of 16 bits before and 16 behind the point."""
    return tuple(value / 65536 for (value,) in struct.iter_unpack(">i", data))


def _curve(data: bytes) -> tuple[float, ...]:
    steps = np.linspace(0, 1, _CURVE_STEPS)
    if data[:4] == b"para":
        parameters = _PARAMETERS[struct.unpack_from(">H", data, 8)[0]]
        return tuple(_parametric(steps, _fixed(data[12 : 12 + 4 * parameters])).tolist())
    if data[:4] != b"curv":
        raise ValueError("a curve of no known type")
    count: int = struct.unpack_from(">I", data, 8)[0]
    numbers = np.frombuffer(data, ">u2", count, 12) if count else np.array([256])
    if len(numbers) == 1:
        return tuple((steps ** (float(numbers[0]) / 256)).tolist())
    return tuple(np.interp(steps, np.linspace(0, 1, count), numbers / 65535).tolist())


def _parametric(x: NDArray[np.float64], numbers: tuple[float, ...]) -> NDArray[np.float64]:
    """A curve of 1, 3, 4, 5 or 7 numbers, as ICC.1:2022, table 68, has them."""
    g, a, b = numbers[:3] if len(numbers) > 1 else (numbers[0], 1.0, 0.0)
    inner = a * x + b
    curved = np.maximum(inner, 0.0) ** g
    if len(numbers) < 5:
        return curved + (numbers[3] if len(numbers) == 4 else 0.0)
    slope, start = numbers[3:5]
    above, below = numbers[5:7] if len(numbers) == 7 else (0.0, 0.0)
    return np.where(x >= start, curved + above, slope * x + below)


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
    declared: Chromaticities = REC_709  # primaries that the file names, where it has no profile
    data: bytes = b""  # the bytes of the profile that the file has, whether it decodes them or not

    @property
    def primaries(self) -> Chromaticities:
        """Those of the decoded light."""
        return self.declared if self.profile is None else self.profile.primaries

    @property
    def attributes(self) -> dict[str, Embedded]:
        """The attribute by which another file has the profile; none if there is none."""
        return {PROFILE: Embedded(self.data, self.profile)} if self.data else {}


def color_space(spec: Any, primaries: Chromaticities = REC_709) -> ColorSpace:
    """How the samples of an OpenImageIO ``spec`` are understood.

    `primaries`: those that the file names beside a profile.
    """
    declared, gamma = _declaration(spec)
    kind = str(spec.format)
    named, profile, data = _profile(spec)
    if profile is not None:
        shown = primaries_name(profile.primaries)
        curve = f"profile '{named}'" if named else "its profile"
        note = f"{_SAMPLES.get(kind, kind)}, decoded by {curve}, primaries {shown}"
        return ColorSpace(None, note, "", profile, data=data)
    if not declared:
        gamma = 1.0 if kind in _FLOATS else None
    curve = _CURVES.get(gamma) or f"the power {gamma:g}"
    note = f"{_SAMPLES.get(kind, kind)}, taken as {curve}"
    if not same_primaries(primaries, REC_709):
        note = f"{note}, primaries {primaries_name(primaries)}"
    unheeded = _unheeded(spec, data, declared=declared)
    return ColorSpace(gamma, note, unheeded, declared=primaries, data=data)


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
    stored, colors = spec.getattribute(PROFILE), spec.nchannels - (spec.alpha_channel >= 0)
    data = b"" if stored is None else sound_profile(bytes(stored), colors)
    profile = None if not data or "srgb" in name.lower() else read_profile(data)
    return name, profile if profile is None or len(profile.curves) == colors else None, data


def _unheeded(spec: Any, data: bytes, *, declared: bool) -> str:
    if spec.getattribute(PROFILE) is not None:
        if not data:
            return "colour profile, which is damaged and left out,"
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
def _table(bits: int, gamma: float | None, profile: Profile | None) -> list[NDArray[np.float32]]:
    """Linear light of every integer of 8 or 16 bits, [2^bits]: of each channel of a profile."""
    encoded = np.arange(2**bits) / (2**bits - 1)
    channels = 1 if profile is None else len(profile.curves)
    return [*np.moveaxis(_light(np.stack([encoded] * channels, -1), gamma, profile), -1, 0)]


def _light(
    values: NDArray[Any], gamma: float | None, profile: Profile | None
) -> NDArray[np.float32]:
    """Linear light of samples [..., C]: floats 0…1, or integers by a table."""
    if values.dtype.kind == "u":
        tables = _table(values.dtype.itemsize * 8, gamma, profile)
        if profile is None:
            light: NDArray[np.float32] = tables[0][values]
            return light
        return np.stack([table[values[..., c]] for c, table in enumerate(tables)], axis=-1)
    if profile is not None:
        steps, curves = np.linspace(0, 1, _CURVE_STEPS), enumerate(profile.curves)
        every = [np.interp(values[..., c], steps, curve) for c, curve in curves]
        return np.stack(every, axis=-1, dtype=np.float32)
    linear: NDArray[Any] = values
    if gamma != 1.0:
        linear = srgb_to_linear(values) if gamma is None else np.maximum(values, 0.0) ** gamma
    return linear.astype(np.float32, copy=False)


def linear_light(
    colour: NDArray[Any],  # [H, W, C] as in the file
    alpha: NDArray[np.float32] | None,  # [H, W, 1], 0…1
    *,
    gamma: float | None,  # exponent of the power law that decodes them, 1 for linear, None for sRGB
    associated: bool,
    profile: Profile | None = None,
) -> NDArray[np.float32]:
    """Linear light of the samples of a file, premultiplied by alpha if there is one."""
    if alpha is not None and associated and gamma != 1.0:
        # Such files were premultiplied after encoding, as editors do: undo that first.
        visible = np.where(alpha > 0, alpha, np.float32(1.0))
        straight = np.minimum(unit(colour) / visible, 1.0)
        return _light(straight, gamma, profile) * alpha
    linear = _light(colour, gamma, profile)
    return linear if alpha is None or associated else linear * alpha


def unit(samples: NDArray[Any]) -> NDArray[np.float32]:
    """Integers as 0…1, floats as they are."""
    if samples.dtype.kind != "u":
        return samples.astype(np.float32)
    return (samples / np.iinfo(samples.dtype).max).astype(np.float32)


def quantised(values: NDArray[np.float32], bits: int) -> NDArray[Any]:
    """Values 0…1 as the nearest integers of 8 or 16 bits; what lies outside is clipped."""
    clipped = np.clip(np.nan_to_num(values, nan=0.0), 0.0, 1.0)
    levels: NDArray[np.float32] = np.rint(clipped * np.float32(2**bits - 1))
    return levels.astype(np.uint8 if bits == 8 else np.uint16)

"""Primaries of colour: what a file declares, and the matrices from one set to another.

A set of primaries is eight numbers, x and y of red, green, blue and white; SMPTE RP 177-1993 says
how to compute XYZ from them. A different white is adapted by the Bradford matrix (K. Lam,
"Metamerism and Colour Constancy", 1985), as in ICC profiles.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import InputError
from defocus_core.io.exr.header import Raw

Chromaticities = tuple[float, ...]  # x and y of red, green, blue, white

REC_709: Chromaticities = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
NAMED: dict[str, Chromaticities] = {
    "Rec. 709": REC_709,
    "Display P3": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
    "Rec. 2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "Adobe RGB": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290),
    "ACES AP0": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "ACES AP1": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
    "CIE XYZ": (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3),
}
_SAME = 2e-3  # greatest difference of equal x or y, which profiles and half floats round
_D50 = np.array([0.9642, 1.0, 0.8249])  # X, Y, Z of the white of all profiles
_BRADFORD = ((0.8951, 0.2664, -0.1614), (-0.7502, 1.7135, 0.0367), (0.0389, -0.0685, 1.0296))
PRIMARIES = "chromaticities"  # attribute of an EXR header, and its type
PROFILE = "ICCProfile"  # OpenImageIO's name of an attribute


def declared_primaries(attributes: Mapping[str, object]) -> Chromaticities:
    """The primaries that attributes of an EXR header declare, Rec. 709 by default."""
    said = attributes.get(PRIMARIES)
    if isinstance(said, Raw) and said.kind == PRIMARIES and len(said.value) == 32:
        return struct.unpack("<8f", said.value)
    return REC_709


def primaries_attribute(primaries: Chromaticities) -> dict[str, Raw]:
    """The attribute of an EXR header that declares primaries; empty for Rec. 709, the default."""
    if same_primaries(primaries, REC_709):
        return {}
    return {PRIMARIES: Raw(PRIMARIES, struct.pack("<8f", *primaries))}


def same_primaries(a: Chromaticities, b: Chromaticities) -> bool:
    """Whether two sets of primaries are equal except for rounding."""
    return max(abs(x - y) for x, y in zip(a, b, strict=True)) <= _SAME


def refuse_other_primaries(
    path: Path, attributes: Mapping[str, object], other: Mapping[str, object], name: str
) -> None:
    """Refuse to mix a picture's light with that of a picture with other primaries.

    `attributes` belong to the picture at `path`, `other` to the picture called `name` in the error.
    """
    theirs, own = declared_primaries(attributes), declared_primaries(other)
    if not same_primaries(theirs, own):
        problem = f"has the primaries {primaries_name(theirs)} but {name} {primaries_name(own)}"
        raise InputError("wrong-type", problem, "convert one of them first", path=path)


def primaries_name(primaries: Chromaticities) -> str:
    """The name of a set of primaries; its numbers in words if it has no name."""
    for name, known in NAMED.items():
        if same_primaries(primaries, known):
            return name
    return "x, y " + ", ".join(f"{value:.4g}" for value in primaries)


def xyz_of_primaries(primaries: Chromaticities) -> NDArray[np.float64]:
    """The matrix [3, 3] from R, G, B to X, Y, Z, where white has Y = 1."""
    points = np.array(primaries, np.float64).reshape(4, 2)
    spread = np.c_[points, 1 - points.sum(1)]
    if not np.isfinite(spread).all() or not points[3, 1] > 0:
        raise ValueError("the white has no brightness")
    columns, white = spread[:3].T, spread[3] / points[3, 1]
    if abs(np.linalg.det(columns)) < 1e-9:
        raise ValueError("the primaries lie on a line")
    matrix: NDArray[np.float64] = columns * np.linalg.solve(columns, white)
    return matrix


def between_primaries(
    source: Chromaticities, target: Chromaticities = REC_709
) -> NDArray[np.float32] | None:
    """The matrix [3, 3] from linear R, G, B of one set to those of another; None if they are equal.

    White becomes white: it is adapted by the Bradford matrix.
    """
    if same_primaries(source, target):
        return None
    ours, theirs = xyz_of_primaries(source), xyz_of_primaries(target)
    adapted = adaptation(ours.sum(1), theirs.sum(1))
    matrix: NDArray[np.float32] = (np.linalg.inv(theirs) @ adapted @ ours).astype(np.float32)
    return matrix


def adaptation(source: Any, target: Any) -> NDArray[np.float64]:
    """The Bradford matrix [3, 3] that adapts X, Y, Z from one white, `source`, to another."""
    cones = np.array(_BRADFORD)
    gains = (cones @ target) / (cones @ source)
    matrix: NDArray[np.float64] = np.linalg.inv(cones) @ (gains[:, None] * cones)
    return matrix


def primaries_of_columns(columns: NDArray[np.float64]) -> Chromaticities:
    """The primaries of an ICC profile, given its columns X, Y, Z [3, 3], which are adapted to D50.

    A named set is returned if it matches; else equivalent primaries with the white D50.
    """
    for known in NAMED.values():
        native = xyz_of_primaries(known)
        if np.abs(adaptation(native.sum(1), _D50) @ native - columns).max() < _SAME:
            return known
    points = np.c_[columns, columns.sum(1)]
    return tuple((points[:2] / points.sum(0)).T.ravel().tolist())


def converted(pixels: NDArray[np.float32], matrix: NDArray[np.float32] | None) -> Any:
    """Linear pixels [H, W, 3…] whose first three channels are multiplied by a matrix [3, 3].

    Without a matrix they are unchanged.
    """
    if matrix is None:
        return pixels
    return np.concatenate([pixels[..., :3] @ matrix.T, pixels[..., 3:]], axis=-1)

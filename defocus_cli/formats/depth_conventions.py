"""Depth conventions, one row each: what the numbers of a depth file mean.

Nothing is read off the range of the values. A file type and the type of its samples have a custom,
or none: floats are metres, and 16-bit integers of PNG and TIFF millimetres; integers of EXR and NPY
have no custom, so that their convention must be named (``--depth-unit``).

A new convention is a new row: the other modules read this table.
"""

from __future__ import annotations

from dataclasses import dataclass

HALF_SKY = 65504.0  # the largest number that half can hold


@dataclass(frozen=True)
class DepthConvention:
    """What the numbers of a depth file mean. NaN, 0 and negative numbers are no depth.

    Attributes:
        name: as ``--depth-unit`` has it.
        words: how people read the numbers, for notes.
        scale: metres of 1 in the file.
        sky: numbers of the file from this one on are sky.
        custom_of: file types and their samples that follow it unless another is named, like
            ``EXR float``; a raster is a PNG or TIFF.
    """

    name: str
    words: str
    scale: float
    sky: float = 1e10
    custom_of: tuple[str, ...] = ()

    def least_sky(self, *, half: bool) -> float:
        """The least number that is sky, in a file of half or of other samples."""
        return min(self.sky, HALF_SKY) if half else self.sky


_ROWS = (
    DepthConvention(
        name="mm",
        words="millimetres",
        scale=1e-3,
        custom_of=("raster integer",),
    ),
    DepthConvention(name="cm", words="centimetres", scale=1e-2),
    DepthConvention(
        name="m",
        words="metres",
        scale=1.0,
        custom_of=("EXR float", "PFM float", "NPY float", "raster float"),
    ),
    DepthConvention(name="ft", words="feet", scale=0.3048),
)
CONVENTIONS = {convention.name: convention for convention in _ROWS}


def custom(file_type: str, *, integers: bool) -> DepthConvention | None:
    """The convention that a file type follows unless another is named; None if it has none.

    Args:
        file_type: EXR, PFM, NPY or raster.
        integers: whether its samples are integers; else they are floats.
    """
    samples = f"{file_type} {'integer' if integers else 'float'}"
    return next((each for each in _ROWS if samples in each.custom_of), None)

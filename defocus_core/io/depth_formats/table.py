"""The table of depth formats by name, the units of depth, and the custom of each type of file.

Nothing is read off the range of the values. A file without a named format follows the custom of its
type: floats are metres, and 16-bit integers of PNG and TIFF millimetres; integers of EXR and NPY
have no custom, so that their unit must be set (``depth_unit``).

A new format is a row of `renderers`, `depth_datasets`, `stereo_datasets` or `networks`, and a line
of ``help/depth.md``, which the test of that topic prints; the other modules read this table.
"""

from __future__ import annotations

from defocus_core.io.depth_formats.depth_datasets import DEPTH_DATASETS
from defocus_core.io.depth_formats.depth_numbers import DepthNumbers
from defocus_core.io.depth_formats.networks import NETWORKS
from defocus_core.io.depth_formats.renderers import RENDERERS
from defocus_core.io.depth_formats.rules import DepthFormat
from defocus_core.io.depth_formats.stereo_datasets import STEREO_DATASETS

ROWS: tuple[DepthFormat, ...] = (*RENDERERS, *DEPTH_DATASETS, *STEREO_DATASETS, *NETWORKS)
FORMATS = {row.name: row for row in ROWS}
NAMES = {name: row for row in ROWS for name in (row.name, *row.aliases)}
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "ft": 0.3048}  # metres of 1 in the file
UNIT_WORDS = {"mm": "millimetres", "cm": "centimetres", "m": "metres", "ft": "feet"}


def custom(samples: DepthNumbers) -> str | None:
    """The unit that numbers of a type have unless one is set; None if the type has no custom."""
    if samples.type == "16-bit PNG":
        return "mm"
    return None if samples.is_integer else "m"

"""The drawing of ``defocus info --preview``: where the depth of a picture is repaired."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.batch.lenses.lens import Lens
from defocus_core.errors import UsageProblem
from defocus_core.io.arrays import bands
from defocus_core.io.images.color import Color
from defocus_core.io.images.color_space import quantised
from defocus_core.io.images.encode import display_encoded, write_samples
from defocus_core.picture.pair import InputPair, read
from defocus_core.picture.radii import radii_of
from defocus_core.picture.repair_words import repair_record, repair_words
from defocus_core.picture.sources import to_array
from defocus_core.picture.steps.focusing import with_blur_reach, with_focus

# Brightness of the grey picture below the false colours; px of radius from which these are full.
_DIMMED, _FULL = 0.5, 2.0
NEAR, FAR = (1.0, 0.55, 0.0), (0.25, 0.6, 1.0)  # sRGB


def check_preview(path: Path, files: Sequence[Path], lens: Lens | None) -> None:
    """Refuse a drawing that cannot be made."""
    if lens is None or lens.is_shape:
        problem, remedy = "needs a lens, whose blur decides the repair", "give ‹lens› FILE.toml"
        raise UsageProblem(
            "missing-option", problem, f"{remedy}, or ‹focal-length›, … ‹focus›", field="preview"
        )
    if path.suffix.lower() != ".png":
        raise UsageProblem(
            "malformed", f"{path} is no PNG", "name a file that ends in .png", field="preview"
        )
    if path.exists() and any(file.exists() and path.samefile(file) for file in files):
        raise UsageProblem(
            "replaces-input", f"{path} is a file to look at", "name another file", field="preview"
        )


def draw_repair(pairs: Sequence[dict[str, Any]], reading: Reading, lens: Lens, path: Path) -> None:
    """Draw the repair of the one picture, and add it to its record.

    Beside the picture stands what `defocus render` would do to it: orange made nearer, blue made
    farther; colour is full from 2 px of radius on.
    """
    if not pairs:
        problem, remedy = "needs a colour and a depth file of one size", "name the two files"
        raise UsageProblem(
            "missing-option", problem, f"{remedy}, or say ‹resize-depth›", field="preview"
        )
    (pair,) = pairs
    picture = Picture(Path(pair["color"]).stem, Path(pair["color"]), Path(pair["depth"]))
    color, depth = read(InputPair(picture, reading, lens_focal=lens.foclen / lens.sensor_width))
    radii = radii_of(with_blur_reach(with_focus(lens, depth), (depth,)), depth)
    repaired, repair = radii.repair(color, reading)
    height, width = radii.px.shape
    write_samples(path, (height, 2 * width), _strips(color, radii.px, repaired), "png", {})
    pair["repair"], pair["depth_repair"] = repair_words(repair), repair_record(repair)
    pair["preview"] = str(path)


def _strips(color: Color, given: Any, repaired: Any) -> Iterator[NDArray[Any]]:
    """Rows of the picture and its repair, from the radii [H, W] px before and after it."""
    channels = color.channels
    planes = color.planes[: len(channels)]
    for rows in bands(given.shape):
        pixels = np.stack([plane[rows] for plane in planes], -1).astype(np.float32)
        shown, _, _ = display_encoded(pixels, channels, 8, keep_alpha=False)
        shown = np.broadcast_to(shown[..., :3], (*shown.shape[:2], 3))
        grey = _DIMMED * shown.mean(axis=2, dtype=np.float32)[:, :, None] / 255
        change = (to_array(repaired[rows]) - given[rows])[:, :, None]
        amount = np.sqrt(np.minimum(np.abs(change) / _FULL, 1))
        hue = np.where(change < 0, np.array(NEAR, np.float32), np.array(FAR, np.float32))
        mixed = grey + amount * (hue - grey)
        yield np.concatenate([shown, quantised(mixed.astype(np.float32), 8)], 1)

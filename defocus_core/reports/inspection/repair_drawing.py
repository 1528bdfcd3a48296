"""The drawing of ``defocus info --preview``: where the depth of a picture is repaired."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.batch.lenses.lens import Lens
from defocus_core.errors import UsageProblem
from defocus_core.io.arrays import Keeping


def check_preview(path: Path, files: Sequence[Path], lens: Lens | None) -> None:
    """Refuse a drawing that cannot be made.

    Raises:
        UsageProblem: there is no lens, or the file is no PNG or an input.
    """
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

    Raises:
        InputError: a file cannot be read, or the drawing not be written.
        UsageProblem: the files are no picture.
    """
    from defocus_core.batch.depth.repair_words import repair_record, repair_words
    from defocus_core.batch.rendering.repair_preview import repaired_picture, write_repair_preview

    if not pairs:
        problem, remedy = "needs a colour and a depth file of one size", "name the two files"
        raise UsageProblem(
            "missing-option", problem, f"{remedy}, or say ‹resize-depth›", field="preview"
        )
    (pair,) = pairs
    picture = Picture(Path(pair["color"]).stem, Path(pair["color"]), Path(pair["depth"]))
    drawn = repaired_picture(picture, reading, lens, Keeping(scratch=False))
    write_repair_preview(path, drawn)
    pair["repair"], pair["depth_repair"] = repair_words(drawn.repair), repair_record(drawn.repair)
    pair["preview"] = str(path)

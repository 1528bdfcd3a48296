"""Writes what a job made: all files of a picture, or none."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from defocus_cli.quantities import length_text
from defocus_cli.report import version

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from defocus_cli.engine import Outcome
    from defocus_cli.images import Color
    from defocus_cli.job import Outputs

DISPARITY_PER_RADIUS = 8 / (3 * math.pi)  # distance of the centroids of two half discs


def deliver(
    color: Color,
    radius: NDArray[np.float32],
    images: Mapping[str, NDArray[np.float32]],
    outcome: Outcome,
) -> tuple[str, ...]:
    """Write what a job asks for, all or nothing.

    Args:
        color: what was read, with the metadata and further channels to carry along.
        radius: signed CoC radius in px, [H, W].
        images: kind to linear pixels [H, W, C].
        outcome: what the header of an EXR tells about the job.

    Returns:
        What the files could not hold, for people.

    Raises:
        InputError: a file cannot be written.
    """
    from defocus_cli.encode import write_image, write_map
    from defocus_cli.preview import write_coc_preview, write_preview

    outputs, stem = outcome.job.outputs, outcome.job.picture.stem
    paths, previews = outputs.paths(stem), outputs.previews(stem)
    maps = {"coc": radius, "disparity": radius * DISPARITY_PER_RADIUS}
    warnings: list[str] = []
    with _all_or_nothing(outputs) as written:
        for kind, path in paths.items():
            attributes = _attributes(outcome, kind)
            if kind in images:
                lost = write_image(
                    path,
                    images[kind],
                    color.channels,
                    exr_type=outputs.exr_type,
                    bits=16 if outputs.format == "png16" else 8,
                    attributes={**color.attributes, **attributes},
                    extras=color.extras,
                )
                warnings += [f"{kind}: {warning}" for warning in lost]
            else:
                write_map(path, maps[kind], kind, attributes=attributes)
            written.append(path)
            if kind in previews:
                if kind in images:
                    write_preview(previews[kind], images[kind])
                else:
                    write_coc_preview(previews[kind], maps[kind])
                written.append(previews[kind])
    return tuple(warnings)


@contextmanager
def _all_or_nothing(outputs: Outputs) -> Iterator[list[Path]]:
    """Collects files as they are written; if the block fails, they and new directories go again."""
    folders = [
        *(outputs.root / kind for kind in outputs.kinds),
        outputs.root,
        *outputs.root.parents,
    ]
    new = [folder for folder in folders if not folder.exists()]
    written: list[Path] = []
    try:
        yield written
    except BaseException:
        for path in written:
            path.unlink(missing_ok=True)
        for folder in new:
            with suppress(OSError):  # it may hold pictures finished before, or never came to be
                folder.rmdir()
        raise


def _attributes(outcome: Outcome, kind: str) -> dict[str, str]:
    """What an EXR output says of itself: no directory and no time, so that its bytes are fixed."""
    job, lens = outcome.job, outcome.lens
    values = {
        "version": version(),
        "kind": kind,
        "color": job.picture.color.name,
        "depth": job.picture.depth.name,
        "depth_read_as": outcome.depth_note,
        "focal_length": length_text(lens.foclen, 9),
        "fnumber": f"{lens.fnum:.9g}",
        "sensor_width": length_text(lens.sensor_width, 9),
        "focus": "" if lens.foc_dist is None else length_text(lens.foc_dist, 9),
        "blades": str(lens.blades),
        "blade_rotation": f"{lens.blade_rotation:.9g}deg",
        "coc_px": " ".join(f"{radius:.6g}" for radius in outcome.coc_px),
        "quality": job.machine.quality,
        "device": outcome.device,
    }
    return {f"defocus:{name}": value for name, value in values.items()}

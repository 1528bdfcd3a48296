"""The files of a rendered job, all written or none."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from defocus_cli.jobs.quantities import length_text
from defocus_cli.system.arrays import Stack
from defocus_cli.system.console import version
from defocus_cli.system.errors import InputError
from defocus_cli.system.safe_files import written_together

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from defocus_cli.formats.color import Color
    from defocus_cli.formats.kinds import Kind
    from defocus_cli.rendering.outcome import Outcome


class _OfRadius:
    """A map that is computed from the signed radii [H, W], a few rows at a time."""

    def __init__(self, radius: Any, compute: Callable[[Any], Any]) -> None:
        self._radius, self._compute = radius, compute
        self.shape, self.dtype = radius.shape, radius.dtype

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        values: NDArray[Any] = self._compute(self._radius[rows])
        return values


def deliver(
    color: Color,
    radius: Any,
    images: Mapping[str, tuple[Any, ...]],
    clamped: Mapping[str, int],
    outcome: Outcome,
) -> tuple[str, ...]:
    """Write what a job asks for, all or nothing.

    Args:
        color: what was read, with the metadata and further channels to carry along.
        radius: signed CoC radius in px, [H, W].
        images: each rendered kind's arrays [H, W]: C of an image, in linear light; one of a map.
        clamped: how many pixels of a kind were clamped to be half.
        outcome: what the header of an EXR tells about the job.

    Returns:
        What the files could not hold, for people.

    Raises:
        InputError: a file cannot be written.
    """
    from defocus_cli.formats.encode import write_image
    from defocus_cli.formats.exr import write_exr
    from defocus_cli.rendering.preview import write_preview, write_signed_preview

    outputs = outcome.job.outputs
    paths, previews = outcome.job.paths, outcome.job.previews
    warnings: list[str] = []
    if not outputs.root.is_dir():  # made anew, it would have no journal
        problem = "was removed while jobs were done"
        raise InputError(outputs.root, problem, "run the same command again")
    with written_together():
        for kind in outputs.rows:
            path, preview = paths[kind.name], previews.get(kind.name)
            planes = (_OfRadius(radius, kind.of_radius),) if kind.of_radius else images[kind.name]
            attributes = _attributes(outcome, kind)
            if kind.image:
                lost = write_image(
                    path,
                    Stack(planes),
                    color.channels,
                    exr_type=outputs.exr_type,
                    bits=16 if outputs.format == "png16" else 8,
                    jpeg_quality=outputs.jpeg_quality,
                    attributes={**color.attributes, **attributes},
                    extras=color.extras,
                    corner=color.corner,
                    clamped=clamped.get(kind.name, 0),
                )
                warnings += [f"{kind.name}: {warning}" for warning in lost]
            else:
                write_exr(path, {kind.name: planes[0]}, attributes, color.corner)
            if preview is not None and kind.of_radius:
                write_signed_preview(preview, planes[0])
            elif preview is not None:
                write_preview(preview, Stack(planes))
    if outputs.format == "exr" and any(kind.image for kind in outputs.rows):
        warnings += color.left_out
    return tuple(warnings)


def _attributes(outcome: Outcome, kind: Kind) -> dict[str, str]:
    """What an EXR output says of itself: no directory and no time, so that its bytes are fixed."""
    job, lens, hidden = outcome.job, outcome.lens, outcome.job.picture.hidden
    values = {
        "version": version(),
        "kind": kind.name,
        "color": job.picture.color.name,
        "depth": job.picture.depth.name,
        "hidden": "" if hidden is None else f"{hidden.color.name} {hidden.depth.name}",
        "color_read_as": outcome.color_note,
        "depth_read_as": outcome.depth_told(rendered=kind.rendered),
        "focal_length": length_text(lens.foclen, 9),
        "fnumber": f"{lens.fnum:.9g}",
        "sensor_width": length_text(lens.sensor_width, 9),
        "focus": "" if lens.foc_dist is None else length_text(lens.foc_dist, 9),
        "blades": str(lens.blades),
        "blade_rotation": f"{lens.blade_rotation:.9g}deg",
        "coc_px": " ".join(f"{radius:.6g}" for radius in outcome.coc_px),
        "quality": outcome.quality,
        "device": outcome.device,
    }
    return {f"defocus:{name}": value for name, value in values.items()}

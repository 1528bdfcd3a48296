"""Writing the images and maps of a job: all files or none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from defocus_cli.jobs.quantities import length_text
from defocus_cli.rendering.focus_picture import focus_planes
from defocus_cli.rendering.noisy_planes import noisy
from defocus_cli.rendering.opening import disparity_of
from defocus_cli.system.arrays import Stack
from defocus_cli.system.console import version
from defocus_cli.system.errors import InputError
from defocus_cli.system.safe_files import written_together

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from defocus_cli.formats.kinds import Kind
    from defocus_cli.jobs.job import Lens
    from defocus_cli.rendering.outcome import Outcome, Rendering


class _OfRadius:
    """A map that is computed from the signed radii [H, W], a few rows at a time."""

    def __init__(self, radius: Any, compute: Callable[[Any], Any]) -> None:
        self._radius, self._compute = radius, compute
        self.shape, self.dtype = radius.shape, radius.dtype

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        values: NDArray[Any] = self._compute(self._radius[rows])
        return values


def write(rendering: Rendering) -> Outcome:
    """Write the files of a job, all or none; its outcome, with warnings of what they cannot hold.

    Raises:
        InputError: a file cannot be written.
    """
    outcome, outputs = rendering.outcome, rendering.outcome.job.outputs
    if not outputs.root.is_dir():  # created again, it would have no journal
        problem = "was removed while jobs were done"
        raise InputError(outputs.root, problem, "run the same command again")
    with written_together():
        warnings = [warning for kind in outputs.rows for warning in _write_kind(rendering, kind)]
    if outputs.format == "exr" and any(kind.image for kind in outputs.rows):
        warnings += rendering.color.left_out
    return replace(outcome, warnings=(*outcome.warnings, *warnings))


def _write_kind(rendering: Rendering, kind: Kind) -> list[str]:
    """Write the file of a kind, and its preview if there is to be one; the warnings."""
    from defocus_cli.formats.encode import write_image
    from defocus_cli.formats.exr import write_exr
    from defocus_cli.rendering.preview import write_preview, write_signed_preview

    color, job, warnings = rendering.color, rendering.outcome.job, []
    path, preview = job.paths[kind.name], job.previews.get(kind.name)
    if kind.of_picture:
        color = replace(color, channels=("R", "G", "B"), extras={})
    planes = _planes(rendering, kind)
    attributes = _attributes(rendering.outcome, kind)
    if kind.image and kind.rendered and rendering.outcome.lens.noise:
        planes = noisy(planes, color.channels, job, rendering.outcome.lens, kind)
    if kind.image:
        lost = write_image(
            path,
            Stack(planes),
            color.channels,
            exr_type=job.outputs.exr_type,
            bits=16 if job.outputs.format == "png16" else 8,
            jpeg_quality=job.outputs.jpeg_quality,
            attributes={**color.attributes, **attributes},
            extras=color.extras,
            corner=color.corner,
            clamped=rendering.clamped.get(kind.name, 0),
        )
        warnings = [f"{kind.name}: {warning}" for warning in lost]
    else:
        write_exr(path, {kind.name: planes[0]}, attributes, color.corner)
    if preview is not None and kind.of_radius:
        write_signed_preview(preview, planes[0])
    elif preview is not None:
        write_preview(preview, Stack(planes))
    return warnings


def _planes(rendering: Rendering, kind: Kind) -> tuple[Any, ...]:
    """The arrays [H, W] of a kind."""
    if kind.of_picture:
        return focus_planes(rendering.color, rendering.radius)
    if kind.of_radius:
        values = partial(_values, kind, disparity_of(rendering.outcome.lens))
        return (_OfRadius(rendering.radius, values),)
    return rendering.images[kind.name]


def _values(kind: Kind, disparity: float, radius: Any) -> Any:
    """Values of a map from signed radii, and from the disparity of a radius of a px."""
    assert kind.of_radius is not None
    return kind.of_radius(radius, disparity)


def _attributes(outcome: Outcome, kind: Kind) -> dict[str, str]:
    """Attributes of an EXR output; no directory and no time, so that its bytes are repeatable."""
    job, lens, hidden = outcome.job, outcome.lens, outcome.job.picture.hidden
    values = {
        "version": version(),
        "kind": kind.name,
        "color": job.picture.color.name,
        "depth": job.picture.depth.name,
        "hidden": "" if hidden is None else f"{hidden.color.name} {hidden.depth.name}",
        "color_read_as": outcome.color_note,
        "depth_read_as": outcome.depth_words(rendered=kind.rendered),
        **_optics(lens),
        "blades": str(lens.blades),
        "blade_rotation": f"{lens.blade_rotation:.9g}deg",
        **{name: str(value) for name, value in lens.effects.items()},
        "coc_px": " ".join(f"{radius:.6g}" for radius in outcome.coc_px),
        "quality": outcome.quality,
        "device": outcome.device,
    }
    return {f"defocus:{name}": value for name, value in values.items()}


def _optics(lens: Lens) -> dict[str, str]:
    """What of a lens decides the radii; nothing where a file holds them."""
    if lens.is_shape:
        return {}
    return {
        "focal_length": length_text(lens.foclen, 9),
        "fnumber": f"{lens.fnum:.9g}",
        "sensor_width": length_text(lens.sensor_width, 9),
        "focus": "" if lens.foc_dist is None else length_text(lens.foc_dist, 9),
    }

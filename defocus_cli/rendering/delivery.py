"""Writing the images and maps of a job: all files or none."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from defocus_cli.jobs.quantities import length_text
from defocus_cli.rendering.depth_repair import repair_attribute
from defocus_cli.system.arrays import Stack
from defocus_cli.system.console import version
from defocus_cli.system.errors import InputError
from defocus_cli.system.safe_files import written_together

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from defocus_cli.exr.windows import Window
    from defocus_cli.formats.kinds import Kind
    from defocus_cli.jobs.job import Lens
    from defocus_cli.rendering.outcome import Outcome, Rendering


class _OfRadius:
    """A map that is computed from the signed radii [H, W], a few rows at a time; 0 of nothing."""

    def __init__(self, radius: Any, compute: Callable[[Any], Any], nothing: Any) -> None:
        self._radius, self._compute, self._nothing = radius, compute, nothing
        self.shape, self.dtype = radius.shape, radius.dtype

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        values: NDArray[Any] = self._compute(self._radius[rows])
        if self._nothing is not None:
            values = values * ~self._nothing[rows]
        return values


class _Shown:
    """The rows and columns of an array [H, W] that are written, a few rows at a time."""

    def __init__(self, whole: Any, window: tuple[slice, slice]) -> None:
        self._whole, (self._rows, self._columns) = whole, window
        self.shape = (
            self._rows.stop - self._rows.start,
            self._columns.stop - self._columns.start,
        )
        self.dtype = whole.dtype

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        first, last, _ = rows.indices(self.shape[0])
        top = self._rows.start
        values: NDArray[Any] = self._whole[top + first : top + last]
        return values[:, self._columns]


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
    from defocus_cli.exr.writing import write_exr
    from defocus_cli.formats.encode import write_image
    from defocus_cli.rendering.preview import write_preview, write_signed_preview

    color, job, warnings = rendering.color, rendering.outcome.job, []
    path, preview = job.paths[kind.name], job.previews.get(kind.name)
    planes = (
        (_OfRadius(rendering.radius, kind.of_radius, rendering.nothing),)
        if kind.of_radius
        else rendering.images[kind.name]
    )
    extras: Mapping[str, Any] = {}
    if kind.image:
        extras = color.extras | _passes(rendering, planes[len(color.channels) :])
        planes = planes[: len(color.channels)]
    planes, extras, corner, display = _written(rendering, planes, extras)
    attributes = _attributes(rendering.outcome, kind)
    if kind.image:
        lost = write_image(
            path,
            Stack(planes),
            color.channels,
            exr_type=job.outputs.exr_type,
            bits=16 if job.outputs.format == "png16" else 8,
            jpeg_quality=job.outputs.jpeg_quality,
            attributes={**color.attributes, **attributes},
            extras=extras,
            corner=corner,
            display=display,
            clamped=rendering.clamped.get(kind.name, 0),
        )
        warnings = [f"{kind.name}: {warning}" for warning in lost]
    else:
        write_exr(path, {kind.name: planes[0]}, attributes, corner, display)
    if preview is not None and kind.of_radius:
        write_signed_preview(preview, planes[0])
    elif preview is not None:
        write_preview(preview, Stack(planes))
    return warnings


def _passes(rendering: Rendering, planes: tuple[Any, ...]) -> dict[str, Any]:
    """The blurred passes by name, of the number type of the picture."""
    from defocus_cli.formats.encode import as_half

    half = rendering.outcome.job.outputs.exr_type == "half"
    named = zip(rendering.color.passes, planes, strict=True)
    return {name: as_half(plane) if half else plane for name, plane in named}


def _written(
    rendering: Rendering, planes: tuple[Any, ...], extras: Mapping[str, Any]
) -> tuple[tuple[Any, ...], Mapping[str, Any], tuple[int, int], Window | None]:
    """Planes and extras without overscan, or with it; x and y of the first pixel; the display."""
    from defocus_cli.exr.windows import Window

    color, outputs = rendering.color, rendering.outcome.job.outputs
    (x, y), overscan = color.corner, color.overscan
    if not any(overscan):
        return planes, extras, color.corner, None
    if outputs.keep_overscan:
        width, height = color.size
        display = Window(x, y, x + width - 1, y + height - 1)
        return planes, extras, (x - overscan.left, y - overscan.top), display
    window = overscan.shown(*color.shape[:2])
    extras = {name: _Shown(plane, window) for name, plane in extras.items()}
    return tuple(_Shown(plane, window) for plane in planes), extras, color.corner, None


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
        **_repair(outcome, kind),
        **_optics(lens),
        "blades": str(lens.blades),
        "blade_rotation": f"{lens.blade_rotation:.9g}deg",
        "coc_px": " ".join(f"{radius:.6g}" for radius in outcome.coc_px),
        "quality": outcome.quality,
        "device": outcome.device,
    }
    return {f"defocus:{name}": value for name, value in values.items()}


def _repair(outcome: Outcome, kind: Kind) -> dict[str, str]:
    """What was asked of the repair of depth, and what it did; nothing where neither is unusual."""
    if not kind.rendered:
        return {}
    reading = outcome.job.reading
    asked = [f"--depth-repair {reading.depth_repair}"] * (reading.depth_repair != "auto")
    if reading.edge_width is not None:
        asked.append(f"--edge-width {reading.edge_width:g}px")
    values = {
        "depth_repair_asked": " ".join(asked),
        "depth_repair": repair_attribute(outcome.repair),
    }
    return {name: value for name, value in values.items() if value}


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

"""The files of a rendered job, all written or none."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from defocus_cli.jobs.quantities import length_text
from defocus_cli.system.arrays import Stack
from defocus_cli.system.console import version
from defocus_cli.system.errors import InputError
from defocus_cli.system.safe_files import leftover, sync_folder, unwritable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from defocus_cli.formats.color import Color
    from defocus_cli.formats.kinds import Kind
    from defocus_cli.jobs.job import Outputs
    from defocus_cli.rendering.outcome import Outcome


class _OfRadius:
    """A map that is computed from the signed radii [H, W], a few rows at a time."""

    def __init__(self, radius: Any, kind: Kind) -> None:
        self._radius, self._kind = radius, kind
        self.shape, self.dtype = radius.shape, radius.dtype

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        values: NDArray[Any] = self._kind.compute(self._radius[rows])
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
    from defocus_cli.formats.encode import write_image, write_map
    from defocus_cli.rendering.preview import write_preview, write_signed_preview

    outputs = outcome.job.outputs
    paths, previews = outcome.job.paths, outcome.job.previews
    warnings: list[str] = []
    with _all_or_nothing(outputs) as written:
        for kind in outputs.rows:
            path, preview = paths[kind.name], previews.get(kind.name)
            planes = images[kind.name] if kind.rendered else (_OfRadius(radius, kind),)
            written.begin(path)
            attributes = _attributes(outcome, kind)
            if kind.image:
                lost = write_image(
                    path,
                    Stack(planes),
                    color.channels,
                    exr_type=outputs.exr_type,
                    bits=16 if outputs.format == "png16" else 8,
                    attributes={**color.attributes, **attributes},
                    extras=color.extras,
                    corner=color.corner,
                    clamped=clamped.get(kind.name, 0),
                )
                warnings += [f"{kind.name}: {warning}" for warning in lost]
            else:
                write_map(path, planes[0], kind.name, attributes=attributes, corner=color.corner)
            written.placed(path)
            if preview is not None:
                written.begin(preview)
                if kind.signed_preview:
                    write_signed_preview(preview, planes[0])
                else:
                    write_preview(preview, Stack(planes))
                written.placed(preview)
        written.sync()
    if outputs.format == "exr" and any(kind.image for kind in outputs.rows):
        warnings += color.left_out
    return tuple(warnings)


class _Replaced:
    """Files as they are written, and what each of them replaces."""

    def __init__(self) -> None:
        self._before: dict[Path, Path | None] = {}
        self._placed: dict[Path, os.stat_result] = {}

    def begin(self, path: Path) -> None:
        """Keep what is at a path that is about to be written."""
        kept = path.with_name(f"{leftover(path, os.getpid())}before")
        try:
            os.link(path, kept)
        except FileNotFoundError:
            self._before[path] = None
        except OSError:  # a directory, or a file system without links
            if not path.is_file():
                return
            try:
                shutil.copy2(path, kept)
            except OSError as error:
                kept.unlink(missing_ok=True)
                raise unwritable(path, error) from error
            self._before[path] = kept
        else:
            self._before[path] = kept

    def placed(self, path: Path) -> None:
        """Know our file again: a cluster may do a job twice, and the other one's is not ours."""
        try:
            self._placed[path] = path.stat()
        except OSError as error:
            raise unwritable(path, error) from error

    def _is_ours(self, path: Path) -> bool:
        with suppress(KeyError, OSError):
            return os.path.samestat(self._placed[path], path.stat())
        return False

    def sync(self) -> None:
        """Make the names of the new files durable, too."""
        folders = {path.parent for path in self._before}
        for folder in folders | {folder.parent for folder in folders}:
            try:
                sync_folder(folder)
            except OSError as error:
                raise unwritable(folder, error) from error

    def forget(self) -> None:
        """The new files stay."""
        for kept in self._before.values():
            if kept is not None:
                kept.unlink(missing_ok=True)

    def restore(self) -> None:
        """The old files come back, and where there were none there is none."""
        for path, kept in self._before.items():
            ours = self._is_ours(path)
            if kept is not None:
                if ours:
                    kept.replace(path)
                kept.unlink(missing_ok=True)  # two names of one file stay two
            elif ours:
                path.unlink(missing_ok=True)


@contextmanager
def _all_or_nothing(outputs: Outputs) -> Iterator[_Replaced]:
    """Files that are written in the block; if it fails, all is as it was before."""
    if not outputs.root.is_dir():  # made anew, it would have no journal
        problem = "was removed while jobs were done"
        raise InputError(outputs.root, problem, "run the same command again")
    folders = [outputs.root / kind for kind in outputs.kinds]
    new = [folder for folder in folders if not folder.exists()]
    replaced = _Replaced()
    try:
        yield replaced
    except BaseException:
        replaced.restore()
        for folder in new:
            with suppress(OSError):  # it may hold pictures finished before, or never came to be
                folder.rmdir()
        raise
    replaced.forget()


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

"""Layers of the files that a batch wrote of a sample: OUT/<kind>/<sample>."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from defocus_core.batch.jobs.output_kinds import KINDS, SUFFIXES
from defocus_core.compare.picture import DecodedPicture, color_layers, read_picture
from defocus_core.errors import InputError
from defocus_core.io.images.describe import describe
from defocus_core.reports.html import thumbnails
from defocus_core.reports.html.item import Layer
from defocus_core.reports.html.layers import B, Drawn, draw, shown_channels

VIEWS = ("left", "right")
_MAX_DRAWN = 2**27  # numbers of a file: 8192 x 4096 px of four channels
_VIEW_SIDE = 960  # px of the thumbnails of views beside values


def beside(path: Path) -> Iterator[tuple[str, Path]]:
    """Kind and file of what a batch wrote of the same sample, other than the file itself."""
    own, root = path.parent.name, path.parent.parent
    if own not in KINDS:
        return
    suffixes = dict.fromkeys([path.suffix, *SUFFIXES.values()])
    for kind in KINDS.values():
        endings = suffixes if kind.image else (".exr",)
        files = (root / kind.name / f"{path.stem}{suffix}" for suffix in endings)
        file = next((file for file in files if file.is_file()), None)
        if kind.name != own and file is not None:
            yield kind.name, file


def drawn_files(files: Iterable[tuple[str, Path]], *, values: bool) -> Iterator[Drawn]:
    """The layers of files, each with its kind; those too large, or not readable, are left out."""
    for title, path in files:
        with suppress(InputError):
            header = describe(path)
            if header.pixels * max(len(part.channels) for part in header.parts) > _MAX_DRAWN:
                continue
            picture = read_picture(path)
            for key, names in _views(title, picture):
                side = _VIEW_SIDE if values and key in VIEWS else thumbnails.SIDE
                yield draw(key, key, picture, names, side=side)


def _views(title: str, picture: DecodedPicture) -> Iterator[tuple[str, Sequence[str]]]:
    """Key and channels of each view of a file of several, or of its picture."""
    views = KINDS[title].views if title in KINDS else ()
    if not views:
        yield title, shown_channels(list(picture.planes))
    for names in color_layers(list(picture.planes)) if views else ():
        view = names[0].rpartition(".")[0] or views[0]
        if view in views:
            yield view, names


def is_view(drawn: Drawn) -> bool:
    """Whether a layer is a view of the left or the right half of the lens."""
    return drawn.layer.key in VIEWS


def wiggle_of(layers: Sequence[Layer], path: Path | None = None) -> tuple[str, ...]:
    """Keys of the left and the right view, where there are both; ``b`` for the file of B."""
    keys = {layer.key: layer.key for layer in layers}
    if path is not None and path.parent.name in VIEWS and B in keys:
        keys[path.parent.name] = B
    return tuple(keys[view] for view in VIEWS) if set(VIEWS) <= keys.keys() else ()

"""Contact sheets in PNG: pictures of a batch, or the same lights with several lenses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.errors import CALLER, UsageProblem
from defocus_core.io.images.color import read_color
from defocus_core.io.images.color_space import linear_to_srgb, quantised
from defocus_core.io.images.encode import write_samples
from defocus_core.io.write_files import CONTACT, KIND, identities, require_replaceable
from defocus_core.picture.opening import aperture_of, cat_eye_of
from defocus_core.reports.html.thumbnails import resized
from defocus_core.request.job import Job
from defocus_core.request.lens_files import ShippedLens, read_lens_file
from defocus_core.request.resolver import laid_over, lens_of, parsed
from defocus_core.system.process import set_to_render

if TYPE_CHECKING:
    from torch import Tensor

NAME = "contact.png"
_WIDTH = 320  # px of a picture
_LENS_SIZE = (200, 300)  # height and width in px of a picture of a lens
_LENS_RADIUS = 22.0  # px, greatest CoC radius
_LENS_FOCUS = "100m"  # beyond every focal length; the radii are those of the lights
_LENS_COLUMNS = 3
_LINE, _LETTERS, _MARGIN = 26, 16, 8  # px of a line of words
_GREY = 0.8  # colour of words, in sRGB


def _kind_of_sheet(jobs: Sequence[Job]) -> str:
    """The kind of output that a contact sheet shows: the first kind that is an image."""
    for kind in jobs[0].outputs.rows:
        if kind.image:
            return kind.name
    problem = "shows images, but maps alone are written"
    remedy = "add one, like ‹outputs› render,coc"
    raise UsageProblem("idle-option", problem, remedy, field="contact")


def require_room(jobs: Sequence[Job]) -> None:
    """Raise an error if no output is an image, or if an output has the name of the sheet."""
    _kind_of_sheet(jobs)
    pictures = {id(job.picture): job.picture for job in jobs}.values()
    inputs = identities(path for picture in pictures for path in picture.files.values())
    require_replaceable(jobs[0].outputs.root / NAME, CONTACT, inputs=inputs)


def write_contact_sheet(jobs: Sequence[Job], count: int) -> Path | None:
    """Write a sheet of at most ``count`` pictures, evenly spread over those that exist.

    Returns its path; None if no picture exists.
    """
    kind = _kind_of_sheet(jobs)
    there = [job for job in jobs if job.paths[kind].exists()]
    if not there:
        return None
    places = np.unique(np.linspace(0, len(there) - 1, count).round().astype(int))
    chosen = [there[place] for place in places]
    pictures = [_labelled(_small(job.paths[kind]), job.sample_id, _WIDTH) for job in chosen]
    file = jobs[0].outputs.root / NAME
    _write(file, pictures, math.ceil(math.sqrt(len(pictures))))
    return file


def write_lens_sheet(path: Path, lenses: Sequence[ShippedLens]) -> None:
    """Write a sheet of the same lights with each lens, in rows from the top."""
    set_to_render()
    _write(path, [_labelled(_lights(each), each.name) for each in lenses], _LENS_COLUMNS)


def _write(path: Path, pictures: Sequence[NDArray[Any]], columns: int) -> None:
    """Write sRGB pictures of equal width in rows, each as high as the highest, with black below."""
    height = max(map(len, pictures))
    cells = [np.pad(each, ((0, height - len(each)), (0, 0), (0, 0))) for each in pictures]
    cells += [np.zeros_like(cells[0])] * (-len(cells) % columns)
    rows = [np.concatenate(cells[i : i + columns], 1) for i in range(0, len(cells), columns)]
    sheet = quantised(np.concatenate(rows), 8)
    write_samples(path, sheet, "png", {KIND: CONTACT})


def _lights(shipped: ShippedLens) -> NDArray[Any]:
    """A rendered picture of lights nearer and farther than the focus, by a lens: sRGB [H, W, 3]."""
    from defocus_core.renderer.render import render

    focus = {"focus": parsed("focus", _LENS_FOCUS, CALLER)}
    lens = lens_of(laid_over(read_lens_file(shipped.path), focus))
    image, radius = _night(*_LENS_SIZE)
    cat_eye = cat_eye_of(lens, _LENS_SIZE[::-1])
    shown = render(image, radius, aperture=aperture_of(lens), cat_eye=cat_eye).render
    return linear_to_srgb(shown.movedim(0, -1).contiguous().numpy().clip(0, 1))


def _night(height: int, width: int) -> tuple[Tensor, Tensor]:
    """A scene of lights far behind wires in focus: light [3, H, W], signed radii [H, W] in px."""
    import torch

    y, x = torch.arange(height)[:, None], torch.arange(width)
    down, across = y / width, x / width
    turns = [29 * across + 9 * down, 31 * down - 12 * across, 21 * (across + down)]
    generator = torch.Generator().manual_seed(0)
    grain = torch.rand((1, height, width), generator=generator)
    waves = torch.sin(2 * math.pi * torch.stack(turns))
    image = 0.2 * (0.5 + 0.3 * waves + 0.3 * (grain - 0.5))
    lights = torch.randint(height * width, (15,), generator=generator.manual_seed(1))
    image.flatten(1)[:, lights] = 200.0
    wires = ((x + 0.5) / width * 8 % 1 < 24 / width) | ((y + 0.5) / height * 4 % 1 < 12 / height)
    return image, torch.where(wires, 0.0, _LENS_RADIUS)


def _small(path: Path) -> NDArray[Any]:
    """A picture file over black, sRGB [h, w, 3], reduced to the width of a cell of the sheet."""
    color = read_color(path)
    pixels = color.pixels
    pixels = pixels[:, :, :-1] if color.channels[-1] == "A" else pixels
    pixels = np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels[:, :, :3]
    height, width, _ = pixels.shape
    scale = min(1.0, _WIDTH / width)
    size = max(1, round(height * scale)), max(1, round(width * scale))
    pixels = resized(pixels, size) if scale < 1 else pixels
    return linear_to_srgb(np.clip(pixels, 0.0, 1.0).astype(np.float32))


def _labelled(picture: NDArray[Any], words: str, width: int = 0) -> NDArray[Any]:
    """A picture in a cell of at least `width` px, with a line of words below."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    height = len(picture)
    canvas = np.zeros((height + _LINE, max(width, picture.shape[1]), 3), np.float32)
    canvas[:height, : picture.shape[1]] = picture
    buffer, grey = oiio.ImageBuf(canvas), (_GREY, _GREY, _GREY)
    place = (_MARGIN, height + _LINE - _MARGIN)
    oiio.ImageBufAlgo.render_text(buffer, *place, words, _LETTERS, "", grey)
    return np.asarray(buffer.get_pixels(oiio.FLOAT)).reshape(canvas.shape)

"""Contact sheet of a batch: some of its pictures, small, in one PNG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.batch.jobs.job import Job
from defocus_core.errors import UsageProblem
from defocus_core.io.images.color import read_color
from defocus_core.io.images.color_space import linear_to_srgb, quantised
from defocus_core.io.images.encode import write_samples

NAME = "contact.png"
_WIDTH = 320  # px of a picture
_LINE, _LETTERS = 22, 14  # px of a line of words, and of its letters
_GREY = 0.8  # of words, in sRGB


def kind_of_sheet(jobs: Sequence[Job]) -> str:
    """The kind of output that a sheet shows: the first that is an image."""
    for kind in jobs[0].outputs.rows:
        if kind.image:
            return kind.name
    problem = "shows images, but maps alone are written"
    raise UsageProblem(
        "idle-option", problem, "add one, like ‹outputs› render,coc", field="contact"
    )


def write_contact_sheet(jobs: Sequence[Job], count: int) -> Path | None:
    """Write ``count`` of the pictures of jobs, evenly spread over those that are there.

    Returns the file; None if no picture is there.
    """
    kind = kind_of_sheet(jobs)
    there = [job for job in jobs if job.paths[kind].exists()]
    if not there:
        return None
    count = min(count, len(there))
    places = sorted({round(k * (len(there) - 1) / max(count - 1, 1)) for k in range(count)})
    pictures = [_labelled(_small(there[k].paths[kind]), there[k].sample_id) for k in places]
    columns = math.ceil(math.sqrt(len(pictures)))
    height = max(len(picture) for picture in pictures)
    cells = [np.pad(p, ((0, height - len(p)), (0, 0), (0, 0))) for p in pictures]
    cells += [np.zeros_like(cells[0])] * (-len(cells) % columns)
    rows = [np.concatenate(cells[i : i + columns], 1) for i in range(0, len(cells), columns)]
    sheet = quantised(np.concatenate(rows), 8)
    file = jobs[0].outputs.root / NAME
    write_samples(file, sheet.shape[:2], iter([sheet]), "png", {})
    return file


def _small(path: Path) -> NDArray[Any]:
    """A picture over black, sRGB [h, w, 3], at most as wide as a cell of the sheet."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    color = read_color(path)
    pixels = color.pixels
    pixels = pixels[:, :, :-1] if color.channels[-1] == "A" else pixels
    pixels = np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels[:, :, :3]
    height, width, _ = pixels.shape
    scale = min(1.0, _WIDTH / width)
    size = max(1, round(height * scale)), max(1, round(width * scale))
    if scale < 1:
        smaller = oiio.ImageBufAlgo.resize(
            oiio.ImageBuf(np.ascontiguousarray(pixels, np.float32)),
            roi=oiio.ROI(0, size[1], 0, size[0], 0, 1, 0, 3),
            filtername="box",
        )
        pixels = np.asarray(smaller.get_pixels(oiio.FLOAT)).reshape(*size, 3)
    return linear_to_srgb(np.clip(pixels, 0.0, 1.0).astype(np.float32))


def _labelled(picture: NDArray[Any], words: str) -> NDArray[Any]:
    """A picture in a cell as wide as the sheet's, with a line of words below."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    height, width, _ = picture.shape
    canvas = np.zeros((height + _LINE, _WIDTH, 3), np.float32)
    canvas[:height, :width] = picture
    buffer = oiio.ImageBuf(canvas)
    place = (4, height + _LINE - 6)
    oiio.ImageBufAlgo.render_text(buffer, *place, words, _LETTERS, "", (_GREY, _GREY, _GREY))
    return np.asarray(buffer.get_pixels(oiio.FLOAT)).reshape(canvas.shape)

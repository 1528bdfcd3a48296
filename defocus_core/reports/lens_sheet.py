"""A contact sheet: the same lights at the same radii, with each of some lenses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from defocus_core.batch.jobs.lens_from_options import make_lens
from defocus_core.batch.lenses.shipped_lenses import ShippedLens
from defocus_core.batch.look.opening import aperture_of, cat_eye_of
from defocus_core.io.images.color_space import linear_to_srgb, quantised
from defocus_core.io.images.encode import write_samples
from defocus_core.system.process import set_to_render

_SIZE = (200, 300)  # height and width in px of a picture
_RADIUS = 22.0  # px, greatest CoC radius
_FOCUS = 1e5  # mm, beyond every focal length; the radii are those of the lights
_COLUMNS = 3
_LINE, _LETTERS = 26, 16  # px of a line of words, and of its letters
_GREY = 0.8  # of words, in sRGB


def write_sheet(path: Path, lenses: Sequence[ShippedLens]) -> None:
    """Write the contact sheet of lenses, in rows from the top, as PNG."""
    set_to_render()
    pictures = [_labelled(_picture(lens), lens.name) for lens in lenses]
    blank = np.zeros_like(pictures[0])
    pictures += [blank] * (-len(pictures) % _COLUMNS)
    rows = [
        np.concatenate(pictures[i : i + _COLUMNS], axis=1)
        for i in range(0, len(pictures), _COLUMNS)
    ]
    sheet = quantised(np.concatenate(rows), 8)
    write_samples(path, sheet.shape[:2], iter([sheet]), "png", {})


def _picture(shipped: ShippedLens) -> NDArray[Any]:
    """Lights nearer and farther than the focus with a lens, sRGB [H, W, 3]."""
    from defocus_core.evaluation.synthetic_scenes import scenery
    from defocus_core.renderer.render import render

    lens = make_lens({"focus": _FOCUS}, shipped.path)
    image, radius = scenery("lights", *_SIZE, _RADIUS)[:2]
    cat_eye = cat_eye_of(lens, _SIZE[::-1])
    shown = render(image, radius, aperture=aperture_of(lens), cat_eye=cat_eye).render
    return linear_to_srgb(shown.movedim(0, -1).contiguous().numpy().clip(0, 1))


def _labelled(picture: NDArray[Any], words: str) -> NDArray[Any]:
    """A picture with a line of words below."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    height, width, _ = picture.shape
    canvas = np.zeros((height + _LINE, width, 3), np.float32)
    canvas[:height] = picture
    buffer = oiio.ImageBuf(canvas)
    place = (8, height + _LINE - 8)
    oiio.ImageBufAlgo.render_text(buffer, *place, words, _LETTERS, "", (_GREY, _GREY, _GREY))
    return np.asarray(buffer.get_pixels(oiio.FLOAT))

"""The field: how the pupil changes over the frame, as regions and points see it."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from defocus_core.optics.cat_eye import CatEye, falloff
from defocus_core.optics.pupil_field import View
from defocus_core.renderer.blur.kernel_bank import TransformWindow
from defocus_core.renderer.engine.frame import SharedFrame, Slicing
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.views import Views


def frame_at(frame: SharedFrame, box: Box) -> SharedFrame:
    """The frame as a region of it sees it: its windows have the pupils of the region's corners."""
    if frame.settings.field is None:
        return frame
    views = corner_views(frame, box)
    clipped: dict[int, TransformWindow] = {}

    def slicing(of: Slicing) -> Slicing:
        for window in of.windows:
            if id(window) not in clipped:
                clipped[id(window)] = window.seen(views)
        return of._replace(windows=[clipped[id(window)] for window in of.windows])

    visible, known, invented = (
        slicing(of) for of in (frame.slices.visible, frame.slices.known, frame.slices.invented)
    )
    slices = frame.slices._replace(visible=visible, known=known, invented=invented)
    return replace(frame, slices=slices)


def corner_views(frame: SharedFrame, box: Box) -> list[View]:
    """The pupils that the corners of a region see, by rows; none if all see it alike."""
    field = frame.settings.field
    if field is None:
        return []
    return [
        field.view(float(x), float(y), frame.size)
        for y in (box.top, box.top + box.height)
        for x in (box.left, box.left + box.width)
    ]


def views_of(frame: SharedFrame, at: Tensor, core: Box, region: Box) -> View | None:
    """The pupil as pixels [n, 2], rows and columns, see it: [n] places."""
    field = frame.settings.field
    if field is None:
        return None
    y, x = (
        (at + sent([region.top - core.top, region.left - core.left], at) + 0.5)
        .to(frame.dtype)
        .unbind(1)
    )
    return field.view(x, y, frame.size)


def darkened(part: Views, cat_eye: CatEye, frame: tuple[int, int]) -> Views:
    """A part of a picture with the light that the rim takes away from its pixels.

    `frame`: (height, width) of the picture in px.
    """
    like = part.images[0]
    y, x = (torch.arange(s.first, s.end).to(like) + 0.5 for s in part.box.sides)
    fraction = falloff(cat_eye.apart(x[None, :], y[:, None], frame), cat_eye.size)
    return part._replace(images=[image * fraction for image in part.images])

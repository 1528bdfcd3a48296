"""Colours that are in focus at different distances: channels that are rendered apart."""

from __future__ import annotations

from typing import NamedTuple

from defocus_core.errors import UsageProblem
from defocus_core.picture.opening import pupil_images
from defocus_core.picture.radii import color_offsets
from defocus_core.picture.take import Rendered


class Colors(NamedTuple):
    """Channels of a picture that are rendered together."""

    channels: tuple[int, ...]
    offset: float = 0.0  # px that their signed radii are apart from those of the lens
    # Whether rows are rendered as columns, whose left and right are up and down
    turned: bool = False
    # Of their light, where the opening is coloured: red is 0, green 1, blue 2
    color: int | None = None


def renderings(rendered: Rendered) -> list[Colors]:
    """What is rendered one after another; what says most of the picture comes last."""
    rows = [kind for kind in rendered.job.outputs.rows if kind.rendered]
    colors = colors_of(rendered)
    turned = [color._replace(turned=True) for color in colors if any(k.turned for k in rows)]
    upright = [] if all(kind.turned for kind in rows) else colors
    return [*turned, *upright]


def colors_of(rendered: Rendered) -> list[Colors]:
    """The channels that are rendered together: all, or red, blue, then all others."""
    names = rendered.inputs.color.channels
    every = Colors(tuple(range(len(rendered.inputs.color.planes))))
    lens = rendered.lens
    coloured = lens.aperture_image is not None and len(pupil_images(lens.aperture_image)) > 1
    if not (coloured or lens.axial_color) or "R" not in names:
        return [every]
    if coloured and any(kind.halves or kind.turned for kind in rendered.job.outputs.rows):
        problem, remedy = "is coloured: its halves may have no light", "leave out left and right"
        raise UsageProblem("colored-pupil", problem, remedy, field="aperture-image")
    offsets = color_offsets(lens, rendered.size) if lens.axial_color else (0.0, 0.0)
    red, blue = names.index("R"), names.index("B")
    others = tuple(c for c in every.channels if c not in (red, blue))
    if offsets[0] == offsets[1] and not coloured:
        return [Colors((red, blue), offsets[0]), Colors(others)]
    return [
        Colors((red,), offsets[0], color=0),
        Colors((blue,), offsets[1], color=2),
        Colors(others, color=1),
    ]

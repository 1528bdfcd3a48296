"""Lamps: clipped lights of pictures, with the light that they lost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from defocus_core.batch.lenses.lens import Lens

if TYPE_CHECKING:
    from defocus_core.tensors.source import Pixels


def lit(
    pictures: Sequence[Pixels], radii: Sequence[Pixels], colors: int, lens: Lens
) -> tuple[list[Pixels], int | None]:
    """Pictures of one scene with the light of their lamps, if the lens asks for it.

    `pictures`: each [C, H, W], of linear light; `radii`: of each [H, W] px, signed: what is in
    focus stays as it is. Returns the pictures, as they are if one of them has light above 1; and
    the number of lamps, None if they are not asked for.
    """
    from defocus_core.tensors.clipped_lights import ClippedLights

    if lens.highlights is None:
        return [*pictures], None
    lamps = [
        ClippedLights(picture, *lens.highlights, colors=colors, signed_radius=radius)
        for picture, radius in zip(pictures, radii, strict=True)
    ]
    if any(lights.measured for lights in lamps):
        return [*pictures], 0
    return [lights.added for lights in lamps], sum(lights.count for lights in lamps)

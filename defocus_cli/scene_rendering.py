"""Renders a made scene as commands render a picture: to be timed."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from torch import Tensor

    from defocus_core.scenery import Scenery


class Rendered(NamedTuple):
    """A scene that was rendered.

    Attributes:
        pictures: [1 or 3, C, H, W], the centre, or also left and right.
        stats: counts of the work.
    """

    pictures: Tensor
    stats: dict[str, int]


def rendered_scene(scene: Scenery, *, quality: str, left_right: bool, threads: int) -> Rendered:
    """Render a scene.

    Args:
        scene: what to render, where it is.
        quality: of the renderer.
        left_right: whether to make left and right, too.
        threads: to compute with.
    """
    from defocus_core import Stream

    stream = Stream(
        scene.image,
        scene.signed_radius,
        quality=quality,
        left_right=left_right,
        threads=threads,
    )
    pictures = scene.image.new_empty(3 if left_right else 1, *scene.image.shape)
    for part in stream.regions():
        made = [x for x in (part.render, part.left, part.right) if x is not None]
        for picture, some in zip(pictures, made, strict=True):
            part.box.of(picture).copy_(some)
    return Rendered(pictures, stream.stats)

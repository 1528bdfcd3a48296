"""The order in which the surfaces over a tile are composited.

Visible surfaces come first, for they are known; and their share is right in the mean where surfaces
out of focus cover each other by chance. But a surface in focus occludes exactly: where it goes on
behind a nearer one, nothing beyond focus shows. So does a surface that is much less blurred than
the one beyond it.

A surface nearer than focus and one beyond it are no such pair. At the edge of a near surface the
lens points that it covers are those that see the visible part of the far one: what shows beside it
is the part that it hides. So all that lies beyond focus is put together as if the near surfaces
were not there, what they hide included, and shows in proportion where these leave a gap.
"""

from __future__ import annotations

from torch import Tensor

from defocus_core.renderer.blur.layer_blur import ShownLayer
from defocus_core.renderer.compositing.aperture_views import TileCompositor
from defocus_core.renderer.engine.hidden_fill import Filling, Hidden
from defocus_core.renderer.layers.octaves import CompositeOrder


def add_in_order(
    compositor: TileCompositor,
    visible: list[dict[int, ShownLayer]],
    hidden: list[Filling],
    order: CompositeOrder,
    index: int,
) -> list[Filling]:
    """Add the surfaces over a tile to its views."""
    blurred: dict[Filling, Hidden] = {}

    def over_tile(surface: Filling) -> Hidden:
        if surface not in blurred:
            blurred[surface] = surface.over_tile(index, compositor.sight)
        return blurred[surface]

    def fill(octave: int) -> None:
        for surface in hidden:
            if surface.has(octave, index) and not compositor.are_full(known=surface.known):
                layers = over_tile(surface).of(octave)
                if (pictures := with_octave(octave)) is not None:
                    layers = [None if layer is None else layer * pictures for layer in layers]
                compositor.fill(layers, known=surface.known)

    def with_octave(octave: int) -> Tensor | None:
        return order.pictures_with(octave, compositor.by_group[0]) if octave else None

    def show(indices: set[int]) -> None:
        compositor.add([{n: layers[n] for n in layers if n in indices} for layers in visible])

    indices = {k for layers in visible for k in layers}
    near = {k for k in indices if k < order.around}
    show(near)
    has_more = bool(hidden) or max(indices) >= order.beyond if near else False
    covered = compositor.coverage() if has_more else None
    show({k for k in indices - near if k < order.beyond})
    fill(0)
    aside = None
    if covered is not None:
        before = compositor.coverage()
        for octave in sorted(octave for octave in order.ahead if octave < 0):
            fill(octave)
        added = (c - b for c, b in zip(compositor.coverage(), before, strict=True))
        aside = compositor.set_aside([c + a for c, a in zip(covered, added, strict=True)])
    # before layers that the tile lacks, too: a pixel does not depend on the tile that it is in
    beyond = {k for k in indices if k >= order.beyond} | set(order.ahead.values())
    for k in sorted(beyond):
        for octave in (octave for octave, first in order.ahead.items() if first == k):
            if aside is None:
                fill(octave)
            elif octave > 0:
                fill(octave)
                compositor.close_gaps(aside, with_octave(octave))
        show({k})
    for surface in hidden:
        if not compositor.are_full(known=surface.known):
            compositor.fill(over_tile(surface).whole(), known=surface.known)
    if aside is not None:
        compositor.put_together(aside)
    return list(blurred)

"""The order in which the surfaces over a tile are composited.

What is visible counts first, for it is known; and its share is right in the mean where surfaces out
of focus cover each other by chance. But what is in focus occludes exactly: where it goes on behind
something nearer, nothing beyond focus is seen. So does what is much less blurred than what is seen
beyond it.
"""

from __future__ import annotations

from typing import NamedTuple

from defocus_core.blur.layer_blur import Shown
from defocus_core.compositing.aperture_views import Fronts
from defocus_core.engine.frame import Frame
from defocus_core.engine.hidden_fill import Filling, Hidden


class Layer(NamedTuple):
    """A hidden surface.

    Attributes:
        filling: What fills with it.
        known: Whether it is known, or invented.
    """

    filling: Filling
    known: bool


def add_in_order(
    fronts: Fronts,
    visible: list[dict[int, Shown]],
    hidden: list[Layer],
    frame: Frame,
    index: int,
) -> set[int]:
    """Add all that may be seen of a tile.

    Args:
        fronts: What is seen; changed.
        visible: Of each group the visible layers by number, nearest first.
        hidden: What may fill what these leave, known before invented.
        frame: It is part of.
        index: Of the tile.

    Returns:
        Which of the hidden surfaces were needed.
    """
    found: dict[int, Hidden] = {}

    def seen_of(i: int) -> Hidden:
        if i not in found:
            found[i] = hidden[i].filling.over_tile(index)
        return found[i]

    def fill(octave: int) -> None:
        for i, (some, known) in enumerate(hidden):
            if not some.has(octave, index) or fronts.are_full(known=known):
                continue
            fronts.fill(seen_of(i).of(octave), known=known)

    def show(numbers: set[int]) -> None:
        fronts.add([{n: some[n] for n in some if n in numbers} for some in visible])

    numbers = {number for some in visible for number in some}
    show({number for number in numbers if number < frame.turns.beyond})
    fill(0)
    ahead = frame.turns.ahead  # of layers that are not here, too: no pixel hangs on the tile
    beyond = {number for number in numbers if number >= frame.turns.beyond}
    for number in sorted(beyond | set(ahead.values())):
        for octave in (octave for octave, first in ahead.items() if first == number):
            fill(octave)
        show({number})
    for i, (_, known) in enumerate(hidden):
        if not fronts.are_full(known=known):
            fronts.fill(seen_of(i).whole(), known=known)
    return set(found)

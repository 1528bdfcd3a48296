"""The focus that the depth of a picture decides, unless other frames have decided it."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.picture.focus import with_blur_reach, with_focus
from defocus_core.picture.take import Take


def lens(take: Take) -> Take:
    """The take with the focus of its lens."""
    inputs, found = take.inputs, take.lens
    if found is take.job.lens:
        found = with_focus(found, inputs.depth)
    below = () if inputs.plate is None else (inputs.plate.depth,)
    of_layers = () if inputs.layers is None else inputs.layers.depths
    return replace(take, lens=with_blur_reach(found, (inputs.depth, *below, *of_layers)))

"""Known surfaces: visible and hidden samples composited layer by layer, front to back.

Three laws hold in three places. Slices of a layer, and visible samples of neighbouring layers, add
up, for parts of one continuous surface are complementary: a saturating sum. Samples of one pixel
occlude each other by their coverage, uncorrelated (`over`); what shows of them is their visible
share. Surfaces out of focus cover each other by chance: behind a front of coverage A a layer of
coverage a, visible or hidden, is seen by a (1 - A). Where this is more than its visible share, the
lens looks behind what hides the layer from the pinhole, and the hidden share adds the difference.
In focus, where A and a are those of the pixel, the difference is 0. Nothing is seen past opaque
samples where none of their edges is in reach (openings.py).
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.renderer.blur.layer_blur import ShownLayer
from defocus_core.renderer.compositing.openings import Openings
from defocus_core.renderer.compositing.saturating_sum import add_within, is_full, shown_behind
from defocus_core.tensors.box import Box

# Coverage below which a hidden share is rounding.
_MINIMUM = 1e-6


def add_known(
    front: Tensor,  # [M, C + 1, h, w], zeros; overwritten unless gradients are enabled
    visible: dict[int, ShownLayer],
    hidden: dict[int, ShownLayer],
    full: Tensor | float,
    openings: Openings,
    *,
    closed: bool,
) -> tuple[Tensor, Tensor | None]:
    """Composite the layers of one group of aperture parts over a tile."""
    moved, hidden_fractions = None, []
    for number in sorted({*visible, *hidden}):
        shown, behind = visible.get(number), hidden.get(number)
        before = None if behind is None else behind.box.of(front)[:, -1:].clone()
        if shown is not None:
            within = _of(full, shown.box)
            layer, fraction = shown_behind(shown.box.of(front), shown.layer, within)
            fraction = fraction * openings.over(shown.box).to(number)
            front = add_within(front, shown.box, layer, fraction)
            if shown.moved is not None:
                moved = torch.zeros_like(front[:, :-1]) if moved is None else moved
                moved = add_within(moved, shown.box, shown.moved, fraction)
        if behind is not None and before is not None:
            room = openings.over(behind.box).to(number)
            fraction = _fraction_hidden(before, front, shown, behind, full, room)
            front = add_within(front, behind.box, behind.layer, fraction)
            hidden_fractions.append((behind, fraction, room))
    for behind, fraction, room in hidden_fractions if closed else ():
        within, window = _of(full, behind.box), behind.box.of(front)
        if not is_full(window, within):
            rest = behind.layer * (1 - fraction)
            rest, left = shown_behind(window, rest, within)
            front = add_within(front, behind.box, rest, left * room)
    return front, moved


def _of(full: Tensor | float, box: Box) -> Tensor | float:
    """The greatest coverage in a box."""
    return box.of(full) if isinstance(full, Tensor) else full


def _fraction_hidden(
    before: Tensor,  # [M, 1, h, w], coverage of the front in this box before the layer
    front: Tensor,  # [M, C + 1, H, W], the front with what is visible of the layer
    shown: ShownLayer | None,
    behind: ShownLayer,
    full: Tensor | float,
    room: Tensor,  # [h, w], the share of a gap in this box that is no error
) -> Tensor:
    """The share [M, 1, h, w] of a hidden layer that is seen, in its box."""
    box, maximum = behind.box, _of(full, behind.box)
    coverage = behind.layer[:, -1:].clamp(min=0)
    whole = coverage
    if shown is not None:
        both = shown.box.grown(0, box)
        if both.height > 0 and both.width > 0:
            visible = both.seen_from(shown.box).of(shown.layer)[:, -1:].clamp(min=0)
            whole = add_within(coverage.clone(), both.seen_from(box), visible)
    gap = (maximum - before).clamp(min=0) * room
    expected = gap * (whole / maximum).clamp(max=1)
    added = (expected - (box.of(front)[:, -1:] - before)).clamp(min=0)
    added = torch.where(coverage > _MINIMUM, added, 0.0)
    return (added / coverage.clamp(min=_MINIMUM)).clamp(max=1)

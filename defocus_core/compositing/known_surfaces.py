"""Known surfaces: visible and hidden samples composited layer by layer, front to back.

Three laws hold in three places. Slices of a layer, and visible samples of neighbouring layers, add
up, for parts of one continuous surface are complementary: a saturating sum. Samples of one pixel
occlude each other by their coverage, uncorrelated (`over`); what shows of them is their visible
share. Surfaces out of focus cover each other by chance: behind a front of coverage A a layer of
coverage a, visible or hidden, is seen by a (1 - A). Where this is more than its visible share, the
lens looks behind what hides the layer from the pinhole, and the hidden share adds the difference.
In focus, where A and a are those of the pixel, the difference is 0.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.blur.layer_blur import Shown
from defocus_core.compositing.saturating_sum import add_within, share_behind

# Coverage below which a hidden share is rounding.
_LEAST = 1e-6


def add_known(
    front: Tensor,
    visible: dict[int, Shown],
    hidden: dict[int, Shown],
    full: Tensor | float,
    *,
    closed: bool,
) -> tuple[Tensor, Tensor | None]:
    """Composite the layers of one group of aperture parts over a tile.

    Args:
        front: [M, C + 1, h, w], zeros; overwritten unless gradients are enabled.
        visible: Visible layers by number, nearest first.
        hidden: Hidden layers by number.
        full: Greatest coverage.
        closed: Whether every pixel is covered fully, so that hidden samples fill all gaps.

    Returns:
        The front, and the change of its colours by sub-pixel shifts if there are any.
    """
    moved, left_over = None, []
    for number in sorted({*visible, *hidden}):
        shown, behind = visible.get(number), hidden.get(number)
        before, most = front[:, -1:].clone(), full
        if shown is not None:
            within = shown.box.of(most) if isinstance(most, Tensor) else most
            share = share_behind(shown.box.of(front), shown.layer, within)
            front = add_within(front, shown.box, shown.layer, share)
            if shown.moved is not None:
                moved = torch.zeros_like(front[:, :-1]) if moved is None else moved
                moved = add_within(moved, shown.box, shown.moved, share)
        if behind is not None:
            share = _share_hidden(before, front, shown, behind, full)
            front = add_within(front, behind.box, behind.layer, share)
            if closed:
                left_over.append((behind.box, behind.layer * (1 - share)))
    for box, layer in left_over:
        within = box.of(full) if isinstance(full, Tensor) else full
        front = add_within(front, box, layer, share_behind(box.of(front), layer, within))
    return front, moved


def _share_hidden(
    before: Tensor, front: Tensor, shown: Shown | None, behind: Shown, full: Tensor | float
) -> Tensor:
    """The share [M, 1, h, w] of a hidden layer that is seen, in its box.

    Args:
        before: [M, 1, H, W], coverage of the front before the layer.
        front: [M, C + 1, H, W], the front with what is visible of the layer.
        shown: What is visible of the layer.
        behind: What is hidden of the layer.
        full: Greatest coverage.
    """
    box = behind.box
    coverage = behind.layer[:, -1:].clamp(min=0)
    covered = box.of(front)[:, -1:]
    whole = coverage
    if shown is not None:
        blank = torch.zeros_like(before)
        whole = whole + box.of(add_within(blank, shown.box, shown.layer[:, -1:].clamp(min=0)))
    most = box.of(full) if isinstance(full, Tensor) else full
    gap = (most - box.of(before)).clamp(min=0)
    expected = torch.minimum(whole * gap / most, gap)
    added = (expected - (covered - box.of(before))).clamp(min=0)
    certain = coverage > _LEAST
    share = added / torch.where(certain, coverage, 1.0)
    return torch.where(certain, share, 0.0).clamp(max=1)

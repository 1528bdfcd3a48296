"""Blends over a region of layers that were blurred as its four corners see the pupil.

Where the pupil changes over the frame, a pixel's blur is the mean of those at the corners of its
region, bilinear in its place. Neighbouring regions share corners, so that no seam is left.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.tensors.box import Box

CORNERS = 4


def blended(layer: Tensor, box: Box, region: Box) -> Tensor:
    """One layer [m, C + 1, h, w] of layers [4 m, C + 1, h, w]."""
    down, across = (
        ((torch.arange(side.first, side.end).to(layer) + 0.5 - whole.first) / whole.length).clamp(
            0, 1
        )
        for side, whole in zip(box.sides, region.sides, strict=True)
    )
    rows = layer.reshape(-1, CORNERS, *layer.shape[1:])
    upper = torch.lerp(rows[:, 0], rows[:, 1], across)
    lower = torch.lerp(rows[:, 2], rows[:, 3], across)
    return torch.lerp(upper, lower, down[:, None])


def corner_groups(groups: list[slice]) -> list[slice]:
    """Groups of parts, each part four times."""
    return [slice(CORNERS * group.start, CORNERS * group.stop) for group in groups]

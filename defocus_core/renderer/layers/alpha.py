"""Alpha of the render: its source, and functions that add and remove it.

The last channel of pictures and views of layers is alpha. `compositing.left_right` keeps it at most
1 in left and right.
"""

from __future__ import annotations

from enum import Enum

import torch
from torch import Tensor

from defocus_core.tensors.views import ViewTensors


class Alpha(Enum):
    """The source of the alpha of views."""

    NONE = "a picture without alpha"
    # With one sample per pixel, as the surface continued behind its edges may be absent
    BLURRED = "a channel that is blurred with the colours"
    COVERED = "the coverage of what was composited"


def color_of(pixels: Tensor) -> Tensor:
    """The colours [C, H, W] of a picture [C + 1, H, W] with alpha."""
    return pixels[:-1]


def with_coverage(front: Tensor) -> Tensor:
    """A front [M, C + 1, h, w] with its coverage as a further colour channel: [M, C + 2, h, w]."""
    return torch.cat([front, front[:, -1:]], 1)


def without_alpha(views: ViewTensors) -> ViewTensors:
    """Views without their last channel, alpha."""
    return views._replace(images=[image[:-1] for image in views.images])


def with_opaque_alpha(views: ViewTensors) -> ViewTensors:
    """Views with an alpha of 1 as a further channel."""
    alpha = torch.ones_like(views.render[:1])
    return views._replace(images=[torch.cat([image, alpha]) for image in views.images])

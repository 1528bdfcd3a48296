"""The share of the aperture that sees the frame rather than past its border.

Beyond the frame surfaces go on as they are on its edge, but were not seen: trust is the share that
sees the frame. Of a blur much wider than the frame they go on for a part of its reach. What sees
farther sees nothing, and must not be filled by surfaces behind.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from defocus_core.optics.aperture import Aperture
from defocus_core.optics.batched import Apertures
from defocus_core.optics.parts import Part
from defocus_core.optics.pupil_field import View
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent
from defocus_core.tensors.sparse_masks import exceeding, flat_nonzero

# Least share: a disc much larger than the frame would divide by nearly 0.
_MIN_FRACTION = 0.01
# Coverage that a pixel's own surface has besides what a pupil sees with its light aside, or with an
# opaque middle that may hide the frame: there errors of a small coverage are larger.
ASIDE, OPAQUE = 1e-6, 1e-3
# Intervals of the pupil's width in which areas are interpolated; errors stay below 5e-4.
_STEPS = 128


def fraction_in_frame(
    signed_radius: Tensor,  # [..., h, w] px
    box: Box,
    size: tuple[int, int],  # (height, width) of the rectangle
    aperture: Aperture,
    parts: list[Part],
    views: Sequence[View] = (),
) -> Tensor:
    """The share of parts of the aperture that sees a pixel's own surface within a rectangle.

    Lens point u images the surface at pixel q to q + r u: pixel x sees the surface at x - r u.

    Returns [M, 1, ..., h, w] in [0.01, 1].
    """
    positions = (sent(torch.arange(s.first, s.end), signed_radius) + 0.5 for s in box.sides)
    # [h, 2] and [w, 2] px from both borders of an axis to a pixel
    down, across = (torch.stack([at, at - n], -1) for at, n in zip(positions, size, strict=True))
    nearest = torch.minimum(down.abs().amin(-1)[:, None], across.abs().amin(-1))
    index = flat_nonzero(exceeding(signed_radius.abs() - nearest, 0.0))
    rows = index.div(box.width, rounding_mode="floor")
    columns = index - rows * box.width
    if signed_radius.dim() > 2:  # of a batch
        rows = rows.remainder(box.height)
    r = signed_radius.flatten().index_select(0, index)[:, None]
    y, x = (
        (away / r).clamp(-1, 1)
        for away in (down.index_select(0, rows), across.index_select(0, columns))
    )
    # the frame is between two of the points u that see its corners, in x and in y
    corners = torch.stack([x[:, None].expand(-1, 2, -1), y[..., None].expand(-1, -1, 2)], -1)
    tables = [_areas_below(aperture, part, view) for part in parts for view in views or (None,)]
    areas, corners = sent(torch.stack(tables)[None], r), corners.reshape(1, -1, 4, 2)
    if areas.dim() > 4:  # of each picture, one behind another
        picture = index.div(box.area, rounding_mode="floor").to(r) * (2 / (areas.shape[2] - 1)) - 1
        behind = picture.view(1, -1, 1, 1).expand(-1, -1, 4, -1)
        corners = torch.cat([corners, behind], -1)[:, None]
    below = grid_sample(areas, corners, align_corners=True).view(len(tables), len(index), 4)
    within = (below[..., 0] + below[..., 3] - below[..., 1] - below[..., 2]).abs()
    fraction = signed_radius.new_ones(len(tables), *signed_radius.shape)
    fraction = fraction.flatten(1).index_copy(1, index, within.clamp(min=_MIN_FRACTION))
    return fraction.view(len(tables), 1, *signed_radius.shape)


def _areas_below(aperture: Aperture, part: Part, view: View | None) -> Tensor:
    """`_summed_area`, or [B, y, x] of the pupils of a batch."""
    if isinstance(aperture, Apertures):
        return torch.stack([_areas_below(one, part, own) for one, own in aperture.seeing(view)])
    if aperture.requires_grad:
        return _summed_area.__wrapped__(aperture, part, view)
    return (_summed_area.__wrapped__ if view else _summed_area)(aperture.fixed, part, view)


@lru_cache(maxsize=256)
def _summed_area(aperture: Aperture, part: Part, view: View | None) -> Tensor:
    """The share [y, x] of a part of the pupil that lies below u.y and left of u.x, over [-1, 1]."""
    with torch.inference_mode(False):  # the cache serves calls that need gradients, too
        limits = torch.linspace(-1, 1, _STEPS + 1, dtype=torch.float64)
        if part.is_uneven or view:
            r = torch.tensor(_STEPS / 2, dtype=torch.float64)
            below = aperture.kernel(r, _STEPS, part, view).cumsum(0).cumsum(1)
            return torch.nn.functional.pad(below, (1, 0, 1, 0))
        up_to = torch.stack([torch.full_like(limits, -1), limits], -1)
        return aperture.fraction_between(part, up_to[None], up_to[:, None])


def border_fallback(color: Tensor, trace: float) -> Tensor:
    """A trace of each pixel's own surface [C, h, w], colour and coverage [C + 1, h, w].

    A pupil that is given as a picture may have its light aside: at a border of the frame it sees
    nothing within, and a pixel there is what it was. So it is where an opaque middle hides all.
    """
    return torch.cat([color, torch.ones_like(color[:1])]) * trace

"""How much of the aperture looks at the frame, and not past its borders.

Beyond the frame a surface goes on, unseen. The share of the aperture that sees it there is not free
for what lies behind.
"""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor

from defocus_core.aperture import Aperture, Part, area_within
from defocus_core.tiling import Box

# Radii in px up to which a pixel looks at the frame, wherever it is, and from which it does as
# geometry says. What is between is smooth: depth and lens are differentiated through it.
_FROM, _TO = 1.5, 2.5
# Shares below this count as this: of a disc so much larger than the frame next to nothing is seen.
_LEAST_SHARE = 0.01
# Intervals of u in which shares are linear.
_STEPS = 1024


def px_from_borders(box: Box, size: tuple[int, int], device: torch.device) -> Tensor:
    """Px [h, w] between each pixel of a box and the nearest border of a frame: 0 beside it."""
    down, across = (
        torch.minimum(at, length - 1 - at)
        for at, length in zip(
            (torch.arange(s.first, s.end, device=device) for s in box.sides), size, strict=True
        )
    )
    return torch.minimum(down[:, None], across)


def share_in_frame(
    signed_radius: Tensor, box: Box, size: tuple[int, int], aperture: Aperture, parts: list[Part]
) -> Tensor:
    """The share of parts of the aperture that sees pixels' own surfaces within the frame.

    Lens point u sees pixel q at q + r u.

    Args:
        signed_radius: [h, w] px of some pixels.
        box: Where in the frame they are.
        size: (height, width) of the frame.
        aperture: The pupil; a gaussian one counts as evenly lit.
        parts: M parts of it.

    Returns:
        [M, 1, h, w] in [0.01, 1].
    """
    (H, W), r = size, signed_radius
    near = px_from_borders(box, size, r.device) + 0.5
    share = r.new_ones(len(parts), r.numel())
    some = torch.nonzero((r.detach().abs() > near.clamp(min=_FROM)).flatten())[:, 0]
    if len(some):
        r, row = r.flatten()[some], some.div(box.width, rounding_mode="floor")
        places = (some - row * box.width + box.left, row + box.top)
        across, down = (
            torch.stack([(at + 0.5) / r, (at + 0.5 - length) / r], -1).sort(-1).values.clamp(-1, 1)
            for at, length in zip(places, (W, H), strict=True)
        )
        beside, above = ((ends.detach().abs() < 1).any(-1) for ends in (across, down))
        both = torch.nonzero(beside & above)[:, 0]
        found = []
        for part in parts:
            one = torch.where(
                beside, _between(aperture, part, 0, across), _between(aperture, part, 1, down)
            )
            corner = area_within(aperture, part, across[both], down[both])
            found.append(one.index_copy(0, both, corner.to(one.dtype)))
        t = ((r.abs() - _FROM) / (_TO - _FROM)).clamp(0, 1)
        counts = t * t * (3 - 2 * t)
        share = share.index_copy(1, some, 1 - counts * (1 - torch.stack(found)))
    return share.clamp(min=_LEAST_SHARE).reshape(len(parts), 1, box.height, box.width)


def _between(aperture: Aperture, part: Part, dim: int, ends: Tensor) -> Tensor:
    """The share [n] of a part whose u.x (dim 0) or u.y lies between two ends [n, 2]."""
    below = _below(aperture, part, dim).to(ends)
    place = (ends + 1) * (_STEPS / 2)
    lower = place.detach().floor().clamp(max=_STEPS - 1)
    first = lower.long()
    found = below[first] + (place - lower) * (below[first + 1] - below[first])
    return found[:, 1] - found[:, 0]


@lru_cache(maxsize=256)
def _below(aperture: Aperture, part: Part, dim: int) -> Tensor:
    """The share of a part below each of some u: [_STEPS + 1]."""
    with torch.inference_mode(False):  # it is kept for those who want gradients, too
        ends = torch.linspace(-1, 1, _STEPS + 1, dtype=torch.float64)
        some = torch.stack([torch.full_like(ends, -1), ends], -1)
        whole = torch.tensor([-1.0, 1.0], dtype=torch.float64).expand_as(some)
        return area_within(aperture, part, *((some, whole) if dim == 0 else (whole, some)))

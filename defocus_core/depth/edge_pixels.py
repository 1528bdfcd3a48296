"""Edge pixels of estimated depth given to the surface that their colour shows.

Where depth was soft or averaged, an edge that became a step lies up to a pixel beside its place.
Each pixel on the edge has the colours of both surfaces beside it: of the share that the nearer one
has in the pixel, more than a half makes the pixel near. Before the colour is known, the share that
the nearer surface has in the pixels around is expected, so that edges are smooth where colours say
nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from defocus_core.depth.edge_surfaces import AROUND as AROUND_SURFACES
from defocus_core.depth.edge_surfaces import (
    AT_ONCE,
    BYTES_EACH,
    EDGE,
    MIDDLE,
    Around,
    Side,
    around_edge,
    closeness,
    fraction_deviation,
    side_of,
)
from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.neighbourhoods import extreme_around, halfway, squares_around
from defocus_core.tensors.source import Pixels, bands
from defocus_core.tensors.sparse_masks import exceeding, positions_of
from defocus_core.tensors.threads import threaded

# Standard deviation of the weights of the pixels around, in px, and of the share expected by them.
_NEARBY, _UNCERTAIN = 1.2, 0.12
# Least distance of a share from a half that is a vote; and the share of votes for the other side of
# the edge from which on pixels are beside their surface.
_CLEAR, _MANY = 0.2, 0.08
# Px around a pixel that decide what it becomes.
AROUND = AROUND_SURFACES + 1


def are_beside_their_surface(signed_radius: Pixels, pixels: Pixels, threads: int) -> bool:
    """Whether colours put many pixels on edges of radii [H, W] px on the other side of their edge.

    Not where averages were those of a pixel, for these say exactly where an edge is; but where
    depth was enlarged.

    `signed_radius`: [H, W] px, without averages; `pixels`: [C, H, W] linear.
    """
    H = signed_radius.shape[0]

    def votes_of(rows: tuple[int, int]) -> Tensor:
        above, below = max(rows[0] - AROUND, 0), min(rows[1] + AROUND, H)
        radii, colors = signed_radius[above:below].detach(), pixels[..., above:below, :].detach()
        votes = torch.zeros(2, dtype=torch.long, device=radii.device)
        for at, around in _squares_on_edges(radii, colors):
            around, near, far = _with_both_surfaces(around)
            half = torch.full_like(near.signed_radius, 0.5)
            by = fraction_deviation(around.color, near, far, half, _UNCERTAIN)
            is_inside = (at[:, 0] >= rows[0] - above) & (at[:, 0] < rows[1] - above)
            votes_here = is_inside & near.known & far.known & (by.abs() > _CLEAR)
            beside = votes_here & ((by > 0) != around.is_near[MIDDLE])
            votes += torch.stack([votes_here.sum(), beside.sum()])
        return votes

    counts = torch.stack(list(threaded(votes_of, bands(signed_radius), threads))).sum(0)
    return int(counts[1]) > _MANY * int(counts[0])


def with_pixels_by_color(signed_radius: Tensor, pixels: Tensor) -> Tensor:
    """Radii [H, W] px whose pixels on edges belong to the surface that colours [C, H, W] show."""
    (H, W), positions, sources = signed_radius.shape, [], []
    for at, around in _squares_on_edges(signed_radius.detach(), pixels.detach()):
        square = squares_around(at, (H, W), AROUND_SURFACES).flatten(1)
        sources.append(square.gather(1, _source(around)[:, None])[:, 0])
        positions.append(at[:, 0] * W + at[:, 1])
    if not positions:
        return signed_radius
    values = signed_radius.flatten()
    return values.index_copy(0, torch.cat(positions), values[torch.cat(sources)]).reshape(H, W)


def _squares_on_edges(radii: Tensor, colors: Tensor) -> Iterator[tuple[Tensor, Around]]:
    """The pixels [n, 2] on edges of radii [H, W] px, and the squares around them, n by n."""
    nearest, farthest = (extreme_around(radii, 1, end) for end in (torch.minimum, torch.maximum))
    edge, border = exceeding(farthest - nearest, EDGE), halfway(nearest, farthest)
    positions = positions_of(edge)
    count = pieces(radii.device, AT_ONCE, BYTES_EACH)
    for at in torch.split(positions, count) if len(positions) else ():
        yield at, around_edge(colors, radii, edge, border, at)


def _with_both_surfaces(around: Around) -> tuple[Around, Side, Side]:
    """The squares, in double precision, and the near and the far surface in them."""
    # whatever the precision of a picture, its edges are the same
    colors = around.colors.double().nan_to_num().clamp(min=0)
    around = Around(colors, around.radii.double(), around.is_near, around.nearness.double())
    near, far = (
        side_of(around, around.nearness * side) for side in (around.is_near, ~around.is_near)
    )
    return around, near, far


def _source(around: Around) -> Tensor:
    """The pixel [n] of each square whose radius its middle gets; the middle itself if it stays."""
    around, near, far = _with_both_surfaces(around)
    is_near, off_edge = around.is_near, around.nearness
    nearby = closeness(around.colors) ** (2 / _NEARBY**2)
    expected = (nearby * is_near).sum(0) / nearby.sum()
    fraction = expected + fraction_deviation(around.color, near, far, expected, _UNCERTAIN)
    wants_near = fraction > 0.5
    moves = near.known & far.known & (wants_near != is_near[MIDDLE])
    candidates = torch.where(is_near == wants_near, off_edge, 0.0)
    closest = (candidates == candidates.amax(0)) & (candidates > 0)
    # of pixels as close the nearest of the near surface, or the farthest of the far one
    order = torch.where(wants_near, around.radii, -around.radii)
    source = torch.where(closest, order, torch.inf).argmin(0)
    return torch.where(moves, source, MIDDLE)

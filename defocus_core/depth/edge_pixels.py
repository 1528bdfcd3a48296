"""Edge pixels of estimated depth given to the surface that their colour shows.

Where depth was soft or averaged, an edge that became a step lies up to a pixel beside its place.
Each pixel on the edge has the colours of both surfaces beside it: of the share that the nearer one
has in the pixel, more than a half makes the pixel near. Before the colour is known, the share that
the nearer surface has in the pixels around is expected, so that edges are smooth where colours say
nothing.
"""

from __future__ import annotations

import torch
from torch import Tensor

from defocus_core.images.neighbourhoods import extreme_around, halfway, squares_around
from defocus_core.images.sparse_masks import exceeding, places_of
from defocus_core.layers.edge_surfaces import AROUND as AROUND_SURFACES
from defocus_core.layers.edge_surfaces import (
    AT_ONCE,
    EDGE,
    MIDDLE,
    Around,
    around_edge,
    closeness,
    share_deviation,
    side_of,
)

# Standard deviation of the weights of the pixels around, in px, and of the share expected by them.
_NEARBY, _UNCERTAIN = 0.8, 0.2
# Px around a pixel that decide what it becomes.
AROUND = AROUND_SURFACES + 1


def with_pixels_by_color(signed_radius: Tensor, pixels: Tensor) -> Tensor:
    """Radii [H, W] px whose pixels on edges belong to the surface that colours [C, H, W] show."""
    radii, colors, size = signed_radius.detach(), pixels.detach(), signed_radius.shape
    nearest, farthest = (extreme_around(radii, 1, end) for end in (torch.minimum, torch.maximum))
    edge = exceeding(farthest - nearest, EDGE)
    places = places_of(edge)
    if not len(places):
        return signed_radius
    border, sources = halfway(nearest, farthest), []
    for at in torch.split(places, AT_ONCE):
        around = around_edge(colors, radii, edge, border, at)
        square = squares_around(at, (size[0], size[1]), AROUND_SURFACES).flatten(1)
        sources.append(square.gather(1, _source(around)[:, None])[:, 0])
    values, index = signed_radius.flatten(), places[:, 0] * size[1] + places[:, 1]
    return values.index_copy(0, index, values[torch.cat(sources)]).reshape(size)


def _source(around: Around) -> Tensor:
    """The pixel [n] of each square whose radius its middle gets; the middle itself if it stays."""
    # whatever the precision of a picture, its edges are the same
    colors = around.colors.double().nan_to_num().clamp(min=0)
    is_near, off_edge = around.is_near, around.nearness.double()
    around = Around(colors, around.radii.double(), is_near, off_edge)
    near, far = (side_of(around, off_edge * side) for side in (is_near, ~is_near))
    nearby = closeness(colors) ** (2 / _NEARBY**2)
    expected = (nearby * is_near).sum(0) / nearby.sum()
    share = expected + share_deviation(around.color, near, far, expected, _UNCERTAIN)
    wants_near = share > 0.5
    moves = near.known & far.known & (wants_near != is_near[MIDDLE])
    candidates = torch.where((is_near == wants_near) & (off_edge > 0), off_edge, 0.0)
    closest = candidates == candidates.amax(0)
    # of pixels as close the nearest of the near surface, or the farthest of the far one
    order = torch.where(wants_near, around.radii, -around.radii)
    source = torch.where(closest, order, torch.inf).argmin(0)
    return torch.where(moves, source, MIDDLE)

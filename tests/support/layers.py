"""An oracle for layers with coverage: each sample through each lens point, composited by depth."""

import math

import torch


def lens_points(count):
    """Points spread evenly over the unit disc, in a spiral of golden angles."""
    angle = math.pi * (3 - math.sqrt(5))
    radii = [math.sqrt((k + 0.5) / count) for k in range(count)]
    return [(r * math.cos(k * angle), r * math.sin(k * angle)) for k, r in enumerate(radii)]


def brute_force(colors, radius, coverage, count=1024):
    """The picture [C + 1, H, W] of layers [L, C, H, W], with alpha; float64.

    Each sample goes to the pixel nearest to where a lens point sees it; there samples are
    composited by `over`, from near to far. Pixels within a blur of the border are too dark.
    """
    H, W = radius.shape[-2:]
    alpha = coverage.double().flatten()
    order = torch.nonzero(alpha > 0)[:, 0]
    r = radius.double().flatten()
    order = order[r[order].argsort(stable=True)]
    both = torch.cat([colors.double(), coverage.double()[:, None]], 1)
    samples = both.movedim(1, -1).flatten(0, 2)[order]
    r, alpha, pixel = r[order], alpha[order], order % (H * W)
    y, x = pixel // W, pixel % W
    total = torch.zeros(H * W, samples.shape[1], dtype=torch.float64)
    for u, v in lens_points(count):
        row, column = (y + r * v + 0.5).floor().long(), (x + r * u + 0.5).floor().long()
        inside = (row >= 0) & (row < H) & (column >= 0) & (column < W)
        spot = (row * W + column)[inside]
        grouped = spot.argsort(stable=True)
        spot = spot[grouped]
        total.index_add_(0, spot, _over(samples[inside][grouped], alpha[inside][grouped], spot))
    return (total / count).T.reshape(-1, H, W)


def _over(samples, alpha, spot):
    """Samples [n, C] times what those before them in the same spot [n] leave."""
    number = torch.arange(len(spot))
    begins = torch.ones_like(spot, dtype=torch.bool)
    begins[1:] = spot[1:] != spot[:-1]
    begin = torch.cummax(torch.where(begins, number, 0), 0).values
    left = torch.log1p(-alpha.clamp(max=1 - 1e-12))
    before = torch.cat([left.new_zeros(1), left.cumsum(0)[:-1]])
    return samples * torch.exp(before - before[begin])[:, None]

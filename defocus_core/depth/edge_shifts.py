"""Edges of depth moved to the edges of the colours: estimated depth is some px too fat or too thin.

Beside a sharp subject a strip of the background would stay sharp, or the subject's own rim would be
blurred. The costs of all displacements, from profiles of colour, are averaged along a silhouette
before the least is chosen, so that it stays smooth (as in stereo, Hosni et al. 2013), and chosen
softly, so that it holds still (Kendall et al. 2017). A displacement that is rare in the picture
needs more evidence.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.depth.color_profiles import (
    FARTHEST,
    NORMAL,
    REACH,
    Silhouette,
    displacement_costs,
    edges_of,
    silhouette_at,
)
from defocus_core.depth.distance_scale import DistanceScale
from defocus_core.depth.soft_edges import slope_of_soft_edges
from defocus_core.tensors.device_plan import pieces
from defocus_core.tensors.neighbourhoods import ends_of, extreme_around, halfway, squares_around
from defocus_core.tensors.source import Pixels, banded, bands
from defocus_core.tensors.sparse_masks import numbers_of, places_of
from defocus_core.tensors.threads import threaded

# Share of profiles that count from which evidence counts in full.
_ENOUGH = 0.1
# Rounds in which costs, and then displacements, are averaged over 5×5 px of a silhouette.
_ROUNDS, _SMOOTHING = 20, 8
# Cost in px beyond the least at which a displacement counts 1 / e: between two that are as likely
# lies their mean, so that an edge does not jump from one to the other.
_SPREAD = 0.15
# Grains of displacement in a px: finer differences are rounding.
_GRAINS = 1 << 8
# Weight of rarity, and its grain, so coarse that few pixels more or less change nothing; share of a
# displacement's votes that count for those a px beside it.
_RARITY, _COARSE, _BESIDE = 1.6, 0.2, 0.25
# Pixels of silhouettes that are examined for the displacements of the picture; factors of a hash.
_EXAMINED, _FACTORS = 1 << 12, (0x9E3779B97F4A7C1, 0x2545F4914F6CDD1D)
# Least step of an edge: in px, and as a multiple of the slope of a ramp.
_LEAST_STEP, _STEP = 0.3, 1.5
# A picture of hard edges is shifted if so many profiles count, if the median displacement is so
# many px, and if such a share of the votes lie within a px of it.
_VOTES, _BIASED, _AGREED = 400, 0.75, 0.6
# Px around a pixel that decide what it becomes.
AROUND = REACH + NORMAL + 2 * (_ROUNDS + _SMOOTHING) + FARTHEST + 2
# Half a px, so that averages of whole displacements are no ties.
_HALF = 0.4937
# Profiles examined at once on a CPU, and bytes that each takes elsewhere: bounds memory.
_PROFILES, _BYTES_EACH = 1 << 12, 1 << 14


class EdgeShifts(NamedTuple):
    """The displacements of a picture's edges from those of its colours.

    Attributes:
        step: Least step in px of an edge.
        median: Median displacement in px; positive where depth is too fat, its edges outside.
        rarity: [2 * FARTHEST + 1] cost of each displacement from -FARTHEST on.
    """

    step: float
    median: float
    rarity: tuple[float, ...]


def measured_shifts(
    signed_radius: Pixels,
    pixels: Pixels,
    threads: int,
    *,
    soft: bool,
    scale: DistanceScale | None = None,
) -> EdgeShifts | None:
    """The displacements of the edges of a picture; None if its edges lie where they should.

    Args:
        signed_radius: [H, W] px, without ramps.
        pixels: [C, H, W] linear.
        threads: Number of bands of rows examined at once.
        soft: Whether edges were soft; hard edges are shifted only if most are displaced alike.
        scale: Of distance, if edges were soft in distance.
    """
    ends = torch.stack([ends_of(band) for band in banded(signed_radius)])
    least, most = torch.stack([ends[:, 0].amin(), ends[:, 1].amax()]).tolist()
    slope = slope_of_soft_edges(least, most, signed_radius.shape)
    step = max(_LEAST_STEP, _STEP * slope)
    votes = _votes(signed_radius, pixels, step, threads, scale)
    if float(votes.sum()) <= (0 if soft else _VOTES):
        return None
    median, agreed = _median(votes)
    if not soft and (abs(median) < _BIASED or agreed < _AGREED):
        return None
    share = (votes + 1) / (votes + 1).sum()
    share = (1 - 2 * _BESIDE) * share + _BESIDE * (share.roll(1) + share.roll(-1))
    rarity = -_RARITY * (share + 0.01).log()
    rarity = ((rarity - rarity.amin()) / _COARSE).round() * _COARSE
    return EdgeShifts(step, median, tuple(rarity.tolist()))


def _votes(
    signed_radius: Pixels,
    pixels: Pixels,
    step: float,
    threads: int,
    scale: DistanceScale | None,
) -> Tensor:
    """The trust [2 * FARTHEST + 1] in each displacement, over the silhouettes of a picture.

    Of many pixels those are examined that a hash of what is around them chooses: the same ones
    wherever they lie in the frame.
    """
    every = bands(signed_radius)

    def radii_of(first: int, end: int) -> tuple[Tensor, int]:
        """Radii of the rows of a window, and the first of these rows."""
        return signed_radius[max(first, 0) : end].detach(), max(first, 0)

    def silhouette(rows: tuple[int, int]) -> Tensor:
        """The pixels [n, 2] of a silhouette in a band of rows."""
        radii, above = radii_of(rows[0] - 1, rows[1] + 1)
        at = places_of(edges_of(radii, step, scale)[rows[0] - above : rows[1] - above])
        return at + at.new_tensor([rows[0], 0])

    found = list(threaded(silhouette, every, threads))
    edges = sum(map(len, found))

    def votes_of(number: int, most: float) -> tuple[Tensor, int]:
        """The trust in each displacement, and the number of pixels examined."""
        at, device = found[number], signed_radius.device
        votes = torch.zeros(2 * FARTHEST + 1, dtype=torch.float64, device=device)
        if not len(at):
            return votes, 0
        first, end = every[number]
        radii, above = radii_of(first - REACH, end + REACH)
        colors = pixels[..., above : end + REACH, :].detach()
        at = at - at.new_tensor([above, 0])
        at = at[_hashes(at, radii, colors) < most]
        for chunk in torch.split(at, _profiles(radii)):
            costs, trust = displacement_costs(silhouette_at(chunk, radii), radii, colors)
            votes.index_add_(0, costs.argmin(1), trust.double())
        return votes, len(at)

    most = min(_EXAMINED / max(edges, 1), 1.0)
    of_bands = list(threaded(partial(votes_of, most=most), range(len(every)), threads))
    if 2 * sum(examined for _, examined in of_bands) < min(_EXAMINED, edges):
        most = 1.0  # too much is alike
        of_bands = list(threaded(partial(votes_of, most=most), range(len(every)), threads))
    return torch.stack([votes for votes, _ in of_bands]).sum(0) / most


def _hashes(at: Tensor, radii: Tensor, pixels: Tensor) -> Tensor:
    """Numbers [n] in [0, 1) that look random, of the radii and colours around pixels [n, 2]."""
    beside = squares_around(at, (radii.shape[0], radii.shape[1])).flatten()
    around = [values.flatten().index_select(0, beside) for values in (radii, *pixels)]
    bits = torch.stack(around).float().view(torch.int32).view(len(around), len(at), 9).long()
    factor = 2 * torch.arange(len(around) * bits.shape[2], device=at.device) + 1
    mixed = (bits * _FACTORS[0] * factor.view(len(around), 1, -1)).sum((0, 2))
    mixed = (mixed ^ (mixed >> 32)) * _FACTORS[1]
    return ((mixed >> 40) & 0xFFFFFF).double() / (1 << 24)


def _profiles(like: Tensor) -> int:
    """The number of profiles to examine at once."""
    return pieces(like.device, _PROFILES, _BYTES_EACH)


def _median(votes: Tensor) -> tuple[float, float]:
    """The median displacement in px, and the share of the votes within a px of it."""
    total, below = float(votes.sum()), votes.cumsum(0)
    middle = int((below < total / 2).sum())
    before = float(below[middle - 1]) if middle else 0.0
    median = middle - FARTHEST - 0.5 + (total / 2 - before) / float(votes[middle])
    return median, float(votes[max(middle - 1, 0) : middle + 2].sum()) / total


def with_shifted_edges(
    signed_radius: Tensor, pixels: Tensor, shifts: EdgeShifts, scale: DistanceScale | None = None
) -> Tensor:
    """Radii [H, W] px whose edges lie where the colours of [C, H, W] have theirs."""
    radii = signed_radius.detach()
    at, (H, W) = places_of(edges_of(radii, shifts.step, scale)), radii.shape
    if not len(at):
        return signed_radius
    silhouette = silhouette_at(at, radii)
    parts = (
        torch.split(x, _profiles(radii), d) for x, d in zip(silhouette, (0, 0, 1), strict=True)
    )
    chunks = map(Silhouette._make, zip(*parts, strict=True))
    found = [displacement_costs(chunk, radii, pixels.detach()) for chunk in chunks]
    costs, trust = map(torch.cat, zip(*found, strict=True))
    shift = _smooth_shifts(at, costs, trust, costs.new_tensor(shifts.rarity), (H, W))
    flat, taken = radii.flatten(), signed_radius.flatten()
    near, far = at[:, 0] * W + at[:, 1], silhouette.far
    order = torch.arange(len(at), device=at.device)
    for key in (flat[far], flat[near], shift, shift.abs()):  # decides where two are as close
        order = order[key[order].argsort(stable=True)]
    at, near, far, shift = at[order], near[order], far[order], shift[order]
    if not float(shift.abs().amax()) > _HALF:
        return signed_radius
    index, owner, distance = _owners(at, shift, (H, W))
    own = flat[index]
    is_near = own < halfway(flat[near][owner], flat[far][owner])
    inwards = torch.where(is_near, distance, -distance)  # px within the nearer surface
    wants_near = inwards > shift[owner] - _HALF
    source = torch.where(wants_near, near[owner], far[owner])
    moves = (wants_near != is_near) & (distance <= shift[owner].abs() + 1 + _HALF)
    return taken.index_copy(0, index, taken[torch.where(moves, source, index)]).reshape(H, W)


def _smooth_shifts(
    at: Tensor, costs: Tensor, trust: Tensor, rarity: Tensor, size: tuple[int, int]
) -> Tensor:
    """The displacement [n] in px of each pixel of a silhouette, smooth along it."""
    n, (H, W) = len(at), size
    number = torch.full((H * W,), n, device=at.device)
    number[at[:, 0] * W + at[:, 1]] = torch.arange(n, device=at.device)
    beside = number[squares_around(at, size, 2).flatten(1)]  # [n, 25], n where there is none
    beside = beside.sort(1).values
    beside = beside[:, : int((beside < n).sum(1).amax())]

    def averaged(values: Tensor, rounds: int) -> Tensor:
        """Values [n, K] averaged over the silhouette."""
        nothing = values.new_zeros(1, values.shape[1])
        count = (beside < n).sum(1, keepdim=True)
        for _ in range(rounds):
            padded = torch.cat([values, nothing])
            total = torch.zeros_like(values)
            for k in range(beside.shape[1]):
                total += padded.index_select(0, beside[:, k])
            values = total / count
        return values

    both = averaged(torch.cat([trust[:, None] * costs, trust[:, None]], 1), _ROUNDS)
    weighted, share = both[:, :-1], both[:, -1:]
    evidence = weighted / share.clamp(min=1e-6) * (share / _ENOUGH).clamp(max=1)
    displacement = torch.arange(-FARTHEST, FARTHEST + 1, device=at.device).to(costs.dtype)
    likely = ((evidence + rarity) / -_SPREAD).softmax(1)
    shift = (likely * displacement).sum(1, keepdim=True)
    return (averaged(shift, _SMOOTHING)[:, 0] * _GRAINS).round() / _GRAINS


def _owners(at: Tensor, shift: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """The pixels near shifted parts of a silhouette, and their closest pixels of the silhouette.

    By jump flooding (Rong and Tan 2006); of two that are as close, the first one.

    Args:
        at: [n, 2] rows and columns of the silhouette.
        shift: [n] px.
        size: (height, width) of the frame.

    Returns:
        [m] numbers of pixels, [m] places in `at`, and [m] distances in px.
    """
    n, (H, W) = len(at), size
    number = at[:, 0] * W + at[:, 1]
    owner = torch.full((H * W,), n, device=at.device)
    owner[number] = torch.arange(n, device=at.device)
    band = torch.zeros(H * W, dtype=torch.bool, device=at.device)
    band[number[shift.abs() > _HALF]] = True
    reach = math.ceil(float(shift.abs().amax())) + 1
    index = numbers_of(extreme_around(band.view(H, W), reach, torch.maximum))
    row = index.div(W, rounding_mode="floor")
    column = index - row * W
    places = torch.cat([at, at.new_full((1, 2), 4 * (H + W))])  # of no pixel: far away

    def squared_distance(places_of_owner: Tensor) -> Tensor:
        y, x = places.index_select(0, places_of_owner).unbind(1)
        return (y - row).square() + (x - column).square()

    for step in (8, 4, 2, 1, 1):
        closest = owner.index_select(0, index)
        least = squared_distance(closest)
        for y, x in ((y, x) for y in (-step, 0, step) for x in (-step, 0, step)):
            there = (row + y).clamp(0, H - 1) * W + (column + x).clamp(0, W - 1)
            other = owner.index_select(0, there)
            distance = squared_distance(other)
            closer = (distance < least) | ((distance == least) & (other < closest))
            closest = torch.where(closer, other, closest)
            least = torch.where(closer, distance, least)
        owner = owner.index_copy(0, index, closest)
    known = closest < n
    return index[known], closest[known], least[known].sqrt()

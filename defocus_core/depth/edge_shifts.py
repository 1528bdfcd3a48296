"""Edges of depth moved to the edges of the colours: estimated depth is some px too fat or too thin.

Beside a sharp subject a strip of the background would stay sharp, or the subject's own rim would be
blurred. The costs of all displacements, from profiles of colour, are averaged along a silhouette
before the least is chosen, so that it stays smooth (as in stereo, Hosni et al. 2013), and chosen
softly, so that it holds still (Kendall et al. 2017). A displacement that is rare in the picture
needs more evidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from defocus_core.depth.color_profiles import (
    FARTHEST,
    NORMAL,
    REACH,
    Silhouette,
    color_moments,
    displacement_costs,
    edges_of,
    profiles_of,
    silhouette_at,
)
from defocus_core.depth.distance_scale import DistanceScale
from defocus_core.depth.matting import AROUND_BY_COLOR, radii_by_color
from defocus_core.depth.soft_edges import slope_of_soft_edges
from defocus_core.tensors.device_plan import pieces, sent
from defocus_core.tensors.neighbourhoods import (
    extreme_around,
    halfway,
    range_of,
    ranges_of,
    squares_around,
)
from defocus_core.tensors.source import Pixels, banded, bands
from defocus_core.tensors.sparse_masks import flat_nonzero, positions_of, sums_of_each, tally
from defocus_core.tensors.threads import threaded

# Share of profiles that count from which evidence counts in full.
_ENOUGH = 0.1
# Rounds in which distributions of colours, costs, and then displacements, are averaged over 5×5 px
# of a silhouette.
_ROUNDS, _SMOOTHING = 10, 3
# Cost in px beyond the least at which a displacement counts 1 / e: between two that are as likely
# lies their mean, so that an edge does not jump from one to the other.
_SPREAD = 0.15
# Grains of displacement in a px: finer differences are rounding.
_GRAINS = 1 << 8
# Weight of rarity, and its grain, so coarse that few pixels more or less change nothing; share of a
# displacement's votes that count for those a px beside it.
_RARITY, _COARSE, _BESIDE = 1.2, 0.05, 0.25
# Displacement in px that is expected before colours are known; votes for it, and as a share of all;
# rounds in which votes are counted.
_BEFORE, _FEW, _FEW_SHARE, _MAXIMIZATIONS = 3.0, 10.0, 0.02, 3
# Px of radius by which a surface is more blurred; standard deviation of a displacement in px that
# is none, and what is in doubt at most: it is given to the more blurred surface.
_BLURRED, _CERTAIN, _DOUBTED = 6.0, 0.7, 4.0
# Pixels of silhouettes that are examined for the displacements of the picture; factors of a hash.
_EXAMINED, _FACTORS = 1 << 10, (0x9E3779B97F4A7C1, 0x2545F4914F6CDD1D)
# Least step of an edge: in px, and as a multiple of the slope of a ramp.
_MIN_STEP, _STEP = 0.3, 1.5
# A picture of hard edges is shifted if so many profiles count, if the median displacement is so
# many px, and if such a share of the votes lie within a px of it.
_VOTES, _BIASED, _AGREED = 20, 0.75, 0.6
# Displacement in px from which on a profile may have ended short of the place: the edges within so
# many px are shifted once more.
_FAR, _NEAR_FAR = 5.25, 12
# Px around a pixel that decide what it becomes, once and twice.
_AROUND_ONCE = REACH + NORMAL + 2 * (2 * _ROUNDS + _SMOOTHING) + FARTHEST + 2
AROUND = 2 * _AROUND_ONCE + _NEAR_FAR + AROUND_BY_COLOR
# Half a px, so that averages of whole displacements are no ties.
_HALF = 0.4937
# Bytes that a profile takes while it is examined.
_BYTES_EACH = 1 << 13


class ShiftEvidence(NamedTuple):
    """What colours say of the displacements of a silhouette, averaged along it."""

    costs: Tensor  # [n, 2 * FARTHEST + 1] px, of each displacement
    fraction: Tensor  # [n, 1], of the profiles around that show both surfaces


class EdgeShifts(NamedTuple):
    """The displacements of a picture's edges from those of its colours."""

    step: float  # least step in px of an edge
    median: float  # median displacement in px; positive where depth is too fat, its edges outside
    rarity: tuple[float, ...]  # [2 * FARTHEST + 1] cost of each displacement from -FARTHEST on


def measured_shifts(
    signed_radius: Pixels,  # [H, W] px, without ramps
    pixels: Pixels,  # [C, H, W] linear
    threads: int,
    *,
    soft: float | None,
    scale: DistanceScale | None = None,
) -> EdgeShifts | None:
    """The displacements of the edges of a picture; None if its edges lie where they should.

    `soft`: slope in px of soft edges, which no edge steps less than; None for hard ones, which are
    shifted only if most are displaced alike.
    """
    limits = torch.stack([range_of(band) for band in banded(signed_radius)])
    minimum, maximum = torch.stack([limits[:, 0].amin(), limits[:, 1].amax()]).tolist()
    step = _step_of(minimum, maximum, signed_radius, soft)
    # edges that ran within objects were soft; hard ones may only be biased
    rims = soft is not None
    found, of_all = _evidence_of_some(signed_radius, pixels, step, threads, scale, rims=rims)
    if float(found.fraction.sum()) <= (_VOTES * of_all if soft is None else 0):
        return None
    return _shifts(_votes(found)[0], step, soft)


def measured_shifts_of_each(signed_radius: Tensor, pixels: Tensor) -> list[EdgeShifts | None]:
    """What `measured_shifts` says of each picture of a batch of hard edges.

    `signed_radius`: [B, H, W] px; `pixels`: [C, B, H, W] linear.
    """
    radii, colors, (B, H, _) = signed_radius.detach(), pixels.detach(), signed_radius.shape
    limits = ranges_of(radii).tolist()
    steps = [_step_of(minimum, maximum, radii, None) for minimum, maximum in limits]
    at = positions_of(edges_of(radii, radii.new_tensor(steps)[:, None, None], None))
    every = at[:, 0].div(H, rounding_mode="floor")
    hashes = _hashes(at, radii, colors)
    edges = tally(every, B).tolist()
    chances = [min(_EXAMINED / max(count, 1), 1.0) for count in edges]
    examined = hashes < hashes.new_tensor(chances)[every]
    for number, count in enumerate(tally(every[examined], B).tolist()):
        if 2 * count < min(_EXAMINED, edges[number]):
            chances[number] = 1.0  # too much is alike
            examined = examined | (every == number)
    at, of = at[examined], every[examined]
    if not len(at):
        return [None] * B
    found = _evidence(silhouette_at(at, radii), radii, colors, along=False, rims=False)
    votes = torch.cat([_votes(found, of, B), sums_of_each(found.fraction, of, B)], 1).cpu()
    return [
        None if float(own[-1]) <= _VOTES * chance else _shifts(own[:-1], step, None)
        for own, chance, step in zip(votes, chances, steps, strict=True)
    ]


def _step_of(minimum: float, maximum: float, signed_radius: Pixels, soft: float | None) -> float:
    """The least step in px of an edge of pictures [..., H, W] of a range of radii."""
    slope = slope_of_soft_edges(minimum, maximum, signed_radius.shape[-2:])
    return max(_MIN_STEP, _STEP * slope, soft or 0.0)


def _shifts(votes: Tensor, step: float, soft: float | None) -> EdgeShifts | None:
    """The displacements that have votes [2 * FARTHEST + 1]; None if edges lie where they should."""
    median, agreed = _median(votes)
    if soft is None and (abs(median) < _BIASED or agreed < _AGREED):
        return None
    return EdgeShifts(step, median, tuple(_rarity(votes).tolist()))


def _votes(found: ShiftEvidence, of: Tensor | None = None, count: int = 1) -> Tensor:
    """How many pixels of silhouettes [count, 2 * FARTHEST + 1] have each displacement.

    By expectation and maximization: a pixel whose colours say little votes as the others do.

    `of`: [n] the picture that each pixel is of; None if all are of one.
    """
    of = torch.zeros(1, dtype=torch.long, device=found.costs.device) if of is None else of
    by = torch.arange(-FARTHEST, FARTHEST + 1, device=found.costs.device)
    before = torch.exp(by.abs().double() / -_BEFORE)
    few = _FEW + _FEW_SHARE * sums_of_each(found.fraction, of, count)
    votes = before = before * few / before.sum()
    for _ in range(_MAXIMIZATIONS):
        likely = ((found.costs + _rarity(votes).index_select(0, of)) / -_SPREAD).softmax(1)
        votes = before + sums_of_each(likely * found.fraction, of, count)
    return votes


def _rarity(votes: Tensor) -> Tensor:
    """The cost in px [..., 2 * FARTHEST + 1] of each displacement, by its votes."""
    fraction = votes / votes.sum(-1, keepdim=True)
    limits = torch.cat([fraction[..., :1], fraction, fraction[..., -1:]], -1)
    fraction = (1 - 2 * _BESIDE) * fraction + _BESIDE * (limits[..., :-2] + limits[..., 2:])
    rarity = -_RARITY * (fraction + 0.01).log()
    return ((rarity - rarity.amin(-1, keepdim=True)) / _COARSE).round() * _COARSE


def _evidence_of_some(
    signed_radius: Pixels,
    pixels: Pixels,
    step: float,
    threads: int,
    scale: DistanceScale | None,
    *,
    rims: bool,
) -> tuple[ShiftEvidence, float]:
    """The evidence of single profiles across silhouettes, and the share of them that it is of.

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
        at = positions_of(edges_of(radii, step, scale)[rows[0] - above : rows[1] - above])
        return at + sent([rows[0], 0], at)

    found = list(threaded(silhouette, every, threads))
    edges = sum(map(len, found))

    def evidence_of(number: int, maximum: float) -> ShiftEvidence:
        at, (first, end) = found[number], every[number]
        if not len(at):
            nothing = torch.zeros(0, 2 * FARTHEST + 1, dtype=torch.float64, device=at.device)
            return ShiftEvidence(nothing, nothing[:, :1])
        radii, above = radii_of(first - REACH, end + REACH)
        colors = pixels[..., above : end + REACH, :].detach()
        at = at - sent([above, 0], at)
        if maximum < 1:
            at = at[_hashes(at, radii, colors) < maximum]
        return _evidence(silhouette_at(at, radii), radii, colors, along=False, rims=rims)

    def of_all(maximum: float) -> ShiftEvidence:
        parts = threaded(partial(evidence_of, maximum=maximum), range(len(every)), threads)
        return ShiftEvidence(*map(torch.cat, zip(*parts, strict=True)))

    maximum = min(_EXAMINED / max(edges, 1), 1.0)
    evidence = of_all(maximum)
    if 2 * len(evidence.fraction) < min(_EXAMINED, edges):
        maximum = 1.0  # too much is alike
        evidence = of_all(maximum)
    return evidence, maximum


def _hashes(at: Tensor, radii: Tensor, pixels: Tensor) -> Tensor:
    """Numbers [n] in [0, 1) that look random, of the radii and colours around pixels [n, 2]."""
    beside = squares_around(at, (radii.shape[-2], radii.shape[-1])).flatten()
    around = [values.flatten().index_select(0, beside) for values in (radii, *pixels)]
    bits = torch.stack(around).float().view(torch.int32).view(len(around), len(at), 9).long()
    factor = 2 * torch.arange(len(around) * bits.shape[2], device=at.device) + 1
    mixed = (bits * _FACTORS[0] * factor.view(len(around), 1, -1)).sum((0, 2))
    mixed = (mixed ^ (mixed >> 32)) * _FACTORS[1]
    return ((mixed >> 40) & 0xFFFFFF).double() / (1 << 24)


def _profiles(like: Tensor) -> int:
    """The number of profiles to examine at once."""
    return pieces(like.device, _BYTES_EACH)


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
    edges = edges_of(signed_radius.detach(), shifts.step, scale)
    radii, far = _shifted(signed_radius, pixels, edges, shifts.rarity)
    if not len(far):
        return radii_by_color(radii, pixels.detach())
    moved = torch.zeros_like(edges).flatten().index_fill_(0, far, value=True).view_as(edges)
    edges = edges_of(radii.detach(), shifts.step, scale)
    edges &= extreme_around(moved, _NEAR_FAR, torch.maximum)
    # what is neither surface's has been given away already
    rarity = [_RARITY / _BEFORE * abs(px) for px in range(-FARTHEST, FARTHEST + 1)]
    radii = _shifted(radii, pixels, edges, rarity, rims=False)[0]
    return radii_by_color(radii, pixels.detach())


def _shifted(
    signed_radius: Tensor,
    pixels: Tensor,
    edges: Tensor,
    rarity: Sequence[float],
    *,
    rims: bool = True,
) -> tuple[Tensor, Tensor]:
    """Radii [H, W] px with edges [H, W] shifted once, and the numbers of pixels shifted far."""
    radii = signed_radius.detach()
    at, (H, W) = positions_of(edges), radii.shape
    if not len(at):
        return signed_radius, at[:, 0]
    silhouette = silhouette_at(at, radii)
    found = _evidence(silhouette, radii, pixels.detach(), rims=rims)
    shift = _smooth_shifts(silhouette, radii, found, found.costs.new_tensor(rarity))
    flat, taken = radii.flatten(), signed_radius.flatten()
    near, far = at[:, 0] * W + at[:, 1], silhouette.far
    order = torch.arange(len(at), device=at.device)
    for key in (flat[far], flat[near], shift, shift.abs()):  # decides where two are as close
        order = order[key[order].argsort(stable=True)]
    at, near, far, shift = at[order], near[order], far[order], shift[order]
    if not float(shift.abs().amax()) > _HALF:
        return signed_radius, at[:0, 0]
    index, owner, distance = _owners(at, shift, (H, W))
    own = flat[index]
    is_near = own < halfway(flat[near][owner], flat[far][owner])
    inwards = torch.where(is_near, distance, -distance)  # px within the nearer surface
    wants_near = inwards > shift[owner] - _HALF
    source = torch.where(wants_near, near[owner], far[owner])
    moves = (wants_near != is_near) & (distance <= shift[owner].abs() + 1 + _HALF)
    shifted = taken.index_copy(0, index, taken[torch.where(moves, source, index)])
    return shifted.reshape(H, W), near[shift.abs() > _FAR]


def _evidence(
    silhouette: Silhouette, radii: Tensor, pixels: Tensor, *, along: bool = True, rims: bool = True
) -> ShiftEvidence:
    """The evidence of colours [C, H, W] at pixels of radii [H, W], averaged along a silhouette.

    `radii`: [H, W] px; `pixels`: [C, H, W] linear.
    """
    step, beside = _profiles(radii), _beside(silhouette.at, radii) if along else None
    parts = (torch.split(x, step, d) for x, d in zip(silhouette, (0, 0, 1), strict=True))
    profiles = [profiles_of(Silhouette(*part), radii) for part in zip(*parts, strict=True)]
    moments = torch.cat([color_moments(each, pixels) for each in profiles])
    if beside is not None:
        moments = _averaged(moments, beside, _ROUNDS)
    costs = torch.cat(
        [
            displacement_costs(*each, pixels, alone=not along, rims=rims)
            for each in zip(profiles, torch.split(moments, step), strict=True)
        ]
    )
    seen = torch.cat([each.is_seen for each in profiles]).to(costs.dtype)[:, None]
    if beside is None:
        return ShiftEvidence(costs, seen)
    both = _averaged(torch.cat([seen * costs, seen], 1), beside, _ROUNDS)
    weighted, fraction = both[:, :-1], both[:, -1:]
    return ShiftEvidence(
        weighted / fraction.clamp(min=1e-6) * (fraction / _ENOUGH).clamp(max=1), fraction
    )


def _smooth_shifts(
    silhouette: Silhouette, radii: Tensor, found: ShiftEvidence, rarity: Tensor
) -> Tensor:
    """The displacement [n] in px of each pixel of a silhouette, smooth along it.

    Where it is uncertain, a nearer surface that is more blurred than the farther one gets the
    pixels in doubt: what is left behind of it would be a sharp line.
    """
    W, flat = radii.shape[1], radii.flatten()
    by = torch.arange(-FARTHEST, FARTHEST + 1, device=rarity.device).to(rarity.dtype)
    likely = ((found.costs + rarity) / -_SPREAD).softmax(1)
    shift = (likely * by).sum(1, keepdim=True)
    doubt = (likely * (by - shift).square()).sum(1, keepdim=True).sqrt()
    near, far = flat[silhouette.at[:, 0] * W + silhouette.at[:, 1]], flat[silhouette.far]
    more_blurred = ((near.abs() - far.abs()).double()[:, None] / _BLURRED).clamp(0, 1)
    shift = shift - more_blurred * (doubt - _CERTAIN).clamp(0, _DOUBTED)
    shift = _averaged(shift, _beside(silhouette.at, radii), _SMOOTHING)[:, 0]
    return (shift.clamp(-FARTHEST, FARTHEST) * _GRAINS).round() / _GRAINS


def _beside(at: Tensor, radii: Tensor) -> Tensor:
    """The places [n, K] in `at` of the pixels of a silhouette within 5×5 px; n for none."""
    n, (H, W) = len(at), radii.shape
    number = torch.full((H * W,), n, device=at.device)
    number[at[:, 0] * W + at[:, 1]] = torch.arange(n, device=at.device)
    beside = number[squares_around(at, (H, W), 2).flatten(1)].sort(1).values
    return beside[:, : int((beside < n).sum(1).amax()) if n else 0]


def _averaged(values: Tensor, beside: Tensor, rounds: int) -> Tensor:
    """Values [n, K] averaged over 5×5 px of a silhouette, in some rounds."""
    n = len(values)
    values = torch.cat([values, values.new_zeros(1, values.shape[1])]).float()
    beside = torch.cat([beside, beside.new_full((1, beside.shape[1]), n)])
    count = (beside < n).sum(1, keepdim=True).clamp(min=1)
    for _ in range(rounds):
        values = embedding_bag(beside, values, mode="sum") / count
    return values[:n].double()


def _owners(at: Tensor, shift: Tensor, size: tuple[int, int]) -> tuple[Tensor, Tensor, Tensor]:
    """The pixels near shifted parts of a silhouette, and their closest pixels of the silhouette.

    By jump flooding (Rong and Tan 2006); of two that are as close, the first one.

    `at`: [n, 2] rows and columns of the silhouette; `shift`: [n] px; `size`: (height, width) of the
    frame. Returns [m] numbers of pixels, [m] places in `at`, and [m] distances in px.
    """
    n, (H, W) = len(at), size
    number = at[:, 0] * W + at[:, 1]
    owner = torch.full((H * W,), n, device=at.device)
    owner[number] = torch.arange(n, device=at.device)
    band = torch.zeros(H * W, dtype=torch.bool, device=at.device)
    band[number[shift.abs() > _HALF]] = True
    reach = math.ceil(float(shift.abs().amax())) + 1
    index = flat_nonzero(extreme_around(band.view(H, W), reach, torch.maximum))
    row = index.div(W, rounding_mode="floor")
    column = index - row * W
    positions = torch.cat([at, at.new_full((1, 2), 4 * (H + W))])  # of no pixel: far away

    def squared_distance(positions_of_owner: Tensor) -> Tensor:
        y, x = positions.index_select(0, positions_of_owner).unbind(1)
        return (y - row).square() + (x - column).square()

    for step in (8, 4, 2, 1, 1):
        closest = owner.index_select(0, index)
        minimum = squared_distance(closest)
        for y, x in ((y, x) for y in (-step, 0, step) for x in (-step, 0, step)):
            there = (row + y).clamp(0, H - 1) * W + (column + x).clamp(0, W - 1)
            other = owner.index_select(0, there)
            distance = squared_distance(other)
            closer = (distance < minimum) | ((distance == minimum) & (other < closest))
            closest = torch.where(closer, other, closest)
            minimum = torch.where(closer, distance, minimum)
        owner = owner.index_copy(0, index, closest)
    known = closest < n
    return index[known], closest[known], minimum[known].sqrt()
